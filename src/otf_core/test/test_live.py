# SPDX-License-Identifier: Apache-2.0
"""A run under way as viewers see it: distances, time left, the thinned track, the layers."""

import math
import time
from itertools import pairwise

import numpy as np
import pytest
from core_cells import error_of
from nature import table_rows

from otf_core.calibration.calibration_result import motion_sizes, volume_errors
from otf_core.calibration.first_sight import first_sight
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError, ShapeError
from otf_core.live import layers
from otf_core.live.layers import TRACK_POINTS, PathDistance, Track, enlargement
from otf_core.live.live_run import LiveRun, LiveSolution, RunProgress
from otf_core.live.stages import StepProgress, TimeLeft, approximate_time
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.model.motions import MOTIONS
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

CORNERS = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0.1, 0.1, -0.2]], float)
PATH = NominalPath(CORNERS)
TURNED = RigidTransform(
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([0.5, -1.0, 0.25])
)
DRIVEN = RunProgress('BUFFERING', 'driving', 0.25, 30.0, 500, 2, 0.4)


def in_tracker(points):
    """Points of the machine frame as the tracker sees them."""
    return (np.asarray(points) - TURNED.translation) @ TURNED.rotation


def test_deviation_is_that_from_the_nearest_of_very_many_places(rng=7):
    points = np.random.default_rng(rng).uniform(-0.3, 0.5, (40, 3))
    step = np.linspace(0, 1, 4001)[:, None]
    places = np.vstack([a + step * (b - a) for a, b in pairwise(CORNERS)])
    found = PathDistance(PATH).deviation(points)
    for point, deviation in zip(points, found, strict=True):
        away = np.linalg.norm(point - places, axis=1)
        assert np.linalg.norm(deviation) == pytest.approx(away.min(), abs=1e-7)
        assert np.linalg.norm(places - (point - deviation), axis=1).min() < 1e-4


def test_time_left_is_that_of_the_mean_speed_and_begins_anew_with_another_job():
    clock = TimeLeft()
    assert math.isnan(clock.estimate('driving', 0.2, 100.0))
    assert math.isnan(clock.estimate('driving', 0.2, 110.0))  # nothing moved
    assert clock.estimate('driving', 0.4, 120.0) == pytest.approx(60.0)
    assert clock.estimate('driving', 0.4, 130.0) == pytest.approx(50.0)
    assert math.isnan(clock.estimate('driving', 0.4, 190.0))  # it takes longer than that
    assert math.isnan(clock.estimate('solving', 0.5, 121.0))
    assert clock.estimate('solving', 0.75, 131.0) == pytest.approx(10.0)
    assert math.isnan(clock.estimate('solving', 0.1, 140.0))  # a second solving
    assert clock.estimate('solving', 0.2, 141.0) == pytest.approx(8.0)


def test_steps_say_how_long_the_others_take(monkeypatch):
    now = iter([100.0, 140.0, 180.0, 220.0])
    monkeypatch.setattr(time, 'monotonic', lambda: next(now))
    left = StepProgress(3)
    assert [left.after_one() for _ in range(3)] == [', about 80 s left', ', about 40 s left', '']
    assert (approximate_time(3.2), approximate_time(math.nan), approximate_time(600.0)) == (
        'about 4 s left',
        '',
        'about 10 min left',
    )


def test_track_has_deviations_once_the_place_of_the_tracker_is_known():
    track = Track()
    track.set_path(PATH)
    shifts = np.array([[0, 3e-5, 0], [0, 0, -2e-5], [0, 0.1, 0]])
    on_path = np.array([[0.1, 0, 0], [0.2, 0, 0], [0.15, 0, 0]])
    for point in in_tracker(on_path + shifts):
        track.add(*point)
    assert math.isnan(track.distance) and track.position is None
    assert not len(track.deviations()[0])
    track.set_pose(TURNED)
    places, deviations = track.deviations()
    assert np.allclose(places, on_path[:2], atol=1e-12)  # the third is not on the path at all
    assert np.allclose(deviations, shifts[:2], atol=1e-12)
    assert math.isnan(track.distance)
    track.add(*in_tracker(on_path[0] + shifts[0]))
    assert track.distance == pytest.approx(3e-5, rel=1e-6)
    assert np.allclose(track.position, on_path[0] + shifts[0])


