# SPDX-License-Identifier: Apache-2.0
"""Standstill method: recognition of stops, their order, and the calibration from them."""

import numpy as np
import pytest
from core_cells import CONTRACT_CHAINS, START_NS, some_machine, tracker_noise
from scipy.spatial.transform import Rotation
from standstill_points import edge_points, spread_points, standstill_plan

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.model.chain import displacement
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.pieces.runs import Recording
from otf_core.pieces.stops import (
    align_stops,
    find_stops,
    match_in_order,
)
from otf_core.sim.cell import simulate
from otf_core.tracking.matching import OFF_PATH

CONFIG = CalibrationConfig()


def points_of(machine, edges=40, inner=60):
    return np.concatenate([edge_points(machine, edges), spread_points(machine, inner)])


def run_of(machine, points, seed=1, size=2e-5, rate=100.0, dwell=1.0):
    plan = standstill_plan(points, 0.5, dwell)
    return plan, simulate(machine, plan, SimulationConfig(seed=seed, error_size=size, rate=rate))


def calibrated(machine, samples, path):
    return calibrate_recordings([Recording(samples, path, machine)], method='standstill')


def left_over(result, truth):
    """Error on a grid before and after, and the components of what is left."""
    q = lattice(truth.machine, 5)
    true = displacement(truth, q)
    left = without_rigid_motion(true - displacement(result.tables, q), q)
    return mean_length(without_rigid_motion(true, q)), mean_length(left), left


@pytest.mark.parametrize('chain', CONTRACT_CHAINS)
def test_tables_from_stops_leave_little_of_the_error(chain):
    machine = some_machine(chain)
    plan, run = run_of(machine, points_of(machine))
    result = calibrated(machine, run.samples, plan.path)
    before, after, _ = left_over(result, run.truth)
    # 100 stops; angle noise of 2 urad over 0.5 m, slow for half of its variance: 0.7 um a stop
    assert after < 0.04 * before
    assert result.fit.pieces == 100
    assert result.fit.coverage == 1.0
    assert result.runs[0].residual.shape == (3, 100)
    assert not result.failed_gates
    points, places = result.runs[0].pieces.xyz, result.runs[0].pieces.origin
    points, places = points - points.mean(axis=0), places - places.mean(axis=0)
    left = places - Rotation.align_vectors(places, points)[0].apply(points)
    assert result.fit.path_mae_before == pytest.approx(mean_length(left), rel=1e-6)


def test_without_noise_the_errors_come_back():
    machine = some_machine()
    plan = standstill_plan(points_of(machine, 60, 120), 0.5, 1.0)
    quiet = some_machine()
    object.__setattr__(quiet, 'tracker', type(machine.tracker)(1e-12, 1e-12))
    run = simulate(quiet, plan, SimulationConfig(error_size=2e-5, rate=100.0))
    before, after, _ = left_over(calibrated(machine, run.samples, plan.path), run.truth)
    assert after < 0.003 * before


def stops_only(machine, places, seed=0, rate=200.0, moves=None):
    """Samples at places; between them straight moves, or what ``moves`` gives for two places."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, place in enumerate(places):
        rows.append(np.tile(place, (int(0.6 * rate), 1)))
        if k < len(places) - 1:
            share = np.linspace(0, 1, int(0.5 * rate))[:, None]
            rows.append(place + share * (places[k + 1] - place) + (moves(share) if moves else 0))
    true = np.concatenate(rows)
    station = np.array([-0.4, 0.1, -0.1])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    xyz = (true - station) @ turn.T
    xyz += tracker_noise(xyz, machine.tracker, rng)
    return Samples(START_NS + np.rint(np.arange(len(xyz)) / rate * 1e9).astype(np.int64), xyz)


def points_of_stops(samples, places):
    """How stops align with places, and the place of every one."""
    alignment = align_stops(samples, NominalPath(places), CONFIG)
    return alignment, alignment.leg[find_stops(samples, CONFIG).span[:, 0]]


def test_only_the_stops_count_not_the_way_between_them():
    machine = some_machine()
    places = spread_points(machine, 30)
    arc = stops_only(
        machine, places, moves=lambda s: 0.05 * np.sin(np.pi * s) * np.array([0.3, 1.0, 0.5])
    )
    np.testing.assert_array_equal(points_of_stops(arc, places)[1], np.arange(30))


def test_missed_and_additional_stops_do_not_confuse_the_order():
    machine = some_machine()
    places = spread_points(machine, 40)
    driven = np.delete(places, [5, 17, 18], axis=0)
    driven = np.insert(driven, 9, [0.15, 0.12, 0.3], axis=0)  # elsewhere, such as a tool change
    alignment, point = points_of_stops(stops_only(machine, driven), places)
    expected = np.insert(np.delete(np.arange(40), [5, 17, 18]), 9, OFF_PATH)
    np.testing.assert_array_equal(point, expected)
    assert alignment.coverage == pytest.approx(37 / 40)


def test_repeated_points_count_each_and_collinear_ones_too():
    machine = some_machine()
    places = spread_points(machine, 12)
    places = np.concatenate([places, places[3:6], [0.5 * (places[5] + places[6])], places[6:9]])
    samples = stops_only(machine, places)
    alignment, point = points_of_stops(samples, places)
    np.testing.assert_array_equal(point, np.arange(len(places)))
    assert alignment.last_leg_driven


def test_match_in_order_never_runs_backwards():
    line = np.arange(4.0)[:, None] * [1, 0, 0]
    nominal = np.concatenate([line, line[::-1]])  # there and back: every point twice
    found = match_in_order(line[[0, 2, 3, 1, 0]], nominal, 0.1)
    assert np.all(np.diff(found) >= 0)
    np.testing.assert_array_equal(nominal[found], line[[0, 2, 3, 1, 0]])
    found = match_in_order(np.array([[0.0, 0, 0], [9, 9, 9], [2, 0, 0]]), line, 0.1)
    np.testing.assert_array_equal(found, [0, OFF_PATH, 2])
