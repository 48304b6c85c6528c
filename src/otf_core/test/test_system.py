# SPDX-License-Identifier: Apache-2.0
"""System of equations: rows against finite differences, deviations against what was put in."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import (
    CONTRACT_CHAINS,
    error_of,
    observed,
    pieces_of,
    small_plan,
    some_machine,
    transform_pose,
    white,
    zero_tables,
)
from nature import influences

from otf_core.model.chain import Sight
from otf_core.model.motions import MOTIONS
from otf_core.model.nodes import table_nodes
from otf_core.model.tables import MotionTable, ScalarError
from otf_core.noise.noise_model import MODEL_FLOOR
from otf_core.sim.cell import random_tables
from otf_core.solving.normal import normal_equations
from otf_core.solving.system import build_system, model_rows, positions_on_path
from otf_core.solving.unknowns import layout, linear_bases, smooth_bases
from otf_core.solving.whitener import Whitener

ALL_CHAINS = (*CONTRACT_CHAINS, 'w-Z-Y-X-b-t')


def coarse_splines(machine, nodes):
    return smooth_bases(machine, nodes, 5)


def system_of(machine, tables, pose=None, seed=0, known=None, bases=linear_bases):
    pose = pose or transform_pose(machine, seed)
    pieces = pieces_of(machine, small_plan(machine).path, tables, pose, size=0.06)
    unknowns = layout(bases(machine, table_nodes(machine, machine.lower, machine.upper)))
    return pieces, unknowns, build_system(observed(machine, pieces, pose), unknowns, known)


@pytest.mark.parametrize(
    ('bases', 'exact'), [(linear_bases, 1e-12), (coarse_splines, 3e-6)], ids=['hats', 'splines']
)
@pytest.mark.parametrize('chain', ALL_CHAINS)
def test_columns_of_errors_are_derivatives_of_the_error_model(chain, bases, exact):
    machine = some_machine(chain)
    _, unknowns, system = system_of(machine, zero_tables(machine), bases=bases)
    design = system.design.toarray().reshape(2, len(system.q), -1)
    rng = np.random.default_rng(1)
    rows = rng.choice(len(system.q), 12, replace=False)
    base = zero_tables(machine)
    for name in (*MOTIONS, 'C0Y', 'B0Z', 'A0Z'):
        block = unknowns.blocks[name]
        for k in range(block.stop - block.start):
            # the model is linear in the unknowns: a difference of any size is the derivative
            if name in MOTIONS:
                basis = unknowns.bases[name[2]]
                # straight lines between such places: off by 6 / 8 / 512^2 at most
                place = basis.finer(1 if exact < 1e-9 else 512)
                value = basis.matrix(place)[:, k]
                table = MotionTable(place, value, 0 * value)
                tables = replace(base, motions={**base.motions, name: table})
            else:
                tables = replace(base, squareness={**base.squareness, name: ScalarError(1.0)})
            expected = np.einsum(
                'cpi,pi->cp', system.axes[:, rows], error_of(tables, system.q[rows])
            )
            found = design[:, rows, block.start + k]
            np.testing.assert_allclose(found, expected, atol=exact, err_msg=name)


def test_columns_of_the_pose_take_off_a_motion_of_the_tracker():
    machine = some_machine()
    pose = transform_pose(machine, 0)
    _, unknowns, system = system_of(machine, zero_tables(machine), pose)
    columns = system.design.toarray()[:, :6]  # the pose comes first
    pieces, _, _ = system_of(machine, zero_tables(machine), pose)
    for k in range(6):
        small = np.zeros(6)
        small[k] = 1e-6
        moved = pose.moved_by(small[:3], small[3:])
        shifted = build_system(observed(machine, pieces, moved), unknowns)
        change = np.einsum('kij,ij->ki', system.axes, moved.apply(pieces.xyz) - shifted.q)
        change -= np.einsum('kij,ij->ki', system.axes, pose.apply(pieces.xyz) - system.q)
        # a correction of the pose undoes the motion; second order is 1e-12
        np.testing.assert_allclose(columns[:, k] * 1e-6, -change.reshape(-1), atol=5e-12)


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_deviations_are_the_errors_across_the_path(chain):
    machine = some_machine(chain)
    truth = random_tables(machine, 2e-5, np.random.default_rng(0))
    # positions are derived with the tables known, as in the last iteration
    _, _, system = system_of(machine, truth, known=truth)
    expected = np.einsum('cpi,pi->cp', system.axes, error_of(truth, system.q))
    # the position along the path is found to 1e-4 of the errors, which are 1e-4
    np.testing.assert_allclose(system.deviation, expected, atol=1e-10)


def test_positions_lie_on_their_legs_even_with_errors_along_them():
    machine = some_machine()
    truth = random_tables(machine, 1e-4, np.random.default_rng(2))
    pose = transform_pose(machine, 0)
    pieces = pieces_of(machine, small_plan(machine).path, truth, pose, size=0.06)
    exact = pieces_of(machine, small_plan(machine).path, zero_tables(machine), pose, size=0.06)
    programmed = pose.apply(exact.xyz)
    sight, points = Sight.of_tool(machine), pose.apply(pieces.xyz)
    found = positions_on_path(sight, pieces, points, truth)
    nearest = positions_on_path(sight, pieces, points, None)
    # without tables it is off by the error along the path, some 100 um; with them by 1e-3 of it
    assert np.abs(nearest - programmed).max() > 5e-5
    np.testing.assert_allclose(found, programmed, atol=1e-7)


def test_normal_equations_of_independent_samples_are_the_weighted_sums_of_the_paper():
    machine = some_machine()
    truth = random_tables(machine, 2e-5, np.random.default_rng(4))
    pose = transform_pose(machine, 0)
    pieces, unknowns, system = system_of(machine, truth, pose)
    found = normal_equations(system, unknowns, Whitener.of(system, pieces, white(machine)))
    spec = machine.tracker
    reach = np.linalg.norm(pieces.xyz, axis=1)
    cosine = np.einsum('cpi,pi->cp', system.axes, pose.rotate(pieces.xyz)) / reach
    variance = (spec.u_range * cosine) ** 2 + (spec.u_angle * reach) ** 2 * (1 - cosine**2)
    weight = 1 / (variance / pieces.count + MODEL_FLOOR**2).reshape(-1)
    rows = system.design.toarray() @ unknowns.gauge.toarray()
    matrix = rows.T @ (weight[:, None] * rows)
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-12 * np.abs(matrix).max())
    right = rows.T @ (weight * system.deviation.reshape(-1))
    np.testing.assert_allclose(found.right, right, atol=1e-12 * np.abs(right).max())
    assert found.square == pytest.approx(np.sum(weight * system.deviation.reshape(-1) ** 2))
    assert found.rows == 2 * len(pieces)


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_rows_of_the_volumetric_error_are_those_of_the_contract(chain):
    machine = some_machine(chain)
    rng = np.random.default_rng(5)
    unknowns = layout(linear_bases(machine, table_nodes(machine, machine.lower, machine.upper)))
    tables = random_tables(machine, 2e-5, rng)
    q = rng.uniform(machine.lower, machine.upper, (6, 3))
    values = np.zeros(unknowns.full)
    for name in MOTIONS:
        values[unknowns.blocks[name]] = tables.motions[name].at(unknowns.knots[name[2]])
    for name, squareness in tables.squareness.items():
        values[unknowns.blocks[name]] = squareness.value
    expected = error_of(tables, q)
    np.testing.assert_allclose(model_rows(machine, unknowns, q) @ values, expected, atol=1e-15)


@pytest.mark.parametrize(('count', 'better'), [(40, 20.0), (2, 20.0)])
def test_a_piece_is_a_mean_over_its_samples_not_the_value_at_its_centre(count, better):
    """Waves of 67 mm, pieces of h = 30 mm: off by h^2 f2 / 24 at centres, h^4 f4 / 4320 here."""
    machine = some_machine()
    points, unknowns, at_centres = system_of(machine, zero_tables(machine), bases=smooth_bases)
    size = len(points)
    shares = (np.arange(count) + 0.5) / count - 0.5
    means = replace(points, spread=np.full(size, 0.03 * np.std(shares)))
    found = build_system(observed(machine, means, transform_pose(machine, 0)), unknowns)
    values = np.zeros(unknowns.full)
    for k, name in enumerate(MOTIONS):
        basis = unknowns.bases[name[2]]
        wave = 2 * np.pi * 3 * (basis.centres - basis.knots[0]) / np.ptp(basis.knots)
        values[unknowns.blocks[name]] = 1e-5 * (basis.from_values @ np.sin(wave + k))
    inner = np.all((found.q - 0.02 > machine.lower) & (found.q + 0.02 < machine.upper), axis=1)
    true = np.zeros((2, size))
    for share in shares:
        q = found.q + 0.03 * share * means.direction
        per_unit = influences(str(machine.chain), machine.target_offset, q)
        for name in MOTIONS:
            at = unknowns.bases[name[2]].matrix(q[:, 'XYZ'.index(name[2])])
            size = at @ values[unknowns.blocks[name]]
            true += np.einsum('cij,ij,i->ci', found.axes, per_unit[name], size) / count
    off, plain = (
        np.abs((s.design @ values).reshape(2, -1) - true)[:, inner].max()
        for s in (found, at_centres)
    )
    assert plain > 1e-7
    assert off < plain / better
