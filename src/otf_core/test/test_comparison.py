# SPDX-License-Identifier: Apache-2.0
"""Comparison of error tables and direct measurements: convention, levers, E_n, command."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from core_cells import CONTRACT_CHAINS, constant_tables, error_of, some_machine, zero_tables
from direct_instrument import InstrumentNoise, measure_directly
from direct_texts import write_direct_csv
from html_cells import Page, unloading

from otf_core import cli
from otf_core.comparison.compare import (
    compare,
    normalised_error,
    source_of_measurement,
    source_of_tables,
)
from otf_core.comparison.direct import AxisReadings, DirectMeasurement
from otf_core.comparison.document import document_of
from otf_core.errors import ConfigError
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS
from otf_core.model.provenance import provenance
from otf_core.model.tables import MotionTable, ScalarError
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    PackedCovariance,
    tables_to_dict,
)
from otf_core.reports.comparison import (
    format_comparison,
)
from otf_core.reports.pages import write_document
from otf_core.sim.cell import random_tables


def to_dict(result):
    return document_of(result, {}).to_dict()


def text_of(result):
    return format_comparison(to_dict(result))


PERFECT = InstrumentNoise(0.0, 0.0, 0.0, 0.0, 0.0)


def truth_of(machine, seed=3, size=2e-5):
    return random_tables(machine, size, np.random.default_rng(seed))


def changed(tables, **added):
    """Tables with a function of the position added to motions."""
    motions = dict(tables.motions)
    for name, function in added.items():
        table = motions[name]
        motions[name] = replace(table, value=table.value + function(table.position))
    return replace(tables, motions=motions)


def source(name, tables, covariance=None, hidden=()):
    extra = {'not_identifiable': tuple(hidden)}
    if covariance is not None:
        extra['covariance'] = PackedCovariance.of(covariance, tables.machine)
    return source_of_tables(name, CalibrationDocument.of_tables(tables, **extra))


def compared(a, b, points=None):
    return compare(source('a', a), source('b', b), points)


def motions_of(comparison):
    return {m: comparison.errors[m] for m in comparison.common.motions}


def largest(comparison):
    return max(np.abs(m.difference).max() for m in motions_of(comparison).values())


def test_the_convention_takes_out_what_says_nothing_of_the_machine():
    tables = truth_of(some_machine())
    other = changed(
        tables, EXX=lambda q: 3e-6, EBZ=lambda q: -2e-5, EYX=lambda q: 1e-6 + 4e-5 * q,
        EXZ=lambda q: 2e-6 - 1e-4 * q,
    )  # fmt: skip
    result = compared(tables, other)
    assert largest(result) < 1e-15
    field = error_of(other, result.common.grid) - error_of(tables, result.common.grid)
    field = without_rigid_motion(field, result.volume.position)
    np.testing.assert_allclose(result.volume.difference, field, atol=1e-12)


def test_both_sides_follow_the_convention():
    result = compared(truth_of(some_machine()), truth_of(some_machine(), seed=4))
    for name, motion in motions_of(result).items():
        zero = [0, -1] if name.is_straightness else [int(np.argmin(np.abs(motion.position)))]
        np.testing.assert_allclose(motion.a[zero], 0.0, atol=1e-18)
        np.testing.assert_allclose(motion.b[zero], 0.0, atol=1e-18)
    assert largest(result) > 1e-6


def test_error_vectors_are_those_of_the_model_without_rigid_motion():
    tables = truth_of(some_machine())
    result = compared(tables, zero_tables(tables.machine))
    expected = error_of(tables, result.common.grid)
    expected = without_rigid_motion(expected, result.common.grid)
    np.testing.assert_allclose(result.volume.a, expected, atol=1e-12)
    np.testing.assert_allclose(result.volume.b, 0.0, atol=1e-15)


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
@pytest.mark.parametrize('other', [(0.02, -0.03, -0.15), (0.1, 0.05, -0.3)])
def test_a_rotation_one_side_cannot_see_counts_as_a_translation(chain, other):
    machine = some_machine(chain, offset=other)
    blind = [m for m in MOTIONS if m[1] in 'ABC' and _constant(machine, m)]
    assert blind
    tables = truth_of(some_machine(chain))  # that knows them may be of another target offset
    motions = dict(tables.motions)
    for name in blind:  # what a calibration with one target offset gives instead
        own, table = AXES.index(name[2]), motions[name]
        q = np.zeros((len(table.position), 3))
        q[:, own] = table.position
        alone = constant_tables(machine)
        alone = replace(alone, motions={**alone.motions, name: table})
        effect = error_of(alone, q)
        for k, direction in enumerate('XYZ'):
            old = motions[f'E{direction}{name[2]}']
            motions[f'E{direction}{name[2]}'] = replace(old, value=old.value + effect[:, k])
        motions[name] = replace(table, value=0 * table.value, identifiable=False)
    for pair in [
        (tables, replace(tables, machine=machine, motions=motions)),
        (replace(tables, machine=machine, motions=motions), tables),
    ]:
        result = compared(*pair)
        assert set(result.common.folded) == set(blind)
        assert largest(result) < 1e-15
    assert 'treated as such' in text_of(result)


def _constant(machine, motion, still=''):
    """Tell from the error itself whether no other axis that moves changes what a rotation does."""
    tables = constant_tables(machine, **{motion: 1e-3})
    q = np.vstack([np.zeros(3), np.diag([0.1, 0.1, -0.1])])
    q[:, [AXES.index(a) for a in motion[2] + still]] = 0.0
    return np.ptp(error_of(tables, q), axis=0).max() < 1e-12


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_what_a_run_in_a_plane_mixes_up_is_mixed_up_in_both(chain):
    machine, still = some_machine(chain), -0.13
    tables = truth_of(machine)
    motions = {}
    for name, table in tables.motions.items():
        if name[2] == 'Z':
            motions[name] = MotionTable(np.array([still]), np.zeros(1), np.zeros(1), False)
        else:
            motions[name] = table
    blind = [m for m in MOTIONS if m[1] in 'ABC' and m[2] != 'Z' and _constant(machine, m, 'Z')]
    for name in blind:
        table = motions[name]
        q = np.zeros((len(table.position), 3))
        q[:, AXES.index(name[2])], q[:, 2] = table.position, still
        alone = constant_tables(machine)
        alone = replace(alone, motions={**alone.motions, name: table})
        for k, effect in enumerate(error_of(alone, q).T):
            own = f'E{"XYZ"[k]}{name[2]}'
            motions[own] = replace(motions[own], value=motions[own].value + effect)
        motions[name] = replace(table, value=0 * table.value, identifiable=False)
    result = compared(tables, replace(tables, motions=motions))
    assert set(blind) <= set(result.common.folded)
    assert largest(result) < 1e-15
    assert mean_length(result.volume.difference) < 1e-15
    np.testing.assert_array_equal(np.unique(result.common.grid[:, 2]), [still])


def test_two_sides_that_cannot_see_a_rotation_at_different_offsets_are_told_of():
    def blind(offset):
        tables = truth_of(some_machine(offset=offset))
        hidden = {
            n: replace(tables.motions[n], value=0 * tables.motions[n].value, identifiable=False)
            for n in ('ECY', 'EAZ', 'EBZ', 'ECZ')
        }
        return replace(tables, motions={**tables.motions, **hidden})

    one = blind((0.0, 0.0, -0.15))
    same, longer = compared(one, one), compared(one, blind((0.0, 0.0, -0.25)))
    assert same.common.apart == () and 'WARNING' not in text_of(same)
    assert longer.common.apart == (
        'EAZ',
        'EBZ',
    )  # a longer tool along Z is none for a turn about Z
    assert 'WARNING EAZ, EBZ: neither source distinguishes' in format_comparison(to_dict(longer))
    assert to_dict(longer)['translations_apart_by'] == ['EAZ', 'EBZ']


def test_a_direct_measurement_is_one_at_the_point_that_it_measured():
    tables = truth_of(some_machine())
    position = tables.motions['EXZ'].position
    value = np.full((1, 2, len(position), 6), np.nan)
    for k in range(3):  # Z alone moves nothing at the origin of the tool side by its rotations
        value[..., k] = tables.motions[f'E{"XYZ"[k]}Z'].value
    readings = AxisReadings(position, value, np.zeros(3))
    measurement = DirectMeasurement({'Z': readings}, np.zeros(3))
    direct = source_of_measurement('direct', measurement, tables.machine)
    result = compare(source('t', tables), direct)
    assert {'EAZ', 'EBZ', 'ECZ'} <= set(result.common.folded)
    assert largest(result) < 1e-15
    np.testing.assert_array_equal(result.offsets[1], np.zeros(3))


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_a_perfect_instrument_finds_every_motion(chain):
    machine = some_machine(chain)
    tables = truth_of(machine)
    # nodes of the tables are multiples of 0.05 m and the ends of the ranges
    measurement = measure_directly(tables, 1, positions=61, noise=PERFECT)
    result = compare(
        source_of_measurement('direct', measurement, machine),
        source('truth', tables),
    )
    assert set(motions_of(result)) == set(MOTIONS)
    assert largest(result) < 1e-12


def test_a_realistic_instrument_agrees_within_its_uncertainty():
    machine, shares = some_machine(), []
    for seed in range(20):
        tables = truth_of(machine, seed)
        measurement = measure_directly(tables, seed, positions=6)
        result = compare(
            source_of_measurement('direct', measurement, machine),
            source('truth', tables),
        )
        # between its positions an instrument knows nothing
        seen = [
            m.normalised[np.isin(m.position.round(9), measurement.axes[n[2]].position.round(9))]
            for n, m in motions_of(result).items()
        ]
        values = np.concatenate(seen)
        shares.append(np.mean(values[np.isfinite(values)] <= 1.0))
    # k = 2: 95 %; nodes of a motion share their zero, so a seed tells little: 4 times 1 %
    assert 0.91 < np.mean(shares) < 0.99


def test_normalised_error_by_hand():
    found = normalised_error(np.array([3e-6, -1e-6, 0.0]), np.array([1e-6, 2e-6, 0.0]))
    np.testing.assert_allclose(found[:2], [1.5, 0.25])
    assert np.isnan(found[2])


def test_without_any_uncertainty_nothing_is_said_to_agree(tmp_path, capsys):
    tables = truth_of(some_machine())
    exact = {n: replace(t, u=0.0 * t.u) for n, t in tables.motions.items()}
    tables = replace(tables, motions=exact)
    result = compared(tables, tables.scaled(1.5))
    assert largest(result) > 1e-6
    data = to_dict(result)
    assert data['volume']['within'] is None
    assert {m['within'] for m in data['motions'].values()} == {None}
    text = text_of(result)
    assert '100 %' not in text and 'neither source states an uncertainty' in text


def test_a_side_without_uncertainty_is_said_to_count_as_exact():
    tables = truth_of(some_machine())
    known = {n: replace(t, u=1e-6 + 0.0 * t.u) for n, t in tables.motions.items()}
    result = compared(replace(tables, motions=known), tables)
    assert to_dict(result)['without_uncertainty'] == ['b']
    assert 'b states no uncertainty: E_n treats it as exact' in format_comparison(to_dict(result))
    both = replace(tables, motions=known)
    assert 'treats it as exact' not in text_of(compared(both, both))
    # the scatter of a single run is not known
    single = measure_directly(tables, 1, runs=1, noise=PERFECT)
    direct = source_of_measurement('d', single, tables.machine)
    found = compare(direct, source('t', both))
    assert found.without_u == ('a',)


def test_uncertainty_takes_the_covariance_along():
    machine = some_machine()
    tables = zero_tables(machine, 5)
    size = 3 + 5 * len(MOTIONS)
    together = np.zeros((size, size))
    place = 3 + 5 * MOTIONS.index('EXX')
    together[place : place + 5, place : place + 5] = 1e-12  # an offset common to all nodes
    a = source('a', tables, together)
    result = compare(a, source('b', tables))
    assert result.errors['EXX'].u_a.max() < 1e-12
    independent = compare(
        source('a', tables, np.diag(np.diag(together))),
        source('b', tables),
    )
    np.testing.assert_allclose(independent.errors['EXX'].u_a[1:], np.sqrt(2) * 1e-6)


def test_only_the_common_range_is_compared():
    machine = some_machine()
    tables = truth_of(machine)
    short = {
        n: replace(t, position=t.position[1:-1], value=t.value[1:-1], u=t.u[1:-1])
        if n[2] == 'X' else t
        for n, t in tables.motions.items()
    }  # fmt: skip
    result = compared(tables, replace(tables, motions=short))
    np.testing.assert_allclose(result.common.position['X'][[0, -1]], [0.05, 0.25])
    assert largest(result) < 1e-15
    assert result.common.grid[:, 0].min() == pytest.approx(0.05)


def test_other_machines_are_refused():
    with pytest.raises(ConfigError, match='different machines'):
        compared(truth_of(some_machine()), truth_of(some_machine('w-Y-b-X-Z-t')))


def test_command_compares_tables_with_a_direct_measurement(tmp_path, capsys):
    machine = some_machine()
    tables = truth_of(machine)
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump(machine.to_dict()))
    (tmp_path / 'tables.json').write_text(json.dumps(tables_to_dict(tables)))
    (tmp_path / 'points.csv').write_text('x,y,z\n0.1,0.1,-0.1\n0.2,0.1,-0.1\n')
    write_direct_csv(tmp_path / 'd.csv', measure_directly(tables, 1))
    pair = [str(tmp_path / 'd.csv'), str(tmp_path / 'tables.json')]
    options = ['--points', str(tmp_path / 'points.csv'), '--out', str(tmp_path / 'out')]
    assert cli.main(['compare', pair[0], pair[0], *options]) == 2
    assert '--machine' in capsys.readouterr().err
    assert cli.main(['compare', *pair, *options]) == 0
    assert 'volume, 2 points' in capsys.readouterr().out
    data = json.loads((tmp_path / 'out' / 'comparison.json').read_text())
    assert data['schema'] == 'otf-comparison/2'
    assert data['volume']['points'] == 2
    assert data['motions']['EXX']['largest_difference'] < 2e-6
    assert {f.name for f in (tmp_path / 'out').iterdir()} == {
        'comparison.json', 'manifest.json', 'report.html',
    }  # fmt: skip


def test_error_vectors_of_both_are_those_at_the_target_of_the_first():
    tables = truth_of(some_machine())
    moved = replace(tables, machine=some_machine(offset=(0.1, 0.05, -0.3)))
    result = compared(tables, moved)
    volume = result.volume
    assert mean_length(volume.difference) < 1e-12 < mean_length(volume.a)
    assert 'both at the target offset of a, (20, -30, -150) mm; that of b is (100' in text_of(
        result
    )
    assert 'both at' not in text_of(compared(tables, tables))


def test_a_comparison_says_whether_squareness_was_known():
    machine = some_machine()
    tables = truth_of(machine)
    known = to_dict(compared(tables, tables.scaled(1.1)))
    ratio = known['volume_with_squareness']
    assert ratio['mae_difference'] == pytest.approx(0.1 * ratio['mae_a'])
    direct = source_of_measurement('d', measure_directly(tables, 1), machine)
    unknown = to_dict(compare(direct, source('t', tables)))
    assert 'volume_with_squareness' not in unknown


# ---------------------------------------------------------------- squareness and page


def with_squareness(tables, **values):
    own = {k: replace(s, value=values.get(k, s.value)) for k, s in tables.squareness.items()}
    return replace(tables, squareness=own)


def test_squareness_is_compared_after_the_same_gauge():
    tables = truth_of(some_machine())
    turned = changed(tables, EYX=lambda q: 4e-5 * q)  # +X leans to +Y: the angle is smaller
    square = tables.squareness['C0Y'].value
    same = compared(tables, with_squareness(turned, C0Y=square + 4e-5))
    other = compared(tables, turned)
    for name in ('C0Y', 'B0Z', 'A0Z'):
        assert abs(same.errors[name].difference[0]) < 1e-12, name
    assert other.errors['C0Y'].difference[0] == pytest.approx(-4e-5, abs=1e-12)
    assert abs(other.errors['B0Z'].difference[0]) < 1e-12


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_constants_of_rotations_go_into_squareness_of_every_chain(chain):
    tables = truth_of(some_machine(chain))
    sizes = {m: 1e-6 * (7 + 5 * k) for k, m in enumerate(MOTIONS) if m[1] in 'ABC'}
    other = changed(tables, **{m: lambda q, size=size: size for m, size in sizes.items()})
    result = compared(tables, other)
    q = result.common.grid
    field = error_of(other, q) - error_of(tables, q)
    shear = np.zeros_like(field)
    found = {name: result.errors[name].difference[0] for name in result.common.scalars}
    shear[:, 0] = -found['C0Y'] * q[:, 1] + found['B0Z'] * q[:, 2]
    shear[:, 1] = -found['A0Z'] * q[:, 2]
    rest = field - shear
    rigid = np.linalg.lstsq(np.c_[np.ones(len(q)), q], rest, rcond=None)[0][1:]
    np.testing.assert_allclose(rigid + rigid.T, 0.0, atol=1e-12)
    assert np.abs(shear).max() > 1e-7


def test_normalised_error_of_squareness_is_that_of_both_uncertainties():
    machine = some_machine()
    a, b = zero_tables(machine), zero_tables(machine)
    a = replace(a, squareness={**a.squareness, 'C0Y': ScalarError(1e-5, 2e-6)})
    b = replace(b, squareness={**b.squareness, 'C0Y': ScalarError(-5e-6, 1.5e-6)})
    one = compared(a, b).errors['C0Y']
    assert (one.a[0], one.b[0]) == (pytest.approx(1e-5), pytest.approx(-5e-6))
    assert one.normalised[0] == pytest.approx(1.5e-5 / (2 * 2.5e-6))
    data = to_dict(compared(a, b))['squareness']['C0Y']
    assert data['normalised_error'] == pytest.approx(3.0)
    assert re.search(
        r'^C0Y +urad +15\.00 .* 3\.00 +0 %$',
        text_of(compared(a, b)),
        re.M,
    )


def test_squareness_that_one_side_does_not_know_is_not_compared():
    tables = truth_of(some_machine())
    a = source('a', tables, None, ('A0Z',))
    result = compare(a, source('b', tables))
    assert result.common.scalars == ('C0Y', 'B0Z')
    assert 'not compared: A0Z: a does not determine it' in format_comparison(to_dict(result))


def test_a_comparison_writes_a_page_like_the_others(tmp_path):
    machine = some_machine()
    a = replace(zero_tables(machine), squareness={
        **zero_tables(machine).squareness, 'C0Y': ScalarError(1e-5, 2e-6)})  # fmt: skip
    write_document(document_of(compared(a, truth_of(machine)), provenance('compare')), tmp_path)
    source = (tmp_path / 'report.html').read_text(encoding='utf-8')
    page = Page(source)
    assert page.faults == [] and unloading(source) == []
    assert 'differ beyond U' in page.text
    rows = {row[0]: row for row in page.rows('Error by error')}
    assert list(rows) == [*MOTIONS, 'C0Y', 'B0Z', 'A0Z']
    assert float(rows['C0Y'][8]) > 1
    assert 'errors ×' in page.text
    assert '(m)' not in page.text and 'X (mm)' in page.text
