# SPDX-License-Identifier: Apache-2.0
"""Predictions: u beyond what was driven and for another target, and points that are refused.

The files are written by hand here; what they must give follows from the model of the contract.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import error_by_hand, some_machine, written_tables, zero_tables

from otf_core import cli
from otf_core.errors import ConfigError
from otf_core.model.evaluation import lattice
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import MotionTable, tables_to_dict
from otf_core.prediction.predict import predict
from otf_core.prediction.table_prior import MotionPrior, prior_from_dict

OFFSET = np.array([0.02, -0.03, -0.15])


def blind_to(tables, *names):
    """Tables in which these motions were not seen."""
    motions = dict(tables.motions)
    for name in names:
        motions[name] = replace(motions[name], identifiable=False)
    return replace(tables, motions=motions)


def known_to(tables, u):
    """Tables with the same standard uncertainty at every node."""
    motions = {m: replace(t, u=np.full(len(t.position), u)) for m, t in tables.motions.items()}
    return replace(tables, motions=motions)


# ---------------------------------------------------------------- beyond the ends


def test_u_grows_beyond_the_end_of_a_table_as_an_integrated_random_walk(tmp_path):
    tables = known_to(zero_tables(some_machine()), 1e-7)
    plain = written_tables(tmp_path, tables)
    q = np.array([[0.3, 0.1, -0.1], [0.35, 0.1, -0.1], [-0.1, 0.1, -0.1], [0.2, 0.1, -0.1]])
    before = predict(plain, q)
    prior = {'EXX': {'slope': 1e-5, 'intensity': 3e-9}}
    after = predict(written_tables(tmp_path, tables, prior=prior), q)
    added = after.u**2 - before.u**2
    for point, d in enumerate((0.0, 0.05, 0.1, 0.0)):
        expected = 1e-10 * d**2 + 3e-9 * d**3 / 3
        np.testing.assert_allclose(added[point], [expected, 0.0, 0.0], rtol=1e-9, atol=1e-22)
    np.testing.assert_array_equal(after.error, before.error)


def test_scatter_of_integrated_random_walks_is_the_growth():
    rng, step, distance = np.random.default_rng(4), 1e-3, 0.1
    prior = MotionPrior(slope=2e-5, intensity=5e-9)
    count = round(distance / step)
    slope = 2e-5 * rng.standard_normal((4000, 1))
    kicks = np.sqrt(5e-9 * step) * rng.standard_normal((4000, count))
    ends = np.sum((slope + np.cumsum(kicks, axis=1)) * step, axis=1)
    assert np.var(ends) == pytest.approx(float(prior.beyond(np.array([distance]))[0]), rel=0.1)


def test_a_rotation_grows_through_its_lever(tmp_path):
    tables = zero_tables(some_machine())  # Y carries Z and the target: lever T + z
    prior = {'ECY': {'slope': 1e-4}}
    q = np.array([[0.1, 0.3, -0.1]])  # 50 mm beyond the end of Y
    found = predict(written_tables(tmp_path, tables, prior=prior), q)
    turned = 1e-4 * 0.05
    np.testing.assert_allclose(found.u[0], [turned * 0.03, turned * 0.02, 0.0], rtol=1e-9)


def test_without_a_prior_nothing_grows_and_the_note_says_so(tmp_path):
    tables = known_to(zero_tables(some_machine()), 1e-7)
    file = written_tables(tmp_path, tables)
    found = predict(file, np.array([[0.3, 0.1, -0.1], [0.4, 0.1, -0.1]]))
    np.testing.assert_allclose(found.u[0], found.u[1], rtol=1e-12)
    assert found.inside.tolist() == [True, False]
    assert any('1 of 2 points lie outside the driven volume' in n for n in found.notes)
    assert any('holds no prior, so u does not grow' in n for n in found.notes)
    found = predict(written_tables(tmp_path, tables, prior={}), np.array([[0.4, 0.1, -0.1]]))
    assert any('holds no prior' in n for n in found.notes)
    grown = written_tables(tmp_path, tables, prior={'EXX': {'slope': 1e-5}})
    assert any(
        'u grows by their prior' in n for n in predict(grown, np.array([[0.4, 0, 0]])).notes
    )


@pytest.mark.parametrize(
    ('prior', 'words'),
    [
        ([1.0], 'prior: expected motions'),
        ({'EXX': 1.0}, 'prior: EXX: expected slope, intensity, sd, length, got 1.0'),
        ({'EXX': {'slope': '1'}}, "prior: EXX: slope: expected a number from 0 on, got '1'"),
        ({'EXX': {'slope': True}}, 'prior: EXX: slope: expected a number'),
        ({'ECZ': {'sd': -1e-5}}, 'prior: ECZ: sd: expected a number from 0 on, got -1e-05'),
        ({'ECZ': {'intensity': float('nan')}}, 'prior: ECZ: intensity: expected a number'),
        ({'C0Y': {'sd': None}}, 'prior: C0Y: sd: expected a number'),
    ],
)
def test_a_wrong_prior_is_named(prior, words):
    with pytest.raises(ConfigError) as caught:
        prior_from_dict(prior, 'tables.json')
    assert f'tables.json: {words}' in str(caught.value)


def test_a_prior_may_be_absent_or_hold_more():
    assert prior_from_dict(None, 'tables.json') == {}
    more = {'law': 'integrated random walk', 'EXX': {'slope': 1, 'seen': True}}
    assert prior_from_dict(more, 'tables.json') == {'EXX': MotionPrior(slope=1.0)}


# ---------------------------------------------------------------- rotations not seen


def absorbed(tables, name, value, levers):
    """Tables of a machine with one more rotation that is held by translations at its levers."""
    unit = np.eye(3)['ABC'.index(name[1])]
    moved = np.cross(unit, levers)
    motions = dict(tables.motions)
    for k, direction in enumerate('XYZ'):
        motion = f'E{direction}{name[2]}'
        motions[motion] = replace(motions[motion], value=motions[motion].value + value * moved[k])
    return replace(tables, motions=motions)


def turned(tables, name, value):
    motions = dict(tables.motions)
    motions[name] = replace(motions[name], value=motions[name].value + value)
    return replace(tables, motions=motions)


def test_an_unseen_rotation_is_in_u_for_another_tool_and_only_there(tmp_path):
    """Machines with rotation ECZ, tables without: right at T, off at T' by what u says."""
    rng, sd = np.random.default_rng(2), 3e-5
    base = zero_tables(some_machine(), nodes=4)
    tables = blind_to(base, 'ECZ')
    q = lattice(base.machine, 3)
    longer = np.array([0.1, 0.05, -0.25])
    file = written_tables(tmp_path, tables, prior={'ECZ': {'sd': sd}})
    own, other = predict(file, q), predict(file, q, longer)
    assert np.all(own.u == 0)
    assert not any('not seen' in n for n in own.notes)
    assert any('ECZ were not determined' in n and 'by their prior' in n for n in other.notes)
    off = []
    for _ in range(200):
        value = sd * rng.standard_normal(4)
        truth = turned(base, 'ECZ', value)
        seen = absorbed(base, 'ECZ', value, base.machine.target_offset)
        here = [error_by_hand(truth, p) - error_by_hand(seen, p) for p in q[:3]]
        np.testing.assert_allclose(here, 0.0, atol=1e-18)
        at_longer = replace(base.machine, target_offset=longer)
        there = [error_by_hand(replace(t, machine=at_longer), q[0]) for t in (truth, seen)]
        off.append(there[0] - there[1])
    np.testing.assert_allclose(np.std(off, axis=0), other.u[0], rtol=0.2, atol=1e-15)
    np.testing.assert_allclose(other.u, np.tile([0.08 * sd, 0.08 * sd, 0.0], (27, 1)), rtol=1e-9)


