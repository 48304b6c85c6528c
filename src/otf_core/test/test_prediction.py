# SPDX-License-Identifier: Apache-2.0
"""Predictions: inside and outside, for another target, and points that are refused.

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
from otf_core.prediction.calibration_document import tables_from_dict, tables_to_dict
from otf_core.prediction.predict import predict
from otf_core.solving.tabulate import USUAL_ANGLE, unseen_sizes

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


def test_outside_the_driven_volume_no_u_is_stated(tmp_path):
    tables = known_to(zero_tables(some_machine()), 1e-7)
    q = np.array([[0.3, 0.1, -0.1], [0.35, 0.1, -0.1], [-0.1, 0.1, -0.1], [0.2, 0.1, -0.1]])
    found = predict(written_tables(tmp_path, tables), q)
    assert found.inside.tolist() == [True, False, False, True]
    assert np.isfinite(found.u).all(axis=1).tolist() == found.inside.tolist()
    assert np.isfinite(found.error).all()
    assert any('2 of 4 points lie outside the driven volume' in n for n in found.notes)
    assert 'no u, as all lie outside' in predict(written_tables(tmp_path, tables), q[1:2]).summary


@pytest.mark.parametrize(
    ('prior', 'words'),
    [
        ([1.0], 'prior: expected a mapping'),
        ({'EXX': 1.0}, 'prior: EXX: expected a mapping, got 1.0'),
        ({'ECZ': {'sd': -1e-5}}, 'prior: ECZ: sd: must be at least 0, got -1e-05'),
        ({'ECZ': {'sd': True}}, 'prior: ECZ: sd: expected a finite number'),
        ({'ECZ': {'sd': None}}, 'prior: ECZ: sd: expected a finite number'),
    ],
)
def test_a_wrong_prior_is_named(prior, words):
    with pytest.raises(ConfigError) as caught:
        tables_from_dict(tables_to_dict(zero_tables(some_machine())) | {'prior': prior}, 'f.json')
    assert f'f.json: {words}' in str(caught.value)


def test_a_prior_may_be_absent_or_hold_more():
    data = tables_to_dict(zero_tables(some_machine()))
    more = {'C0Y': {'sd': 1e-5}, 'EAX': {'slope': 1, 'sd': 2e-5}}
    assert tables_from_dict(data | {'prior': None}, 'f').prior == {}
    prior = tables_from_dict(data | {'prior': more}, 'f').prior
    assert {name: one.sd for name, one in prior.items()} == {'EAX': 2e-5}


def test_rotations_that_are_not_seen_are_as_large_as_those_that_are():
    tables = zero_tables(some_machine())
    seen = tuple(m for m in MOTIONS if m not in ('EAZ', 'ECX'))
    motions = {m: replace(t, value=t.value + 3e-5) for m, t in tables.motions.items()}
    sizes = unseen_sizes(replace(tables, motions=motions), seen)
    assert sizes == {'EAZ': pytest.approx(3e-5), 'ECX': pytest.approx(3e-5)}
    assert set(unseen_sizes(tables, ()).values()) == {USUAL_ANGLE}


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
    assert header == 'x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,u_run_dx,u_run_dy,u_run_dz,inside'
    assert [row.rsplit(',', 1)[1] for row in rows] == ['1', '1', '0']
    assert [row.endswith(',,,,0') for row in rows] == [False, False, True]
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


def test_older_files_mean_noise_misfit_and_what_was_declared_by_u(tmp_path):
    data = tables_to_dict(known_to(zero_tables(some_machine()), 1e-7))
    del data['systematic']
    data['headline'] = {'unit': 'm', 'expected_after_compensation': {'U': {'mean': 1e-6}}}
    (tmp_path / 'tables.json').write_text(json.dumps(data))
    found = predict(tmp_path / 'tables.json', np.array([[0.1, 0.1, -0.1]]))
    assert 'the contributions in the tables, which their file does not state' in found.summary
    assert found.summary.startswith('1 point: ')
    assert any('older file: u holds noise, misfit and what was declared' in n for n in found.notes)
    np.testing.assert_array_equal(found.u, found.u_run)


def test_points_in_inches_are_refused_with_the_cure(command, capsys):
    assert command.run([(0.3 / 0.0254, 0.1 / 0.0254, -0.1 / 0.0254)]) == 2
    assert 'or inches: write x_in,y_in,z_in into the header' in capsys.readouterr().err
