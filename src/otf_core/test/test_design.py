# SPDX-License-Identifier: Apache-2.0
"""Rows leg by leg: products, rows of touched unknowns and sums against whole dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import (
    leg_parts,
    observed,
    pieces_of,
    small_plan,
    some_machine,
    transform_pose,
    white,
    zero_tables,
)
from scipy.linalg import block_diag

from otf_core.effects.catalogue.machine import backlash, direction_dependent_tables
from otf_core.effects.state import state_of_travel
from otf_core.model.nodes import table_nodes
from otf_core.noise.noise_model import Misfit
from otf_core.solving.normal import sum_groups
from otf_core.solving.system import build_system
from otf_core.solving.unknowns import (
    is_reversal,
    layout,
    linear_bases,
    reversal_block,
    reversal_names,
    smooth_bases,
)
from otf_core.solving.whitener import Whitener


def cell(bases, *, reversal=0, spread=0.0, held=False):
    machine = some_machine()
    pose = transform_pose(machine, 3)
    path = small_plan(machine).path
    pieces = pieces_of(machine, path, zero_tables(machine), pose, size=0.03)
    count = len(pieces)
    rng = np.random.default_rng(4)
    pieces = replace(
        pieces,
        time=0.2 * np.arange(count) + pieces.leg,
        duration=np.full(count, 0.15),
        spread=rng.uniform(0.5, 1.5, count) * spread,
    )
    nodes = table_nodes(machine, machine.lower, machine.upper)
    names = reversal_names(machine.motions, reversal)
    unknowns = layout(bases(machine, nodes), 1, names, held=held)
    return machine, pieces, unknowns, build_system(observed(machine, pieces, pose), unknowns)


CASES = {
    'hats': (linear_bases, {}),
    'splines, means over pieces': (smooth_bases, {'spread': 0.009}),
    'reversal': (linear_bases, {'reversal': 3, 'spread': 0.009}),
}


@pytest.fixture(params=CASES, scope='module')
def case(request):
    bases, given = CASES[request.param]
    return cell(bases, **given)


def close(found, wanted):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize('held', [False, True], ids=['returns at standstill', 'held'])
def test_reversal_coefficients_act_as_the_effects_of_their_names(held):
    machine, pieces, unknowns, system = cell(linear_bases, reversal=4, held=held)
    dense = system.rows.dense(slice(None))
    assert np.any(pieces.side[pieces.direction == 0.0])
    state = replace(state_of_travel(machine, system.q, pieces.direction), side=pieces.side)
    own = {
        reversal_block(f'E{axis}{axis}', 0): column
        for axis, column in zip(
            'XYZ', backlash.terms(state, {'held': held}).columns.T, strict=True
        )
    }
    tables = direction_dependent_tables.terms(state, {'held': held, 'order': 3.0})
    own |= dict(zip(tables.names, tables.columns.T, strict=True))
    assert set(own) == {name for name in unknowns.blocks if is_reversal(name)}
    for name, column in own.items():
        across = np.einsum('cpi,ip->cp', system.axes, column)
        close(dense[:, :, unknowns.blocks[name].start], across)


def test_mean_over_a_piece_is_that_of_its_two_gauss_points():
    _, pieces, unknowns, _ = cell(smooth_bases)
    machine, pose = some_machine(), transform_pose(some_machine(), 3)
    spread = np.full(len(pieces), 0.008)
    both = build_system(observed(machine, replace(pieces, spread=spread), pose), unknowns)
    value = np.random.default_rng(6).standard_normal(unknowns.full)
    single = []
    for sign in (1, -1):
        # the same pieces, moved along their lines as a whole
        reach = sign * 0.008 * pieces.direction
        xyz = pieces.xyz + reach @ pose.rotation
        moved = build_system(observed(machine, replace(pieces, xyz=xyz), pose), unknowns)
        single.append(moved.rows.times(value))
    close(both.rows.times(value), 0.5 * (single[0] + single[1]))


def test_sums_of_groups_are_those_of_generalised_least_squares(case):
    machine, pieces, unknowns, system = case
    noise, misfit = white(machine), Misfit(4e-7, 9e-7)
    whitener = Whitener.of(system, pieces, noise, misfit)
    extra = np.random.default_rng(7).standard_normal((2, len(pieces), 2)) * 1e-3
    group = np.arange(len(whitener.bounds)) % 3
    found = sum_groups(system, unknowns, whitener, group, extra)
    free = system.rows.dense(slice(None)) @ unknowns.gauge.toarray()
    whole = np.concatenate([free, extra, system.deviation[..., None]], axis=2)
    for g, own in enumerate(found):
        total = 0.0
        for (low, high), mine in zip(whitener.bounds, group, strict=True):
            if mine != g:
                continue
            blocks = [
                sum(leg_parts(system, pieces, noise, misfit, c, low, high)) for c in range(2)
            ]
            rows = whole[:, low:high].reshape(-1, whole.shape[2])
            total = total + rows.T @ np.linalg.solve(block_diag(*blocks), rows)
        scale = np.sqrt(np.diag(total))
        unit = np.outer(scale, scale)
        np.testing.assert_allclose(own.matrix / unit[:-1, :-1], (total / unit)[:-1, :-1],
                                   rtol=0, atol=1e-11)  # fmt: skip
        assert own.square == pytest.approx(total[-1, -1], rel=1e-10)
        laps = [high - low for (low, high), mine in zip(whitener.bounds, group, strict=True)
                if mine == g]  # fmt: skip
        assert own.rows == 2 * sum(laps)


def moments_of(whitener):
    """What is held of the covariance of every leg."""
    found = {}
    for alike in whitener.alike:
        found |= {leg: alike.only(alike.legs == leg).moments for leg in alike.legs.tolist()}
    return [found[k] for k in range(len(whitener.bounds))]


def test_whitened_noise_is_white_whatever_the_lengths_of_the_legs(case):
    machine, pieces, _, system = case
    whitener = Whitener.of(system, pieces, white(machine), Misfit(4e-7, 9e-7))
    assert len({high - low for low, high in whitener.bounds}) > 1
    values = np.random.default_rng(8).standard_normal((2, len(pieces)))
    close(whitener.unwhiten(whitener.whiten(values)), values)
    moments = moments_of(whitener)
    for k, (low, high) in enumerate(whitener.bounds):
        for c, factor in enumerate(whitener.factors[k]):
            covariance = sum(
                leg_parts(system, pieces, white(machine), Misfit(4e-7, 9e-7), c, low, high)
            )
            close(factor @ factor.T, covariance)
            close(whitener.expected[c, low:high], np.sqrt(np.diag(covariance)))
            close(moments[k].square[c, 0], np.sum(covariance**2))
            wanted = np.linalg.solve(covariance, values[c, low:high])
            close(whitener.weighted(values)[c, low:high], wanted)
    factor = np.random.default_rng(9).uniform(0.5, 2.0, values.shape)
    scaled = whitener.scaled(factor)
    close(scaled.unwhiten(values), factor * whitener.unwhiten(values))
    close(scaled.expected, factor * whitener.expected)
    again = Whitener.from_factors(whitener.bounds, whitener.factors)
    close(again.whiten(values), whitener.whiten(values))
    for one, other in zip(moments, moments_of(again), strict=True):
        close(one.square, other.square)