def test_a_longer_tool_along_the_axis_of_the_rotation_changes_nothing(tmp_path):
    tables = blind_to(zero_tables(some_machine()), 'ECZ')
    file = written_tables(tmp_path, tables, prior={'ECZ': {'sd': 1e-5}})
    found = predict(file, np.array([[0.1, 0.1, -0.1]]), np.add(OFFSET, [0, 0, -0.2]))
    assert np.all(found.u == 0)
    assert not any('not seen' in n for n in found.notes)


def test_a_rotation_hidden_in_a_plane_is_in_u_off_the_plane(tmp_path):
    """Z stood at -0.1: EBX acts through T and -0.1 there, and through z elsewhere."""
    rng, sd, height = np.random.default_rng(3), 2e-5, -0.1
    base = zero_tables(some_machine(), nodes=3)
    flat = {
        m: MotionTable(np.array([height]), np.zeros(1), np.zeros(1))
        for m in MOTIONS
        if m.axis == 'Z'
    }
    tables = blind_to(replace(base, motions={**base.motions, **flat}), 'EBX')
    file = written_tables(tmp_path, tables, prior={'EBX': {'sd': sd}})
    q = np.array([[0.1, 0.1, height], [0.1, 0.1, -0.02]])
    found = predict(file, q)
    assert found.inside.tolist() == [True, False]
    off = []
    for _ in range(300):
        value = sd * rng.standard_normal(3)
        truth = turned(tables, 'EBX', value)
        seen = absorbed(tables, 'EBX', value, np.add(OFFSET, [0, 0, height]))
        off.append([error_by_hand(truth, p) - error_by_hand(seen, p) for p in q])
    # between two nodes drawn apart the rotation is smaller; the prior is that of a node
    share = np.sqrt((1 / 3) ** 2 + (2 / 3) ** 2)
    np.testing.assert_allclose(np.std(off, axis=0), share * found.u, rtol=0.15, atol=1e-15)
    np.testing.assert_allclose(found.u, [[0, 0, 0], [sd * 0.08, 0, 0]], atol=1e-18)


