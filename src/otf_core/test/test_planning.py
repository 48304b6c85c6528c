# SPDX-License-Identifier: Apache-2.0
"""Planned path: sees all that can be seen, stays inside, runs forward and reverse."""

import numpy as np
import pytest
from core_cells import (
    fit_pieces,
    pieces_of,
    some_machine,
    transform_pose,
    zero_tables,
)

from otf_core.config import PlannerConfig
from otf_core.errors import InputError
from otf_core.model.machine import machine_from_dict
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.plan import Plan, check_inside
from otf_core.planning.findings import findings
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.path_creation import plan_path
from otf_core.solving.solution import determined_by_data

# A rotation can be told from a translation of the same axis only through the travel of another
# axis in its lever arm, and not if that travel is parallel to its own axis of rotation; with
# nothing but its own travel it acts as a function of one position, as the translation does.
NEVER_SEEN = {
    # Z carries the target alone; of Y's lever (z) the rotation about Z sees nothing
    'w-b-X-Y-Z-t': {'ECY', 'EAZ', 'EBZ', 'ECZ'},
    # X's lever is z alone
    'w-Y-b-X-Z-t': {'ECX', 'EAZ', 'EBZ', 'ECZ'},
    # Y's lever is z and its own y
    'w-X-Y-b-Z-t': {'ECY', 'EAZ', 'EBZ', 'ECZ'},
    # Z next to the base has its own z only, Y has y and z
    'w-X-Y-Z-b-t': {'ECY', 'EAZ', 'EBZ', 'ECZ'},
    # X carries the target alone, Y's lever is x
    'w-Z-b-Y-X-t': {'EAX', 'EBX', 'ECX', 'EAY'},
    # Y carries the target alone, Z's lever is y
    'w-X-b-Z-Y-t': {'EAY', 'EBY', 'ECY', 'EBZ'},
}


@pytest.mark.parametrize('chain', sorted(NEVER_SEEN))
@pytest.mark.parametrize('levels', [2, 3])
def test_plan_sees_all_but_what_no_path_could_show(chain, levels):
    machine = some_machine(chain)
    path = plan_path(machine, PlannerConfig(levels=levels, passes=1)).path
    pose = transform_pose(machine, seed=levels)
    pieces = pieces_of(machine, path, zero_tables(machine), pose, size=0.025)
    fit = fit_pieces(machine, pieces, pose, iterations=1)
    assert fit.missing == NEVER_SEEN[chain]
    every = np.eye(fit.unknowns.full)
    known = determined_by_data(fit.normal, fit.unknowns, fit.solution.accepted, 1e-4, every)
    for name in (*SQUARENESS, *MOTIONS):
        if name not in fit.missing:
            assert known[fit.unknowns.blocks[name]].all(), name


@pytest.mark.parametrize('levels', [2, 3, 5])
def test_plan_stays_inside_and_reaches_every_end(levels):
    machine = some_machine()
    points = plan_path(machine, PlannerConfig(levels=levels)).path.points
    np.testing.assert_allclose(points.min(axis=0), machine.lower, atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), machine.upper, atol=1e-15)


@pytest.mark.parametrize('passes', [1, 2, 3, 4])
def test_laps_alternate_in_direction_and_feed(passes):
    machine = some_machine()
    one = plan_path(machine, PlannerConfig(passes=1)).path.points
    plan = plan_path(machine, PlannerConfig(passes=passes, feed=0.2, feed_ratio=0.5))
    legs = len(one) - 1
    assert len(plan.path.points) == passes * legs + 1
    for k in range(passes):
        lap = plan.path.points[k * legs : (k + 1) * legs + 1]
        np.testing.assert_array_equal(lap, one if k % 2 == 0 else one[::-1])
        assert set(plan.feed[k * legs : (k + 1) * legs]) == {0.2 if k % 2 == 0 else 0.1}


def test_plan_stops_at_corners_and_longer_at_both_ends():
    plan = plan_path(some_machine(), PlannerConfig(corner_dwell=0.3, end_dwell=4.0))
    assert plan.dwell[0] == plan.dwell[-1] == 4.0
    assert set(plan.dwell[1:-1]) == {0.3}
    assert len(plan.dwell) == len(plan.path.points) == len(plan.feed) + 1


def test_plan_holds_lines_that_are_no_box_diagonals():
    machine = some_machine()
    size = machine.upper - machine.lower
    steps = np.abs(np.diff(plan_path(machine, PlannerConfig()).path.points, axis=0)) / size
    partial = (steps > 1e-9).sum(axis=1) >= 2
    ratio = steps.max(axis=1) / np.where(steps > 1e-9, steps, np.inf).min(axis=1)
    # half slope: one axis moves twice the share of its range that another does
    for axis in range(3):
        assert np.any(partial & (ratio > 1.9) & (steps[:, axis] > 1e-9))


@pytest.mark.parametrize(('axis', 'name'), [(0, 'X'), (1, 'Y'), (2, 'Z')])
@pytest.mark.parametrize('side', [-1, 1])
def test_path_outside_the_ranges_names_point_axis_and_excess(axis, name, side):
    machine = some_machine()
    points = np.tile(0.5 * (machine.lower + machine.upper), (3, 1))
    points[:, (axis + 1) % 3] += [0, 0.05, 0]
    points[2, axis] = (machine.upper if side > 0 else machine.lower)[axis] + side * 0.004
    with pytest.raises(InputError, match=rf'point 2 leaves the range of axis {name} by 4\.000 mm'):
        check_inside(Plan.along(points, [0.1, 0.1], [0, 0, 0]), machine)


@pytest.mark.parametrize(
    ('chain', 'hidden', 'needs'),
    [
        ('w-b-X-Y-t', {'EBX', 'EAY', 'EBY', 'ECY'}, 'target offset'),
        ('w-b-X-t', {'EXX', 'EAX', 'EBX', 'ECX'}, 'stops'),
    ],
)
def test_a_gantry_and_a_plotter_plan_and_say_what_they_hide(chain, hidden, needs):
    axes = {a: {'min': 0.0, 'max': 0.5, 'table_pitch': 0.1} for a in 'XY' if a in chain}
    machine = machine_from_dict({
        'name': 'flat', 'chain': chain, 'axes': axes, 'target_offset': [0.0, 0.0, -0.1],
        'tracker': {'u_range': 5e-7, 'u_angle': 2e-6},
    })  # fmt: skip
    plan, setup = plan_path(machine, PlannerConfig()), Setup.of(machine)
    found = forecast(plan, setup)
    assert set(found.not_identifiable) == hidden
    assert any(needs in f.needs for f in findings(plan, found, setup.limit))
