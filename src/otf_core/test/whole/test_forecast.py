# SPDX-License-Identifier: Apache-2.0
"""Forecast: what a calibration will show equals what it does show; said in words."""

import json

import numpy as np
import pytest
from core_cells import record, small_plan, smooth, some_machine

from otf_core.calibration.calibrate import calibrate
from otf_core.config import ForecastConfig, SimulationConfig
from otf_core.errors import ConfigError
from otf_core.model.chain import displacement
from otf_core.model.evaluation import free_rows, without_rigid_motion
from otf_core.model.motions import MOTIONS
from otf_core.model.plan import Timing
from otf_core.noise.noise_model import NoiseComponent, read_noise
from otf_core.planning.findings import findings
from otf_core.planning.follow_up import (
    candidate_places,
    check_place,
    compare_places,
    judge_places,
)
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.line_of_sight import default_tracker_place
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.sim.cell import random_tables, simulate
from otf_core.sim.drive import drives_of

LIMIT = 1e-4
RATE = 100.0


def words(machine, plan):
    result = forecast(plan, Setup.of(machine))
    return {f.error: f for f in findings(plan, result, LIMIT)}


@pytest.fixture(scope='module')
def runs():
    """Four simulated runs of one plan, each with its calibration and its forecast."""
    machine = some_machine(offset=(0.0, 0.0, -0.15))
    plan = small_plan(machine, feed=0.1, end_dwell=6.0)
    found = []
    for seed in range(2601, 2605):
        truth = smooth(random_tables(machine, 2e-5, np.random.default_rng(seed)))
        one = simulate(machine, plan, SimulationConfig(seed=seed, rate=RATE), truth)
        setup = Setup.of(machine, one.pose.translation, config=ForecastConfig(rate=RATE))
        found.append((one, calibrate(one.samples, plan.path, machine), forecast(plan, setup)))
    return found


def test_pieces_are_those_of_a_recording(runs):
    for one, result, foreseen in runs:
        pieces, expected = result.runs[0].pieces, foreseen.runs[0].pieces
        assert len(expected) == pytest.approx(len(pieces), rel=0.5)
        assert expected.used == pytest.approx(pieces.used, rel=0.005)
        assert foreseen.duration == pytest.approx(one.samples.time[-1], rel=1e-3)


def test_rank_and_what_is_seen_are_those_of_the_calibration(runs):
    for _, result, foreseen in runs:
        assert foreseen.joint.solution.rank == result.fit.rank
        assert foreseen.joint.solution.unknowns == result.fit.unknowns
        assert foreseen.not_identifiable == result.not_identifiable


def test_forecast_uncertainty_is_the_one_stated_afterwards(runs):
    ratios = []
    for _, result, foreseen in runs:
        seen = [n for n in MOTIONS if n not in result.not_identifiable]
        stated = np.concatenate([
            np.interp(foreseen.nodes[n[2]], table.position, table.u_run)
            for n in seen for table in [result.tables.motions[n]]
        ])  # fmt: skip
        expected = np.concatenate([foreseen.u[n] for n in seen])
        ratios.append(np.median(stated[expected > 0] / expected[expected > 0]))
    # the calibration estimates level and colour of the noise from 12 s of standstill
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_forecast_grid_uncertainty_is_the_error_achieved(runs):
    achieved, expected, spread = 0.0, 0.0, 0.0
    for one, result, foreseen in runs:
        grid = foreseen.grid
        field = displacement(result.tables, grid) - displacement(one.truth, grid)
        achieved += float(np.sum(without_rigid_motion(field, grid) ** 2))
        nodes = {m: foreseen.nodes[m[2]] for m in MOTIONS}
        rows = prediction_rows(one.truth.machine, nodes, grid)
        rows = free_rows(rows.reshape(-1, rows.shape[2]), grid)
        matrix = (rows.T @ rows) @ foreseen.covariance
        expected += float(np.trace(matrix))
        spread += 2 * float(np.sum(matrix * matrix.T))  # variance of a sum of squares
        assert float(np.sum(foreseen.grid_u_free**2)) == pytest.approx(float(np.trace(matrix)))
    assert abs(achieved - expected) < 3 * np.sqrt(spread)
    assert np.sqrt(spread) < 0.3 * expected  # so that this says something


