# SPDX-License-Identifier: Apache-2.0
"""What the benches set beside the project is right: reduction, sparse rows, messages."""

import sys
from pathlib import Path

import numpy as np
import pytest
from nature import LETTERS, Cell
from rosbags.typesys import Stores, get_typestore

BENCH = Path(__file__).resolve().parents[3] / 'bench'
pytestmark = pytest.mark.skipif(not BENCH.is_dir(), reason='the benches are not installed')
sys.path.append(str(BENCH))


@pytest.fixture(scope='module')
def reduced():
    from linear_estimators import table_bases
    from simple_pieces import reduce_run

    cell = Cell(5, size=(0.3, 0.25, 0.2), pitch=0.05, path='short', passes=1)
    recording = cell.recording(rate=100.0, factor=0.1)
    samples, bases = recording.samples, table_bases(cell)
    nodes = [bases[f'EX{axis}'].nodes for axis in LETTERS]
    return cell, bases, reduce_run(samples.stamp_ns, samples.xyz, cell.path.points, nodes)


def test_simple_pieces_lie_on_the_driven_lines(reduced):
    cell, bases, run = reduced
    points = run.pieces.xyz @ run.T_machine_tracker.rotation.T + run.T_machine_tracker.translation
    off = np.cross(points - run.pieces.origin, run.pieces.direction)
    assert np.linalg.norm(off, axis=1).max() < 5e-4  # errors of the machine, not another leg
    true = (run.pieces.xyz @ cell.rotation) + cell.place
    assert np.linalg.norm(points - true, axis=1).max() < 5e-4
    for k, axis in enumerate(LETTERS):
        nodes = bases[f'EX{axis}'].nodes
        beside = np.abs(points[:, k, None] - nodes).min(axis=1)
        along = np.abs(run.pieces.direction[:, k]) > 0.99
        assert np.median(beside[along]) > 2e-3  # means lie between nodes, not on them


def test_sparse_rows_are_the_dense_ones(reduced):
    from alternatives_jobs import whole_rows
    from linear_estimators import design, geometry

    cell, bases, run = reduced
    pose = run.T_machine_tracker
    still = np.zeros((len(run.pieces.leg), 3))
    place = geometry(run.pieces, pose.rotation, pose.translation, still)
    rows = whole_rows(cell, bases, place).toarray()
    assert np.abs(rows - design(cell, bases, place)).max() < 1e-12


def test_derivatives_are_those_of_the_residuals(reduced):
    from alternatives_jobs import UM, Problem, residuals, whole_rows
    from linear_estimators import geometry

    cell, bases, run = reduced
    pose = run.T_machine_tracker
    still = np.zeros((len(run.pieces.leg), 3))
    place = geometry(run.pieces, pose.rotation, pose.translation, still)
    given = Problem(cell, bases, run, place, whole_rows(cell, bases, place))
    step = 1e-6 * np.random.default_rng(1).standard_normal(given.rows.shape[1])
    change = residuals(given, step) - residuals(given, 0 * step)
    assert np.abs(change + UM * given.rows @ step).max() < 1e-3 * np.abs(change).max()


def test_bulk_messages_are_those_of_rosbags():
    from calibrate_jobs import encoded

    store = get_typestore(Stores.ROS2_JAZZY)
    stamp = np.array([1_700_000_000_123_456_789])
    row = encoded(stamp, np.array([[0.1, -2.0, 3.5]]))[0].tobytes()
    message = store.deserialize_cdr(row, 'geometry_msgs/msg/PointStamped')
    assert message.header.frame_id == 'tracker'
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(stamp[0], 10**9)
    assert (message.point.x, message.point.y, message.point.z) == (0.1, -2.0, 3.5)
    again = store.serialize_cdr(message, 'geometry_msgs/msg/PointStamped')
    assert bytes(again) == row