def test_a_squareness_that_was_not_seen_is_in_u_off_the_plane(tmp_path):
    base = zero_tables(some_machine())
    flat = {
        m: MotionTable(np.array([0.0]), np.zeros(1), np.zeros(1)) for m in MOTIONS if m.axis == 'Z'
    }
    tables = replace(base, motions={**base.motions, **flat})
    prior = {'B0Z': {'sd': 1e-4}, 'C0Y': {'sd': 1e-4}}
    q = np.array([[0.1, 0.1, -0.05]])
    seen = predict(written_tables(tmp_path, tables, prior=prior), q)
    assert np.all(seen.u == 0)
    unseen = predict(written_tables(tmp_path, tables, prior=prior, not_identifiable=['B0Z']), q)
    np.testing.assert_allclose(unseen.u[0], [5e-6, 0.0, 0.0], rtol=1e-12)


def test_a_seen_rotation_acts_through_the_offset_that_is_asked_for(tmp_path):
    tables = turned(zero_tables(some_machine()), 'EAZ', 1e-5)
    q = np.array([[0.1, 0.2, -0.1]])
    found = predict(written_tables(tmp_path, tables), q, np.array([0.0, 0.1, -0.3]))
    np.testing.assert_allclose(found.error[0], 1e-5 * np.array([0.0, 0.3, 0.1]), rtol=1e-12)


def test_without_a_prior_unseen_rotations_are_named(tmp_path):
    tables = blind_to(zero_tables(some_machine()), 'ECZ', 'EAZ')
    file = written_tables(tmp_path, tables, prior={'EAZ': {'sd': 1e-5}})
    found = predict(file, np.array([[0.1, 0.1, -0.1]]), np.add(OFFSET, [0.1, 0, -0.1]))
    assert any('EAZ were not determined' in n and 'u includes them' in n for n in found.notes)
    assert any(
        'ECZ were not determined' in n and 'u does not include them' in n for n in found.notes
    )


@pytest.mark.parametrize(
    ('offset', 'words'),
    [([0.0, 0.0, np.nan], 'finite'), ([0.0, 0.0, -150.0], 'unit is m'), ([0.0, 0.0], 'three')],
)
def test_a_wrong_target_offset_is_named(tmp_path, offset, words):
    file = written_tables(tmp_path, zero_tables(some_machine()))
    with pytest.raises(ConfigError) as caught:
        predict(file, np.zeros((1, 3)), np.array(offset))
    assert 'target_offset: ' in str(caught.value)
    assert words in str(caught.value)


# ---------------------------------------------------------------- what a file does not say


def without(tmp_path, squareness, *motions):
    """A file of exact tables that says so much of squareness, and no u of some motions."""
    file = written_tables(tmp_path, known_to(zero_tables(some_machine()), 1e-7))
    data = json.loads(file.read_text())
    data['squareness'] = squareness
    for name in motions:
        del data['motions'][name]['u']
    file.write_text(json.dumps(data))
    return file


