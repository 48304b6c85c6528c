# SPDX-License-Identifier: Apache-2.0
"""Comparison of error tables and direct measurements: convention, levers, E_n, command."""

import re
from dataclasses import replace

import numpy as np
import pytest
from core_cells import CONTRACT_CHAINS, constant_tables, error_of, some_machine, zero_tables
from direct_instrument import InstrumentNoise, measure_directly

from otf_core.comparison.compare import (
    compare,
    source_of_measurement,
    source_of_tables,
)
from otf_core.comparison.document import document_of
from otf_core.errors import ConfigError
from otf_core.model.evaluation import without_rigid_motion
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS
from otf_core.model.tables import ScalarError
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    PackedCovariance,
)
from otf_core.reports.comparison import (
    format_comparison,
)
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