@pytest.mark.parametrize('acceleration', [0.3, 2.0])
def test_drive_times_are_those_of_the_simulated_drive(acceleration):
    machine = some_machine()
    plan = small_plan(machine)
    times = Timing.of(machine, plan.parts[0], acceleration)
    (drive,) = drives_of(machine, plan, acceleration)
    assert times.duration == pytest.approx(drive.duration, abs=1e-9)
    for leg in (0, 7, len(plan.feed) - 1):
        along = np.linspace(0, times.size[leg], 9)
        moment = times.at(times.low[leg] + along, leg)
        np.testing.assert_allclose(times.way_at(moment), times.low[leg] + along, atol=1e-9)
        expected = plan.path.points[leg] + along[:, None] * plan.path.directions[leg]
        np.testing.assert_allclose(drive.at(moment), expected, atol=1e-9)


def test_part_of_a_range_that_is_not_driven_is_named_and_not_judged():
    machine = some_machine(offset=(0.0, 0.0, -0.15))
    plan = small_plan(machine, margin=0.01)
    assert 'driven from 10 to 290 mm' in words(machine, plan)['X'].words
    grid = forecast(plan, Setup.of(machine)).grid
    np.testing.assert_allclose(grid.min(axis=0), machine.lower + 0.01)
    np.testing.assert_allclose(grid.max(axis=0), machine.upper - 0.01)


def judged(plan, setup):
    return judge_places(plan, setup, forecast(plan, setup).accepted)


def test_places_lie_outside_the_volume_and_nearer_is_better():
    machine = some_machine()
    plan = small_plan(machine)
    setup = Setup.of(machine, config=ForecastConfig(grid=3))
    ranked = compare_places(plan, setup, judged(plan, setup))
    assert [p.mean_grid_u for p in ranked] == sorted(p.mean_grid_u for p in ranked)
    assert len(ranked) == len(candidate_places(machine, 0.3)) == 22
    for p in ranked:
        assert np.any((p.place < machine.lower) | (p.place > machine.upper))
        assert p.shortest >= 0.25
    near, far = (
        next(p for p in ranked if p.words == f'on the side -Y at half height, {d} m away')
        for d in ('0.30', '0.60')
    )
    assert near.mean_grid_u < far.mean_grid_u


def test_tracker_inside_the_path_is_refused():
    machine = some_machine()
    inside = 0.5 * (machine.lower + machine.upper)
    with pytest.raises(ConfigError, match=r'tracker_place: beams .* measures 0\.15 m to 20 m'):
        check_place(small_plan(machine), Setup.of(machine, inside))
    assert check_place(small_plan(machine), Setup.of(machine)) is None
    assert default_tracker_place(machine)[1] < machine.lower[1]


def test_noise_file_gives_levels_and_white_shares(tmp_path):
    file = tmp_path / 'noise.json'
    data = {'u_range': 5e-7, 'u_angle': [2e-6, 2e-6], 'white_range': 3e-7,
            'white_angle': [1e-6, 1e-6], 'correlation_time': 0.4}  # fmt: skip
    file.write_text(json.dumps(data))
    noise = read_noise(file)
    assert noise.horizontal == noise.vertical == NoiseComponent(2e-6, 1e-6, 0.4)
    assert (noise.range.white_share, noise.vertical.white_share) == pytest.approx((0.36, 0.25))
    for spoilt in ({}, data | {'u_range': 0.0}, data | {'u_angle': 'much'}):
        file.write_text(json.dumps(spoilt))
        with pytest.raises(ConfigError, match=r'noise\.json'):
            read_noise(file)
    with pytest.raises(ConfigError, match='cannot be read'):
        read_noise(tmp_path / 'none.json')


def test_recorded_plan_of_the_shared_cell_has_the_forecast_rank(cell):
    setup = Setup.of(cell.machine, config=ForecastConfig(rate=RATE))
    samples = record(cell.machine, cell.plan).measured(smooth(cell.truth), seed=5)
    result = calibrate(samples, cell.path, cell.machine)
    assert forecast(cell.plan, setup).joint.solution.rank == result.fit.rank