def test_track_of_any_length_stays_small_and_covers_the_whole_run():
    track = Track()
    track.set_path(PATH)
    track.set_pose(TURNED)
    along = np.linspace(0, 0.3, 300)
    for lap in range(12):
        for x in along if lap % 2 == 0 else along[::-1]:
            track.add(*in_tracker([[x, 0, 1e-5 * lap]])[0])
    places, deviations = track.deviations()
    assert TRACK_POINTS / 4 < len(places) <= 2 * TRACK_POINTS
    assert {round(z * 1e5) for z in deviations[:, 2]} == set(range(12))


@pytest.mark.parametrize(
    ('longest', 'size', 'factor'), [(1e-4, 1.0, 500.0), (1e-5, 0.5, 2000.0), (7e-6, 0.1, 1000.0)]
)
def test_enlargement_is_round_and_leaves_arrows_shorter_than_the_scene(longest, size, factor):
    vectors = longest * np.array([[1, 0, 0], [0, -1, 0], [0.6, 0, 0.8]])
    assert enlargement(vectors, size) == pytest.approx(factor)
    assert enlargement(np.zeros((3, 3)), size) == enlargement(np.empty((0, 3)), size) == 1.0


def test_driven_part_ends_where_the_travelled_length_ends():
    assert np.allclose(layers.driven_part(PATH, 0.4), [*CORNERS[:3], [0.3, 0.1, 0]])
    assert np.allclose(layers.driven_part(PATH, 0.0), [[0, 0, 0], [0, 0, 0]])
    assert np.allclose(layers.driven_part(PATH, 9.0), CORNERS)


def named(found):
    """Layers by name, each name once."""
    names = [layer.name for layer in found]
    assert len(set(names)) == len(names)
    return dict(zip(names, found, strict=True))


def test_scene_shows_errors_from_their_places_and_says_how_enlarged():
    places = np.array([[0.1, 0.1, 0], [0.2, 0.1, -0.1]])
    errors, u = np.array([[1e-5, 0, 0], [0, -2e-5, 0]]), np.full((2, 3), 1e-6)
    assert set(named(layers.scene(PATH, None))) == {'path'}
    drawn = named(layers.scene(PATH, VolumeErrors(places, errors, u, provisional=True)))
    assert np.array_equal(drawn['path'].points, CORNERS)
    begin, end = drawn['errors'].points.reshape(2, 2, 3).swapaxes(0, 1)
    assert np.array_equal(begin, places)
    factor = np.linalg.norm(end - begin, axis=1) / np.linalg.norm(errors, axis=1)
    assert np.allclose(factor, factor[0]) and f'x {factor[0]:,.0f}:' in drawn['error_legend'].text
    assert 'so far' in drawn['error_legend'].text
    crosses = drawn['uncertainty'].points.reshape(2, 3, 2, 3)
    assert np.allclose(np.linalg.norm(np.ptp(crosses, axis=2), axis=2), 2e-6 * factor[0])
    with pytest.raises(ShapeError, match='one shape'):
        VolumeErrors(places, errors[:1], u)


def test_long_path_is_drawn_by_few_points_with_its_end():
    turns = np.linspace(0, 60, 40_000)
    coil = NominalPath(np.stack([np.cos(turns), np.sin(turns), 0.01 * turns], axis=1))
    drawn = named(layers.scene(coil, None))['path'].points
    assert len(drawn) <= layers.DRAWN_POINTS + 1 and np.array_equal(drawn[-1], coil.points[-1])


