# SPDX-License-Identifier: Apache-2.0
"""The physics of every effect; what all have in common stands in ``test_effects_conform``."""

import dataclasses

import numpy as np
import pytest
from core_cells import some_machine
from effect_cells import (
    driven_state,
)

from otf_core.effects import REGISTRY
from otf_core.effects.state import probe_state, state_on_path
from otf_core.errors import ConfigError
from otf_core.model.frames import RigidTransform

CONTRACT = [
    'backlash',
    'direction_dependent_tables',
    'thermal_axis_expansion',
    'thermal_structure_drift',
    'cross_coupling',
    'servo_mismatch',
    'corner_rounding',
    'cyclic_error',
    'vibration',
    'table_resolution',
    'table_tilt',
    'target_offset',
    'target_incidence',
    'tracker_pose_drift',
    'tracker_scale',
    'tracker_range_offset',
    'tracker_angles',
    'tracker_noise',
]
"""Names that outside tools rely on."""


@pytest.fixture(scope='module')
def state():
    return driven_state()


def displacement(name, state, **parameters):
    return REGISTRY[name].displacement(state, parameters)


def at(state, **changes):
    """The same state with some of its arrays replaced."""
    return dataclasses.replace(state, **changes)


def test_names_of_the_contract_are_registered():
    assert set(CONTRACT) <= set(REGISTRY)


# ---------------------------------------------------------------- physics, effect by effect


