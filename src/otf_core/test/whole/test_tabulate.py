# SPDX-License-Identifier: Apache-2.0
"""From smooth functions to tables: nearest in the mean square, gauge at the nodes, fine enough."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.model.motions import MOTIONS, ErrorMotion
from otf_core.model.nodes import table_nodes
from otf_core.sim.cell import random_tables
from otf_core.solving.normal import NormalEquations
from otf_core.solving.tabulate import (
    FRACTIONS,
    MAX_SHARE_OF_U,
    projection,
    tabulate,
    unseen_bends,
)
from otf_core.solving.unknowns import (
    cubic,
    layout,
    linear_bases,
    reference_position,
    smooth_bases,
)

LIMIT = 1e-4
RANGE = np.array([0.0, 1.0])


def test_best_table_of_a_parabola_is_off_by_a_twelfth_of_its_second_difference_at_nodes():
    """In between it is off by a 24th, the other way."""
    basis, nodes, h = cubic(RANGE, 20), np.linspace(0.0, 1.0, 26), 0.04
    coefficients = basis.from_values @ (basis.centres * (basis.centres - 1.0))  # f'' = 2
    values = projection(ErrorMotion.of('EYX'), basis, nodes) @ coefficients
    inner = slice(8, -8)  # what the ends do fades by 2 - sqrt(3) from node to node
    off = values - nodes * (nodes - 1.0)
    np.testing.assert_allclose(off[inner], -(h**2) * 2 / 12, rtol=1e-4)
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    amid = 0.5 * (values[1:] + values[:-1]) - middle * (middle - 1.0)
    np.testing.assert_allclose(amid[inner], h**2 * 2 / 24, rtol=1e-4)


@pytest.mark.parametrize('ends', [(0.0, 0.5), (-0.2, 0.3), (0.1, 0.6)])
@pytest.mark.parametrize('motion', [ErrorMotion.of(m) for m in ('EXX', 'EYX', 'ECX')])
def test_tables_keep_the_gauge_exactly(motion, ends):
    rng, nodes = np.random.default_rng(1), np.linspace(*ends, 7)
    basis = cubic(np.array(ends), 20)
    value = projection(motion, basis, nodes) @ rng.standard_normal(basis.size)
    assert np.abs(value).max() > 0.1
    if motion.is_straightness:
        assert value[0] == 0.0
        assert value[-1] == 0.0
    else:
        at = reference_position(*ends)
        assert np.interp(at, nodes, value) == pytest.approx(0.0, abs=1e-14)


def test_table_is_the_nearest_of_all():
    rng, nodes = np.random.default_rng(2), np.linspace(0.0, 1.0, 8)
    basis = cubic(RANGE, 20)
    coefficients = rng.standard_normal(basis.size)
    coefficients -= coefficients[0]
    best = projection(ErrorMotion.of('EXX'), basis, nodes) @ coefficients
    q = (np.arange(20_000) + 0.5) / 20_000

    def off(values):
        return np.mean((basis.matrix(q) @ coefficients - np.interp(q, nodes, values)) ** 2)

    for node in range(1, 8):
        for step in (-1e-2, 1e-2):
            assert off(best + step * np.eye(8)[node]) > off(best)


def curved(pitch, waves=1.5, size=2e-5):
    """A solution with sines for motions, as if solved for; nodes of ``pitch``."""
    machine = some_machine(pitch=pitch)
    unknowns = layout(smooth_bases(machine, table_nodes(machine, machine.lower, machine.upper)))
    full = np.zeros(unknowns.full)
    for k, name in enumerate(MOTIONS):
        basis = unknowns.bases[name[2]]
        low, high = basis.knots[[0, -1]]
        x = (basis.centres - low) / (high - low)
        value = size * np.sin(2 * np.pi * waves * x + k)
        if name.is_straightness:
            value -= (1 - x) * value[0] + x * value[-1]
        else:
            reference = (reference_position(low, high) - low) / (high - low)
            value -= size * np.sin(2 * np.pi * waves * reference + k)
        full[unknowns.blocks[name]] = basis.from_values @ value
    free = unknowns.free
    normal = NormalEquations(1e20 * np.eye(free), np.zeros(free), 0.0, 0)
    solution = SimpleNamespace(value=full, accepted=tuple(unknowns.blocks))
    return machine, SimpleNamespace(unknowns=unknowns, solution=solution, normal=normal)


def test_cost_falls_with_the_square_of_the_spacing_and_is_what_is_stated():
    """0.037 h^2 f'' in root mean square (docs/formulation.md, section 12)."""
    pitches = (0.025, 0.0125, 0.00625)
    costs = [tabulate(*curved(pitch, waves=1.0), 1.0, LIMIT).costs[1] for pitch in pitches]
    grids = [c.grid for c in costs]
    assert grids[0] / grids[1] == pytest.approx(4.0, rel=0.15)
    assert grids[1] / grids[2] == pytest.approx(4.0, rel=0.1)
    bend = 2e-5 * (2 * np.pi / 0.25) ** 2 / np.sqrt(2)
    for name in ('ECY', 'EYY', 'EXY'):
        stated = 0.0373 * 0.00625**2 * bend  # whole waves; the gauge at the ends costs some more
        assert stated < costs[2].motions[name] < 1.08 * stated


@pytest.mark.parametrize('u', [2e-6, 6e-7])
def test_the_coarsest_spacing_that_costs_little_is_taken(u):
    machine, done = curved(0.1)
    found = tabulate(machine, done, u, LIMIT)
    assert found.fraction > 1
    assert found.costs[found.fraction].grid <= MAX_SHARE_OF_U * u
    assert found.costs[1].grid > MAX_SHARE_OF_U * u
    assert set(found.costs) == {1, found.fraction}
    before = FRACTIONS[FRACTIONS.index(found.fraction) - 1]
    coarser = replace_pitch(machine, 0.1 / before)
    assert tabulate(coarser, done, 1.0, LIMIT).costs[1].grid > MAX_SHARE_OF_U * u
    spacing = np.diff(found.tables.motions['EXX'].position)
    np.testing.assert_allclose(spacing, 0.1 / found.fraction, rtol=1e-9)


def replace_pitch(machine, pitch):
    axes = {a: replace(axis, table_pitch=pitch) for a, axis in machine.axes.items()}
    return replace(machine, axes=axes)


def bends_of(truth, hidden):
    """Mean square of what tables do not follow of translations by turns over the own travel."""
    machine, square = truth.machine, dict.fromkeys(MOTIONS, 0.0)
    for m in hidden:
        table = truth.motions[m]
        q = np.linspace(table.position[0], table.position[-1], 4001)
        point = np.zeros((len(q), 3))
        if m.axis in machine.chain.table_side:
            point[:, m.place] = q
        moved = np.cross(np.eye(3)[m.along] * table.at(q)[:, None], point)
        for k, axis in enumerate('XYZ'):
            hats = np.stack(
                [np.interp(q, table.position, one) for one in np.eye(len(table.value))]
            ).T
            off = moved[:, k] - hats @ np.linalg.lstsq(hats, moved[:, k], rcond=None)[0]
            square[f'E{axis}{m.axis}'] += np.mean(off**2)
    return {m: v for m, v in square.items() if v > 1e-20}


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-X-Y-b-Z-t', 'w-Z-Y-X-b-t'])
def test_what_unseen_rotations_bend_between_straight_nodes_is_as_large_as_stated(chain):
    """A rotation of a table axis turns the target about where its axis stands."""
    machine = some_machine(chain, ((0.5, 0.9), (-0.8, -0.4), (-0.7, -0.3)), pitch=0.1)
    unknowns = layout(linear_bases(machine, table_nodes(machine, machine.lower, machine.upper)))
    carried = {a: set(machine.chain.lever_axes(a)) - {a} for a in machine.axis_names}
    turns = [m for m in MOTIONS if not m.is_translation]
    hidden = {m for m in turns if carried[m.axis] <= {machine.axis_names[m.along]}}
    seen, stated, real = tuple(m for m in MOTIONS if m not in hidden), 0.0, 0.0
    for seed in range(20):
        truth = random_tables(machine, 1e-4, np.random.default_rng(seed))
        value = np.zeros(unknowns.full)
        for m in MOTIONS:
            value[unknowns.blocks[m]] = truth.motions[m].value
        solution = SimpleNamespace(value=value, accepted=seen)
        found = unseen_bends(machine, SimpleNamespace(unknowns=unknowns, solution=solution))
        own = bends_of(truth, hidden)
        assert set(found) == set(own)
        stated += sum(v**2 for v in found.values())
        real += sum(own.values())
    assert (real > 0.0) == (chain != 'w-b-X-Y-Z-t')
    assert real == 0.0 or stated / real == pytest.approx(1.0, abs=0.35)