def test_moving_layers_show_the_tracker_where_it_stands_once_that_is_known():
    run = LiveRun()
    run.set_path(PATH)
    run.set_progress(DRIVEN, 10.0)
    run.track.add(*in_tracker([[0.1, 2e-5, 0]])[0])

    def drawn():
        return named(layers.moving(run.path, 0.4, run.track, run.pose, 0.0))

    assert set(drawn()) == {'driven'}
    run.set_pose(TURNED)
    assert np.allclose(drawn()['beam'].points, [TURNED.translation, [0.1, 2e-5, 0]])
    begin, end = drawn()['deviations'].points
    assert np.allclose(begin, [0.1, 0, 0], atol=1e-9) and end[1] - begin[1] > 0.005
    assert 'deviation' in drawn()['deviation_legend'].text
    fixed = named(layers.moving(run.path, 0.4, run.track, run.pose, 100.0))['deviations'].points
    assert np.allclose(fixed[1] - fixed[0], [0, 2e-3, 0])


def test_a_new_run_forgets_the_old_one():
    run = LiveRun()
    run.set_path(PATH)
    run.set_progress(DRIVEN, 10.0)
    run.set_progress(RunProgress('BUFFERING', 'driving', 0.5, 20.0, 1500, 2, 0.4), 11.0)
    run.set_pose(TURNED)
    run.solved = LiveSolution(True, '', 5e-5, 2e-6, motions={'EXX': (1e-5, 1e-6)})
    run.track.add(*in_tracker([[0.2, 0, 1e-5]])[0])
    assert run.track.distance == pytest.approx(1e-5)
    run.set_progress(RunProgress('BUFFERING', 'driving', 0.0, math.nan, 3, 0, 0.0), 60.0)
    assert run.pose is None and run.solved is None
    assert math.isnan(run.track.distance)


def test_volume_errors_and_motion_sizes_are_those_of_the_tables(calibrated):
    volume = volume_errors(calibrated, count=3)
    machine = calibrated.tables.machine
    assert np.allclose(volume.errors, error_of(calibrated.tables, volume.points), atol=1e-15)
    rows, _ = table_rows(
        calibrated.tables, str(machine.chain), machine.target_offset, volume.points
    )
    variance = np.einsum('...i,ij,...j->...', rows, calibrated.covariance, rows)
    assert np.allclose(volume.u, np.sqrt(variance), rtol=1e-6, atol=1e-12)
    turned = 1e-4 * np.cross([1.0, 2.0, 3.0], volume.points) + 5e-4
    moved = VolumeErrors(volume.points, volume.errors + turned, volume.u)
    assert 1e-6 < volume.mean == pytest.approx(moved.mean, rel=1e-6)
    sizes = motion_sizes(calibrated.tables)
    assert list(sizes) == list(MOTIONS)
    table = calibrated.tables.motions['EYX']
    assert sizes['EYX'] == (max(abs(table.value)), max(table.u))
    for name in calibrated.not_identifiable:
        assert name not in sizes or math.isnan(sizes[name][1])


@pytest.mark.parametrize('share', [0.15, 0.3, 0.6])
def test_first_sight_finds_the_tracker_in_the_beginning_of_a_run(cell, calibrated, share):
    whole = cell.recording.measured(cell.truth)
    count = int(share * len(whole))
    samples = Samples(whole.stamp_ns[:count], whole.xyz[:count])
    steps = np.linalg.norm(np.diff(cell.recording.q[:count], axis=0), axis=1)
    found = first_sight(samples, cell.path, steps.sum(), CalibrationConfig())
    away = found.T_machine_tracker.translation - calibrated.T_machine_tracker.translation
    assert np.linalg.norm(away) < 5e-4 and 2e-6 < found.distance < 6e-5
    assert 'the tracker is found' in found.words


def test_first_sight_of_something_else_than_the_path_says_so(cell):
    samples = cell.recording.measured(cell.truth)
    with pytest.raises(InputError, match=r'do not follow the path|followed only'):
        first_sight(samples, NominalPath(CORNERS), 0.5, CalibrationConfig())
