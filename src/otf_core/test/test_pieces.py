# SPDX-License-Identifier: Apache-2.0
"""Path pieces: never across a node, exact means; corners, stops and spikes left out."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import (
    corner_path,
    plan_for_path,
    record,
    some_machine,
    transform_pose,
    zero_tables,
)

from otf_core.config import CalibrationConfig, PlannerConfig
from otf_core.errors import InputError
from otf_core.model.machine import AXES
from otf_core.model.nodes import table_nodes
from otf_core.model.observation import Samples
from otf_core.model.tables import MotionTable
from otf_core.pieces.pieces import over_windows, reduce_to_pieces
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.matching import OFF_PATH

CONFIG = CalibrationConfig()
SHARES = ((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 0.5, 1), (0, 0, 0))


class Case:
    """A short run whose alignment is known, not found."""

    def __init__(self, rate=500.0, feed=0.25, dwell=0.3, noise=0.0, tables=None, config=CONFIG):
        self.machine = some_machine()
        path = corner_path(self.machine, *SHARES)
        planner = PlannerConfig(corner_dwell=dwell, end_dwell=0.5, feed=feed)
        self.recording = record(self.machine, plan_for_path(path, planner), rate)
        self.pose = transform_pose(self.machine, 7)
        seat = (self.pose.rotation.T, self.pose.translation)
        # the first-order world, so that a piecewise-linear error is exactly that
        self.samples = self.recording.measured(tables, 3, seat, noise, exact=False)
        self.corners = path.points
        step = np.diff(self.corners, axis=0)
        length = np.linalg.norm(step, axis=1)
        done = np.linalg.norm(np.diff(self.recording.q, axis=0), axis=1).cumsum()
        ends = np.cumsum(length)
        leg = np.searchsorted(ends - 1e-9, np.insert(done, 0, 0.0), side='right')
        self.leg = np.minimum(leg, len(step) - 1)
        self.nodes = tuple(
            table_nodes(self.machine, self.machine.lower, self.machine.upper)[a] for a in AXES
        )
        self.config = config

    def pieces(self, samples=None, leg=None):
        alignment = Alignment(self.pose, self.corners, self.leg if leg is None else leg, 1.0, True)
        return reduce_to_pieces(samples or self.samples, alignment, self.nodes, self.config)


def bow_tables(machine):
    """EZX piecewise linear over the nodes of the calibration, with large kinks."""
    nodes = table_nodes(machine, machine.lower, machine.upper)['X']
    value = 1e-4 * (-1.0) ** np.arange(len(nodes))
    tables = zero_tables(machine)
    return replace(tables, motions={**tables.motions, 'EZX': MotionTable(nodes, value, 0 * value)})


@pytest.mark.parametrize('length', [0.002, 0.008, 0.05])
def test_no_piece_crosses_a_node(length):
    case = Case(config=replace(CONFIG, piece_length=length))
    pieces = case.pieces()
    mean = case.pose.apply(pieces.xyz)
    # half of the samples' extent on both sides of the mean, less one sample (0.5 mm)
    reach = 0.5 * (pieces.count - 1) * pieces.speed / 500.0 - 5e-4
    for axis in range(3):
        slope = np.abs(pieces.direction[:, axis])
        inner = case.nodes[axis][1:-1]
        moving = slope > 1e-9
        distance = np.abs(mean[moving, axis, None] - inner).min(axis=1)
        assert np.all(distance > reach[moving] * slope[moving] - 1e-9)


def test_pieces_are_no_longer_than_told():
    pieces = Case(config=replace(CONFIG, piece_length=0.01)).pieces()
    # one sample more than fits, 0.5 mm apart, at full speed
    fast = pieces.speed > 0.2
    assert pieces.count[fast].max() <= 0.01 / 0.0005 + 1


def test_mean_over_a_piece_is_exact_for_a_piecewise_linear_error():
    machine = some_machine()
    tables = bow_tables(machine)
    case = Case(tables=tables)
    pieces = case.pieces()
    mean = case.pose.apply(pieces.xyz)
    # the error is along Z: on the first leg (in the plane of X and Y) X and Y are not disturbed
    first = pieces.leg == 0
    expected = np.interp(
        mean[first, 0], tables.motions['EZX'].position, tables.motions['EZX'].value
    )
    # a mean over a kink of 4 mm / m would be off by some um; stamps and points are exact to 1e-15
    np.testing.assert_allclose(mean[first, 2], case.machine.lower[2] + expected, atol=1e-12)
    assert first.sum() > 20


def test_means_lie_on_their_legs_in_order_of_driving():
    case = Case()
    pieces = case.pieces()
    mean = case.pose.apply(pieces.xyz)
    local = mean - pieces.origin
    along = np.sum(local * pieces.direction, axis=1)
    assert np.linalg.norm(local - along[:, None] * pieces.direction, axis=1).max() < 1e-12
    assert np.all(np.diff(pieces.time) > 0)
    assert np.all(np.diff(pieces.leg) >= 0)
    assert np.all(np.diff(along)[np.diff(pieces.leg) == 0] > 0)


def test_corners_are_left_out():
    case = Case(config=replace(CONFIG, corner_exclusion=0.02))
    pieces = case.pieces()
    mean = case.pose.apply(pieces.xyz)
    assert np.min(np.linalg.norm(mean[:, None] - case.corners, axis=2)) > 0.02
    more = Case().pieces()
    assert more.used > pieces.used


def test_standstill_is_left_out():
    moving = Case(dwell=0.0).pieces()
    stopped = Case(dwell=2.0).pieces()
    # 3 stops of 2 s at 500 Hz are 3000 samples; not one of them is used
    assert abs(stopped.used - moving.used) < 20


def test_pause_in_the_middle_of_a_line_is_left_out_with_its_surroundings():
    case = Case(noise=1.0)
    plain = case.pieces()
    at = float(case.recording.time[case.leg == 1].mean())
    paused = case.recording.paused(at, 3.0)
    stood = len(paused.time) - len(case.recording.time)
    k = int(np.searchsorted(case.recording.time, at))
    leg = np.insert(case.leg, k, np.ones(stood, int))
    seat = (case.pose.rotation.T, case.pose.translation)
    pieces = case.pieces(paused.measured(pose=seat), leg)
    # the speed is taken over 40 ms, 20 samples; half of that and as much again goes on each side
    assert plain.used - 60 <= pieces.used <= plain.used
    assert pieces.count.max() <= plain.count.max()


def test_samples_off_the_path_are_left_out():
    case = Case()
    leg = case.leg.copy()
    leg[case.leg == 2] = OFF_PATH
    pieces = case.pieces(leg=leg)
    assert set(pieces.leg) == {0, 1, 3}
    assert pieces.used < case.pieces().used


def test_count_of_samples_adds_up():
    pieces = Case(noise=1.0).pieces()
    assert pieces.count.sum() == pieces.used
    assert pieces.count.min() >= 1
    assert len(pieces) == len(pieces.xyz) == len(pieces.time) == len(pieces.speed)


@pytest.mark.parametrize('rate', [500.0, 1000.0])
def test_clean_samples_are_no_outliers(rate):
    pieces = Case(rate=rate, noise=1.0).pieces()
    # 8 standard deviations: one in 1e15 samples
    assert pieces.outliers == 0


def test_clean_samples_far_apart_are_no_outliers():
    assert Case(rate=100.0, noise=1.0).pieces().outliers == 0


@pytest.mark.parametrize('size', [5e-4, 1e-3])  # below 30 um across the path none is one
def test_single_spikes_are_left_out_and_nothing_else(size):
    case = Case(noise=1.0)
    used = case.pieces().used
    candidates = np.flatnonzero(
        np.linalg.norm(np.gradient(case.recording.q, axis=0), axis=1) > 4e-4
    )
    struck = candidates[50::400]
    xyz = case.samples.xyz.copy()
    # along the beam, which is never along a leg here
    xyz[struck] *= 1.0 + size / np.linalg.norm(xyz[struck], axis=1, keepdims=True)
    pieces = case.pieces(Samples(case.samples.stamp_ns, xyz))
    assert used - pieces.used <= pieces.outliers == len(struck)


def test_large_spike_does_not_take_its_piece_along():
    case = Case(noise=1.0)
    used = case.pieces().used
    struck = np.flatnonzero(case.leg == 1)[300]
    xyz = case.samples.xyz.copy()
    xyz[struck] *= 1.01
    assert used - case.pieces(Samples(case.samples.stamp_ns, xyz)).used == 1


def test_recording_without_a_moving_sample_is_refused():
    case = Case()
    with pytest.raises(InputError, match='no sample is left'):
        case.pieces(leg=np.full(len(case.leg), OFF_PATH))


@pytest.mark.parametrize('size', [1, 2, 7, 8, 11, 40])
def test_every_window_is_combined_whatever_its_size(size):
    values = np.random.default_rng(size).normal(size=(2, 40))
    expected = np.lib.stride_tricks.sliding_window_view(values, size, axis=1).max(axis=2)
    np.testing.assert_array_equal(over_windows(np.maximum, values, size), expected)