def leg_state(points, q, leg, **given):
    """State of points ``q`` on the legs of a path, tracker at (-1, 0, 0) in machine axes."""
    machine = some_machine()
    q = np.atleast_2d(np.asarray(q, float))
    values = {'speed': np.full(len(q), 0.2), 'time': np.zeros(len(q))} | given
    pose = RigidTransform(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    nodes = probe_state(machine).nodes
    return state_on_path(
        machine, np.asarray(points, float), np.full(len(q), leg), q, values['speed'],
        values['time'], pose, nodes,
    )  # fmt: skip


DIAGONAL = ((0, 0, -0.2), (0.2, 0.2, -0.2), (0, 0, -0.2))
MIDDLE = (0.1, 0.1, -0.2)


def test_backlash_is_half_the_reversal_value_and_flips():
    there, back = (leg_state(DIAGONAL, MIDDLE, leg) for leg in (0, 1))
    half = [[1e-6, 0, 0]]
    np.testing.assert_allclose(displacement('backlash', there, B_X=2e-6, B_Z=9e-6), half)
    np.testing.assert_allclose(-displacement('backlash', back, B_X=2e-6, B_Z=9e-6), half)


def test_direction_dependent_tables_turn_about_the_lever():
    there, back = (leg_state(DIAGONAL, MIDDLE, leg) for leg in (0, 1))
    offset = there.machine.target_offset  # w-b-X-Y-Z-t: lever of Z is the target offset alone
    up = leg_state(((0, 0, -0.2), (0, 0, 0)), (0, 0, -0.1), 0)
    moved = displacement('direction_dependent_tables', up, EAZ_0=2e-5)
    np.testing.assert_allclose(moved[0], 1e-5 * np.cross([1, 0, 0], offset), atol=1e-18)
    one = displacement('direction_dependent_tables', there, EYX_1=2e-6, order=3.0)
    np.testing.assert_allclose(one, [[0, 1e-6 * (2 * 0.1 / 0.3 - 1), 0]], atol=1e-18)
    np.testing.assert_array_equal(
        displacement('direction_dependent_tables', back, EYX_1=2e-6, order=3.0), -one
    )


def test_expansion_reaches_its_strain_at_the_end_and_starts_at_none():
    state = leg_state(DIAGONAL, [MIDDLE, MIDDLE], 0, time=np.array([0.0, 300.0]))
    moved = displacement('thermal_axis_expansion', state, tau=200.0, S_X=1e-5, S_Z=1e-5)
    np.testing.assert_allclose(moved, [[0, 0, 0], [1e-6, 0, -2e-6]], atol=1e-18)
    early = displacement('thermal_axis_expansion', state, tau=200.0, until=600.0, S_X=1e-5)
    share = (1 - np.exp(-1.5)) / (1 - np.exp(-3.0))
    np.testing.assert_allclose(early[1, 0], 1e-6 * share)


def test_structure_drift_is_the_same_everywhere_and_may_bend():
    time = np.array([0.0, 100.0, 100.0, 200.0])
    q = [MIDDLE, MIDDLE, (0.2, 0.2, -0.2), MIDDLE]
    state = leg_state(DIAGONAL, q, 0, time=time)
    straight = displacement('thermal_structure_drift', state, tau=2e5, D_Z=4e-6)
    np.testing.assert_allclose(straight[:, 2], [0, 2e-6, 2e-6, 4e-6], rtol=1e-3)
    bow = displacement('thermal_structure_drift', state, tau=2e5, D_Z_2=1e-6)
    np.testing.assert_allclose(bow[:, 2], [0, -1.5e-6, -1.5e-6, 0], atol=1e-18)


def test_cross_coupling_is_its_coefficient_at_the_corner():
    state = leg_state(DIAGONAL, [(0.3, 0.25, 0.0), (0.0, 0.25, 0.0), (0.15, 0.25, 0.0)], 0)
    moved = displacement('cross_coupling', state, Z_XY=3e-6)
    np.testing.assert_allclose(moved[:, 2], [3e-6, -3e-6, 0], atol=1e-18)
    moved = displacement('cross_coupling', state, Y_X2Z=3e-6)
    np.testing.assert_allclose(moved[:, 1], [3e-6, 3e-6, 0], atol=1e-18)


def test_equal_delays_shift_along_the_path_only(state):
    moved = displacement('servo_mismatch', state, T_X=1e-4, T_Y=1e-4, T_Z=1e-4)
    np.testing.assert_allclose(moved, -1e-4 * state.speed[:, None] * state.direction)
    one = leg_state(DIAGONAL, MIDDLE, 0)
    np.testing.assert_allclose(
        displacement('servo_mismatch', one, T_X=1e-4), [[-1e-4 * 0.2 / np.sqrt(2), 0, 0]]
    )


def test_corner_is_cut_on_the_inside_from_both_sides():
    points = ((0, 0, -0.2), (0.2, 0, -0.2), (0.2, 0.2, -0.2))
    q = [(0.2, 0, -0.2), (0.19, 0, -0.2)]
    before = displacement('corner_rounding', leg_state(points, q, 0), l=0.01, A=1e-5)
    inside = np.array([-1, 1, 0]) / np.sqrt(2)
    np.testing.assert_allclose(before, 1e-5 * np.outer([1, np.exp(-1)], inside), atol=1e-17)
    q = [(0.2, 0, -0.2), (0.2, 0.01, -0.2)]
    after = displacement('corner_rounding', leg_state(points, q, 1), l=0.01, A=1e-5)
    np.testing.assert_allclose(after, before, atol=1e-17)


def test_cyclic_error_repeats_with_its_period():
    q = np.linspace(0, 1, 9)[:, None] * (0.02, 0.02, 0) + (0, 0, -0.2)
    moved = displacement('cyclic_error', leg_state(DIAGONAL, q, 0), period=0.02, S_X=1e-6)
    np.testing.assert_allclose(moved[:, 0], 1e-6 * np.sin(2 * np.pi * q[:, 0] / 0.02), atol=1e-18)
    assert not np.any(moved[:, 1:])


def test_vibration_goes_by_time():
    time = np.linspace(0, 0.25, 11)
    state = leg_state(DIAGONAL, np.tile(MIDDLE, (11, 1)), 0, time=time)
    moved = displacement('vibration', state, frequency=8.0, S_Y=1e-6, C_Z=2e-6)
    np.testing.assert_allclose(moved[:, 1], 1e-6 * np.sin(2 * np.pi * 8 * time), atol=1e-18)
    np.testing.assert_allclose(moved[:, 2], 2e-6 * np.cos(2 * np.pi * 8 * time), atol=1e-18)


def test_table_resolution_vanishes_at_the_nodes():
    x = np.linspace(0, 0.3, 3001)
    state = leg_state(DIAGONAL, np.stack([x, x, -0.2 + 0 * x], axis=1), 0)
    for name in ('EZX@0.1..0.15', 'EZX@0.1..0.15_2'):
        moved = displacement('table_resolution', state, **{name: 3e-6})[:, 2]
        inside = (x > 0.1 + 1e-9) & (x < 0.15 - 1e-9)
        np.testing.assert_allclose(moved[~inside], 0, atol=1e-15)
        np.testing.assert_allclose(np.abs(moved).max(), 3e-6, rtol=1e-3)
    terms = REGISTRY['table_resolution'].terms(state, {'order': 3.0})
    assert len(terms.names) == 2 * 6 * (6 + 5 + 4) and 'ECZ@-0.05..0_2' in terms.names


@pytest.mark.parametrize('name', ['EXQ@0..1', 'EXX', 'EXX@0.2..0.1', 'EXX@1-2..3', 'EXX@0..1_3'])
def test_table_resolution_refuses_what_is_no_interval(name, state):
    with pytest.raises(ConfigError, match='table_resolution: '):
        displacement('table_resolution', state, **{name: 1e-6})


def test_table_tilt_turns_about_the_tracker():
    state = leg_state(DIAGONAL, MIDDLE, 0)
    moved = displacement('table_tilt', state, tilt_Y_by_X=1e-5)
    np.testing.assert_allclose(moved[0], 1e-6 * np.cross([0, 1, 0], [1.1, 0.1, -0.2]), atol=1e-18)


def test_wrong_target_offset_acts_through_the_angular_errors(state):
    moved = displacement('target_offset', state, dT_X=0.01)
    turn = sum(
        np.stack([state.tables.motions[f'E{k}{a}'].at(state.q[:, i]) for k in 'ABC'], axis=1)
        for i, a in enumerate('XYZ')
    )
    np.testing.assert_allclose(moved, np.cross(turn, [0.01, 0, 0]), atol=1e-15)
    assert not np.any(displacement('target_offset', at(state, tables=None), dT_X=0.01))


def test_incidence_is_zero_in_the_middle_of_the_volume():
    middle = (0.15, 0.125, -0.1)
    state = leg_state(DIAGONAL, [middle, (0.0, 0.2, 0.0)], 0)
    moved = displacement('target_incidence', state, k=1e-4)
    np.testing.assert_allclose(moved[0], 0, atol=1e-12)
    beams = state.beam / np.linalg.norm(state.beam, axis=1, keepdims=True)
    angle = np.arccos(beams[0] @ beams[1])
    np.testing.assert_allclose(moved[1], 1e-4 * angle**2 * beams[1], rtol=1e-9)
    parts = REGISTRY['target_incidence'].terms(state, {}).columns[1, :, 1:].T @ beams[1]
    np.testing.assert_allclose(np.hypot(*parts), angle, rtol=1e-9)


def test_pose_drift_is_a_rigid_motion_about_the_tracker():
    state = leg_state(DIAGONAL, [MIDDLE, MIDDLE], 0, time=np.array([0.0, 100.0]))
    moved = displacement('tracker_pose_drift', state, tau=50.0, W_Z=1e-5, M_X=2e-6)
    np.testing.assert_allclose(moved[0], 0, atol=1e-18)
    turn = 1e-5 * np.cross([0, 0, 1], [1.1, 0.1, -0.2])
    np.testing.assert_allclose(moved[1], turn + np.array([2e-6, 0, 0]), atol=1e-18)


def test_scale_and_range_offset_act_along_the_beam(state):
    np.testing.assert_allclose(displacement('tracker_scale', state, m=1e-6), 1e-6 * state.beam)
    moved = displacement('tracker_range_offset', state, c=3e-6)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 3e-6)
    np.testing.assert_allclose(np.cross(moved, state.beam), 0, atol=1e-18)


