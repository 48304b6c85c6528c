# SPDX-License-Identifier: Apache-2.0
"""Alignment: pose and leg of every sample, found from shape and order alone."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import (
    Recording,
    corner_path,
    plan_for_path,
    record,
    small_plan,
    some_machine,
    some_pose,
)
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from otf_core.config import CalibrationConfig, PlannerConfig
from otf_core.errors import InputError
from otf_core.model.frames import rigid_fit
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.alignment import align, line_step
from otf_core.tracking.matching import OFF_PATH
from otf_core.tracking.measured_track import simplify

CONFIG = CalibrationConfig()
# m; thousands of samples with 2 um of noise place the tracker far better, errors of the machine
# of 20 um mean (three times that at most) do not
POSE_TOLERANCE = 1e-4


def check(recording, tables=None, seed=0, share=0.97, config=CONFIG):
    """Align a recording and compare with what it was made from; return the alignment.

    Where a sample is given a leg, the programmed position lies on that leg and moves along it.
    """
    pose = some_pose(recording.machine, np.random.default_rng(seed))
    samples = recording.measured(tables, seed=seed, pose=pose)
    found = align(samples, recording.path, config)
    true_points = samples.xyz @ pose[0] + pose[1]  # the inverse of a rotation is its transpose
    off = np.linalg.norm(found.T_machine_tracker.apply(samples.xyz) - true_points, axis=1)
    assert off.max() < POSE_TOLERANCE
    speed = np.gradient(recording.q, axis=0)
    moving = np.linalg.norm(speed, axis=1) > 1e-6
    step = np.diff(recording.time)  # next to a gap the difference is no speed
    moving &= (np.append(step, 0) < 0.1) & (np.insert(step, 0, 0) < 0.1)
    used = (found.leg != OFF_PATH) & moving
    # samples within a corner's rounding belong to either leg: judge away from corners
    origin, chord = found.corners[:-1], np.diff(found.corners, axis=0)
    length = np.linalg.norm(chord, axis=1)
    unit = (chord / length[:, None])[found.leg]
    local = recording.q - origin[found.leg]
    along = np.sum(local * unit, axis=1)
    inner = used & (along > 0.004) & (along < length[found.leg] - 0.004)
    across = np.linalg.norm(local - along[:, None] * unit, axis=1)
    assert across[inner].max() < 1e-9  # the programmed position is exactly on its leg
    assert np.all(np.diff(found.leg[inner]) >= 0)
    heading = np.sum(speed * unit, axis=1)
    assert heading[inner].min() > 0
    near = np.min(np.linalg.norm(recording.q[:, None] - found.corners, axis=2), axis=1) < 0.01
    assert np.sum(inner & ~near) > share * np.sum(moving & ~near)
    return found


@pytest.mark.parametrize('seed', range(2))
def test_any_rotation_and_place_of_the_tracker_is_found(cell, seed):
    found = check(cell.recording, cell.truth, seed)
    assert found.coverage == pytest.approx(1.0, abs=0.01)  # ends of legs are cut by a hop
    assert found.last_leg_driven


@pytest.mark.parametrize(
    'turn', [[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi / 2], [0, 0, 0], [2.0, 2.0, -1.0]]
)
def test_quarter_and_half_turns_are_found(cell, turn):
    pose = (Rotation.from_rotvec(turn).as_matrix(), np.array([-0.4, 0.6, 0.1]))
    found = align(cell.recording.measured(pose=pose), cell.path, CONFIG)
    np.testing.assert_allclose(found.T_machine_tracker.rotation, pose[0].T, atol=1e-4)
    np.testing.assert_allclose(found.T_machine_tracker.translation, pose[1], atol=POSE_TOLERANCE)


def driven_share(recording):
    step = np.linalg.norm(np.diff(recording.q, axis=0), axis=1)
    return step[np.diff(recording.time) < 0.1].sum() / recording.path.length


@pytest.mark.parametrize(
    ('low', 'high'), [(8.0, 999.0), (0.0, 65.0), (15.0, 60.0), (30.0, 50.0), (0.3, 89.2)]
)
def test_part_of_the_path_finds_its_place(cell, low, high):
    part = cell.recording.between(low, high)
    found = check(part)
    # legs are measured between points a hop apart: up to some mm of each 0.26 m are missing
    assert found.coverage == pytest.approx(driven_share(part), abs=0.02)
    assert found.last_leg_driven == (high > 89)


@pytest.mark.parametrize(
    ('before', 'after'),
    [
        ([(0.1, -0.1, 0.2), (0.0, 0.0, 0.2)], []),
        ([], [(0.0, 0.0, 0.15), (0.4, 0.4, 0.3)]),
        ([(0.3, 0.25, 0.1), (0.15, 0.1, 0.1), (0.1, -0.05, 0.0)], [(0.05, 0.0, 0.05)]),
        ([(0.3, 0.25, 0.0), (0.3, 0.0, -0.2)], [(0.3, 0.25, -0.2), (0.0, 0.0, 0.0)]),
    ],
    ids=['approach', 'retract', 'both', 'inside the volume'],
)
def test_moves_before_and_after_the_path_are_set_aside(cell, before, after):
    recording = cell.recording.with_moves(before, after)
    # the added moves take up to 60 s of 140 s
    found = check(recording, cell.truth, share=0.5)
    assert found.coverage > 0.98


@pytest.mark.parametrize('passes', [2, 3])
def test_laps_forward_and_backward_at_another_feed_keep_their_order(passes):
    machine = some_machine()
    plan = small_plan(machine, passes=passes, corner_dwell=0.0, feed=0.4)
    found = check(record(machine, plan))
    assert found.coverage > 0.97
    assert found.last_leg_driven


def test_pauses_in_the_middle_of_lines_change_nothing(cell):
    recording = cell.recording
    for at in (5.3, 20.1, 40.7, 60.2):
        recording = recording.paused(at, 2.0)
    paused = check(recording, cell.truth)
    plain = check(cell.recording, cell.truth)
    assert paused.coverage == pytest.approx(plain.coverage, abs=1e-3)


@pytest.mark.parametrize(
    'spans',
    [
        [(10.2, 10.5)],
        [(20.0, 24.0)],
        [(12.0, 12.4), (30.0, 31.5), (31.9, 33.0), (50.0, 50.1)],
        [(float(t), t + 1.2) for t in range(3, 78, 5)],
    ],
    ids=['in a line', 'over corners', 'several', 'everywhere'],
)
def test_gaps_where_the_beam_was_lost_are_bridged(cell, spans):
    recording = cell.recording.cut(*spans)
    found = check(recording, cell.truth, share=0.9)
    assert found.coverage == pytest.approx(driven_share(recording), abs=0.05)


@pytest.mark.parametrize('size', [1e-4, 3e-3, 5e-2])
@pytest.mark.parametrize('burst', [1, 5])
def test_spikes_do_not_move_the_tracker(cell, size, burst):
    rng = np.random.default_rng(5)
    pose = some_pose(cell.machine, rng)
    clean = cell.recording.measured(pose=pose)
    xyz = clean.xyz.copy()
    for start in rng.choice(len(xyz) - burst, 15, replace=False):
        xyz[start : start + burst] += size * rng.standard_normal(3)
    found = align(Samples(clean.stamp_ns, xyz), cell.path, CONFIG)
    off = found.T_machine_tracker.apply(clean.xyz) - (clean.xyz @ pose[0] + pose[1])
    # 15 bursts of 5 in 9000 samples: less than one per cent of what stays within 8 mm of a leg
    assert np.linalg.norm(off, axis=1).max() < max(POSE_TOLERANCE, 0.02 * min(size, 8e-3))
    assert found.coverage > 0.9


def test_crossing_diagonals_are_told_apart_by_the_order_of_driving():
    machine = some_machine()
    # both diagonals of a face, several times through the same centre
    path = corner_path(
        machine, (0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0), (1, 1, 0), (1, 1, 1),
        (0, 0, 0), (1, 1, 1), (0, 1, 1), (1, 0, 0),
    )  # fmt: skip
    plan = plan_for_path(path, PlannerConfig(corner_dwell=0.0, end_dwell=0.5))
    found = check(record(machine, plan))
    assert set(found.leg[found.leg != OFF_PATH]) == set(range(10))


@pytest.mark.parametrize('rate', [20.0, 500.0, 1000.0])
def test_every_rate_aligns(cell, rate):
    part = record(cell.machine, cell.plan, rate).between(10.0, 40.0)
    # at 20 Hz and 0.25 m/s samples are 12 mm apart
    assert check(part, share=0.9).coverage > 0.3


def test_repeated_and_collinear_points_of_the_path_are_no_corners(cell):
    points = [cell.path.points[0]]
    for a, b in zip(cell.path.points[:-1], cell.path.points[1:], strict=True):
        points += [a, a + 0.3 * (b - a), a + 0.5 * (b - a), b, b]
    found = check(replace(cell.recording, path=NominalPath(np.array(points))))
    plain = align(cell.recording.measured(), cell.path, CONFIG)
    np.testing.assert_allclose(found.corners, plain.corners, atol=1e-12)


@pytest.mark.parametrize('seconds', [0.05, 0.1, 0.15])
def test_rounded_corners_align(cell, seconds):
    plan = small_plan(cell.machine, corner_dwell=0.0)
    recording = record(cell.machine, plan)
    width = round(seconds * 100)
    padded = np.pad(recording.q, ((width, width), (0, 0)), 'edge')
    rounded = np.stack(
        [
            np.convolve(padded[:, k], np.ones(width) / width, 'same')[width:-width]
            for k in range(3)
        ],
        axis=1,
    )
    pose = some_pose(cell.machine, np.random.default_rng(1))
    samples = replace(recording, q=rounded).measured(pose=pose)
    found = align(samples, cell.path, CONFIG)
    off = found.T_machine_tracker.apply(samples.xyz) - (samples.xyz @ pose[0] + pose[1])
    assert np.linalg.norm(off, axis=1).max() < POSE_TOLERANCE
    assert found.coverage > 0.95


def test_cube_with_all_its_symmetries_is_placed_by_the_order_of_driving():
    machine = some_machine(ranges=((0, 0.2), (0, 0.2), (-0.2, 0)))
    recording = record(machine, small_plan(machine))
    check(recording)
    check(recording.between(10.0, 45.0), seed=1)


# ---------------------------------------------------------------- data that do not belong


def refusal(samples, path, config=CONFIG):
    with pytest.raises(InputError) as caught:
        align(samples, path, config)
    assert '\n' not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize('axis', range(3))
def test_left_handed_coordinates_are_named(cell, axis):
    samples = cell.recording.measured(seed=axis)
    flip = np.ones(3)
    flip[axis] = -1
    assert 'mirrored' in refusal(Samples(samples.stamp_ns, samples.xyz * flip), cell.path)


@pytest.mark.parametrize('factor', [0.95, 39.37])
def test_scaled_points_do_not_follow_the_path(cell, factor):
    samples = cell.recording.measured()
    message = refusal(Samples(samples.stamp_ns, factor * samples.xyz), cell.path)
    assert 'samples do not follow the path' in message


def test_path_in_another_order_is_refused(cell):
    points = np.random.default_rng(0).permutation(cell.path.points)
    assert 'samples do not follow' in refusal(cell.recording.measured(), NominalPath(points))


def test_single_line_cannot_be_aligned():
    machine = some_machine()
    path = corner_path(machine, (0, 0, 0), (1, 1, 1))
    plan = plan_for_path(path, PlannerConfig())
    assert 'single straight line' in refusal(record(machine, plan).measured(), path)


def rounded(machine, gap, speed=0.2, rate=100.0):
    """Path driven without stops, right-angled corners cut by ``gap`` m."""
    path = small_plan(machine).path
    reach = np.concatenate([[0.0], np.cumsum(path.leg_lengths)])
    time = np.arange(int(reach[-1] / speed * rate)) / rate
    q = np.stack([np.interp(time * speed, reach, path.points[:, k]) for k in range(3)], axis=1)
    q = uniform_filter1d(q, int(gap * 8 / np.sqrt(2) / speed * rate), axis=0, mode='nearest')
    return Recording(machine, path, time, q)


@pytest.mark.parametrize('gap', [0.004, 0.008])
def test_corners_rounded_by_more_than_the_tolerance_align(gap):
    recording = rounded(some_machine(), gap)
    pose = some_pose(recording.machine, np.random.default_rng(4))
    samples = recording.measured(pose=pose)
    found = align(samples, recording.path, CONFIG)
    true_points = samples.xyz @ pose[0] + pose[1]
    off = np.linalg.norm(found.T_machine_tracker.apply(samples.xyz) - true_points, axis=1)
    assert off.max() < POSE_TOLERANCE
    assert found.coverage > 0.9


def test_corners_rounded_far_are_refused_with_what_to_set():
    recording = rounded(some_machine(), 0.012)
    samples = recording.measured()
    message = refusal(samples, recording.path)
    assert 'its corners are rounded: raise match_tolerance to' in message
    tolerance = float(message.split('match_tolerance to ')[1].split()[0])
    config = CalibrationConfig(match_tolerance=tolerance, corner_exclusion=3 * tolerance)
    assert align(samples, recording.path, config).coverage > 0.85


@pytest.mark.parametrize('times', [1, 3])
def test_shuttle_on_one_line_within_a_path_is_followed(times):
    machine = some_machine()
    points = small_plan(machine).path.points
    half = len(points) // 2
    there_and_back = np.tile(points[half - 2 : half], (times, 1))
    path = NominalPath(np.concatenate([points[:half], there_and_back, points[half:]]))
    check(record(machine, plan_for_path(path, PlannerConfig(corner_dwell=0.05, end_dwell=0.5))))


def test_shuttle_on_one_line_alone_does_not_fix_the_tracker():
    machine = some_machine()
    path = corner_path(machine, (0, 0, 0), (1, 1, 1), (0, 0, 0), (1, 1, 1), (0, 0, 0))
    recording = record(machine, plan_for_path(path, PlannerConfig()))
    with pytest.raises(InputError, match='do not determine the tracker pose'):
        align(recording.measured(), path, CONFIG)


def test_lines_that_are_all_parallel_do_not_fix_the_tracker():
    machine = some_machine()
    path = corner_path(machine, (0, 0, 0), (1, 1, 1), (0, 0, 0))
    plan = plan_for_path(path, PlannerConfig())
    assert 'determine the tracker pose' in refusal(record(machine, plan).measured(), path)


@pytest.mark.parametrize('count', [0, 1, 2, 3, 500])
def test_standing_still_is_named(cell, count):
    still = Recording(cell.machine, cell.path, 0.01 * np.arange(count), np.full((count, 3), 0.1))
    assert 'hardly moved' in refusal(still.measured(), cell.path)


# ---------------------------------------------------------------- the parts


def test_simplified_track_keeps_corners_and_points_of_return():
    x = np.concatenate([np.linspace(0, 1, 50), np.linspace(1, 0.4, 30)[1:], np.full(20, 0.4)])
    y = np.concatenate([np.zeros(79), np.linspace(0, 0.5, 21)[1:]])
    points = np.stack([x, y, 0 * x], axis=1)
    found = points[simplify(points, 1e-3)]
    np.testing.assert_allclose(
        found, [[0, 0, 0], [1, 0, 0], [0.4, 0, 0], [0.4, 0.5, 0]], atol=1e-12
    )


def test_rigid_fit_recovers_a_transform_and_never_mirrors():
    rng = np.random.default_rng(2)
    rotation = Rotation.random(random_state=rng).as_matrix()
    source = rng.normal(size=(6, 3))
    found = rigid_fit(source, source @ rotation.T + [1, 2, 3])
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, [1, 2, 3], atol=1e-12)
    mirrored = rigid_fit(source, source * [1, 1, -1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize('each', [1, 4])
def test_line_step_undoes_a_small_motion_of_points_on_lines(each):
    rng = np.random.default_rng(4)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin, line = rng.uniform(-1, 1, (60, 3)), np.repeat(np.arange(60), each)
    on_line = origin[line] + rng.uniform(-1, 1, (60 * each, 1)) * direction[line]
    shift, turn = np.array([1e-6, -2e-6, 3e-6]), np.array([2e-6, 1e-6, -1e-6])
    moved = on_line + shift + np.cross(turn, on_line)
    translation, rotation_vector = line_step(moved, origin, direction, np.ones(60 * each), line)
    # what is left is of second order: 1e-6 of a motion of 1e-6
    np.testing.assert_allclose(translation, -shift, atol=1e-11)
    np.testing.assert_allclose(rotation_vector, -turn, atol=1e-11)