def test_what_a_file_does_not_say_is_zero_and_named(tmp_path):
    file = without(tmp_path, {'C0Y': {'value': 1e-5}, 'B0Z': {}}, 'EXX', 'EBY')
    found = predict(file, np.array([[0.2, 0.1, -0.1]]))
    np.testing.assert_allclose(found.error, [[-1e-6, 0.0, 0.0]], atol=1e-18)
    assert 'the tables do not contain B0Z, A0Z: taken as zero' in found.notes
    assert any(note.startswith('the tables hold no u of C0Y, EXX, EBY: ') for note in found.notes)


def test_of_a_complete_file_no_such_thing_is_said(tmp_path):
    angles = {name: {'value': 0.0, 'u': 1e-6} for name in SQUARENESS}
    found = predict(without(tmp_path, angles), np.array([[0.2, 0.1, -0.1]]))
    assert not any('the tables say' in note or 'no u of' in note for note in found.notes)


# ---------------------------------------------------------------- points


@pytest.fixture
def command(tmp_path):
    """Run predict over points in a small machine."""
    file = written_tables(tmp_path, known_to(zero_tables(some_machine()), 1e-7))
    points, out = tmp_path / 'points.csv', tmp_path / 'errors.csv'

    def run(rows, *options):
        points.write_text('x,y,z\n' + ''.join(f'{x},{y},{z}\n' for x, y, z in rows))
        words = ['predict', '--tables', file, '--points', points, '--out', out, *options]
        return cli.main([str(w) for w in words])

    return SimpleNamespace(run=run, out=out)


def test_last_column_tells_inside_and_a_note_counts_the_others(command, capsys):
    assert command.run([(0.1, 0.1, -0.1), (0.3, 0.25, 0.0), (0.31, 0.1, -0.1)]) == 0
    header, *rows = command.out.read_text().splitlines()
    assert header == 'x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,inside'
    assert [row.rsplit(',', 1)[1] for row in rows] == ['1', '1', '0']
    shown = capsys.readouterr()
    assert '1 of 3 points lie outside the driven volume' in shown.err
    assert 'outside the axis ranges of the machine, by up to 10 mm (axis X)' in shown.err
    assert shown.out.startswith('3 points: mean |error| 0 um, mean |u| ')
    assert 'k = 1' in shown.out


def test_points_in_millimetres_are_refused(command, capsys):
    assert command.run([(0.1, 0.1, -0.1), (100, 100, -100)]) == 2
    message = capsys.readouterr().err
    assert (
        'points.csv: point 2 (100, 100, -100) lies 99.7 m outside the range of axis X' in message
    )
    assert 'look like mm' in message
    assert message.count('\n') == 1
    assert not command.out.exists()
    assert command.run([(1e6, 1, -1)]) == 2
    message = capsys.readouterr().err
    assert 'points are in m' in message
    assert 'look like mm' not in message


def test_target_offset_is_an_option_and_may_be_negative(command, capsys):
    assert command.run([(0.1, 0.1, -0.1)], '--target-offset', '-1e-2', '-.5', '-0.25') == 0
    assert command.run([(0.1, 0.1, -0.1)], '--overwrite', '--target-offset', '0', '0', '-150') == 2
    assert 'target_offset: ' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('uncertainty', 'not_stated', 'words'),
    [
        (None, ['air', 'target offset'], 'noise and misfit only'),
        ({'tracker_scale': 1e-6}, ['air'], 'what was declared, but not: air'),
        ({'tracker_scale': 1e-6}, [], 'noise, misfit and the declared systematic'),
        (None, None, 'the contributions in the tables, which their file does not state'),
    ],
)
def test_the_summary_says_what_u_holds(tmp_path, uncertainty, not_stated, words):
    data = tables_to_dict(zero_tables(some_machine()))
    if uncertainty:
        data['machine']['uncertainty'] = uncertainty
    if not_stated is not None:
        data['budget'] = {'not_stated': not_stated}
    (tmp_path / 'tables.json').write_text(json.dumps(data))
    found = predict(tmp_path / 'tables.json', np.array([[0.1, 0.1, -0.1]]))
    assert words in found.summary
    assert found.summary.startswith('1 point: ')


def test_points_in_inches_are_refused_with_the_cure(command, capsys):
    assert command.run([(0.3 / 0.0254, 0.1 / 0.0254, -0.1 / 0.0254)]) == 2
    assert 'or inches: write x_in,y_in,z_in into the header' in capsys.readouterr().err