def angle_errors(h, v, r, x):
    """Errors of azimuth, zenith angle and range as the catalogue writes them, face I."""
    dh = (
        x['x1z'] / (r * np.tan(v)) + x['x3'] / (r * np.sin(v)) + x['x5z7'] / np.tan(v)
        + 2 * x['x6'] / np.sin(v) - x['x8x'] * np.sin(h) + x['x8y'] * np.cos(h) + x['x1n'] / r
        + x['x11a'] * np.cos(2 * h) + x['x11b'] * np.sin(2 * h)
    )  # fmt: skip
    dv = (
        (x['x1n'] + x['x2']) * np.cos(v) / r + x['x4'] + x['x5n9n'] * np.cos(v)
        - x['x1z'] * np.sin(v) / r - x['x5z9z'] * np.sin(v)
        + x['x12a'] * np.cos(2 * v) + x['x12b'] * np.sin(2 * v)
    )  # fmt: skip
    return dh, dv, x['x2'] * np.sin(v)


def cartesian(h, v, r):
    return np.stack([r * np.sin(v) * np.cos(h), r * np.sin(v) * np.sin(h), r * np.cos(v)], axis=1)


def test_tracker_angles_are_those_of_the_spherical_formulas(state):
    names = REGISTRY['tracker_angles'].terms(state, {}).names
    rng = np.random.default_rng(5)
    values = dict(zip(names, 1e-6 * rng.standard_normal(len(names)), strict=True))
    own = state.beam @ state.R_machine_tracker
    r = np.linalg.norm(own, axis=1)
    h, v = np.arctan2(own[:, 1], own[:, 0]), np.arccos(own[:, 2] / r)
    dh, dv, dr = angle_errors(h, v, r, values)
    expected = (cartesian(h + dh, v + dv, r + dr) - own) @ state.R_machine_tracker.T
    moved = displacement('tracker_angles', state, **values)
    np.testing.assert_allclose(moved, expected, atol=2e-10)
    assert np.abs(moved).max() > 1e-6
