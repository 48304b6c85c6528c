# SPDX-License-Identifier: Apache-2.0
"""Forecast: what a calibration will show equals what it does show; said in words."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from cli_cells import run
from core_cells import corner_path, plan_for_path, record, small_plan, smooth, some_machine
from html_cells import Page, unloading

from otf_core.calibration.calibrate import calibrate
from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError
from otf_core.model.chain import displacement
from otf_core.model.evaluation import free_rows, without_rigid_motion
from otf_core.model.machine import TrackerSpec
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.plan import Timing
from otf_core.noise.noise_model import NoiseComponent, NoiseModel, read_noise
from otf_core.planning.findings import chain_shows, findings
from otf_core.planning.follow_up import (
    beam_lengths,
    candidate_places,
    check_place,
    compare_places,
    judge_places,
)
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.line_of_sight import default_tracker_place
from otf_core.planning.plan_report import PlanRequest, make_plan, read_place
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


def test_repeating_at_other_times_helps_more_than_driving_slower():
    machine = some_machine()
    # errors of any size: what is expected of them tells nothing
    setup = Setup.of(machine, config=ForecastConfig(error_size=1e-2))
    once, slow = (forecast(small_plan(machine, feed=f), setup) for f in (0.25, 0.05))
    four = forecast(small_plan(machine, feed=0.25, feed_ratio=1.0, passes=4), setup)
    assert four.duration < slow.duration
    assert four.mean_grid_u == pytest.approx(once.mean_grid_u / 2, rel=0.01)
    assert four.mean_grid_u < slow.mean_grid_u < once.mean_grid_u


def test_correlated_noise_averages_out_less():
    machine = some_machine()
    plan, spec = small_plan(machine), machine.tracker
    white, slow = (
        forecast(plan, Setup.of(machine, noise=NoiseModel.from_spec(spec, w))) for w in (1.0, 0.1)
    )
    assert slow.mean_grid_u > 1.5 * white.mean_grid_u


@pytest.mark.parametrize(
    ('chain', 'error', 'mixed', 'said'),
    [
        ('w-b-X-Y-Z-t', 'EBZ', ('EXZ',), 'distinguished from EXZ with one target offset along Z'),
        ('w-Y-b-X-Z-t', 'EAZ', ('EYZ',), 'distinguished from EYZ with one target offset along Z'),
        ('w-Y-b-X-Z-t', 'ECX', (), 'rotation about a line through the reflectors'),
        ('w-X-Y-Z-b-t', 'ECY', ('EXY',), 'distinguished from EXY with one target offset along Z'),
    ],
)
def test_what_the_chain_hides_is_said_in_words(chain, error, mixed, said):
    machine = some_machine(chain, offset=(0.0, 0.0, -0.15))
    found = words(machine, small_plan(machine))
    assert set(found) == {n for n in MOTIONS if not chain_shows(machine, n)}
    assert found[error].mixed_with == mixed
    assert said in found[error].words
    assert 'target offset that differs' in found[error].needs


def test_lines_along_the_axes_alone_are_said_to_be_too_few():
    machine = some_machine(offset=(0.0, 0.0, -0.15))
    path = corner_path(machine, (0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), (0, 0, 1))
    found = words(machine, plan_for_path(path, PlannerConfig()))
    for name in ('EXX', 'EYY', 'EZZ'):
        assert 'along the lines of this path' in found[name].words
    assert 'along the lines of this path' in found['EBX'].words
    assert all('diagonals' in found[n].needs for n in ('EXX', 'EBX'))


def test_nodes_that_no_line_determines_are_named():
    machine = some_machine(offset=(0.0, 0.0, -0.15))
    plan = small_plan(machine)
    half = plan.path.points[:, 0] <= 0.16
    kept = plan.path.points[half]
    far = np.array([[0.3, 0.1, -0.1], [0.0, 0.1, -0.1]])
    path = type(plan.path)(np.concatenate([kept, far]))
    found = words(machine, plan_for_path(path, PlannerConfig()))
    assert 'X' not in found  # driven to both ends
    loose = [f for f in found.values() if 'not determined at X' in f.words]
    assert loose
    assert all('interpolated' in f.words for f in loose)


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


def test_places_beyond_the_range_limits_are_left_out():
    machine = some_machine()
    plan = small_plan(machine)
    limits = ForecastConfig(grid=2, min_range=0.2, max_range=0.65)
    setup = Setup.of(machine, config=limits)
    ranked = compare_places(plan, setup, judged(plan, setup))
    assert 0 < len(ranked) < 22
    assert max(p.longest for p in ranked) <= 0.65
    setup = Setup.of(machine, config=replace(limits, max_range=0.3))
    none = compare_places(plan, setup, judged(plan, setup))
    assert none == []


def test_place_is_judged_as_the_whole_forecast_judges_it():
    machine = some_machine()
    plan = small_plan(machine)
    for place in ([0.1, -0.5, 0.2], [-0.4, 0.3, 0.5]):
        setup = Setup.of(machine, np.array(place), config=ForecastConfig(grid=3))
        found = judged(plan, Setup.of(machine, config=setup.config))(setup.place)
        assert found == pytest.approx(forecast(plan, setup).mean_grid_u, rel=0.03)


def test_beam_lengths_are_to_the_lines_not_only_the_corners():
    machine = some_machine()
    plan = plan_for_path(corner_path(machine, (0, 0, 1), (1, 0, 1)), PlannerConfig())
    near, far = beam_lengths(plan, Setup.of(machine, np.array([0.15, -0.4, 0.0])))
    assert near == pytest.approx(0.4)
    assert far == pytest.approx(np.hypot(0.15, 0.4))


def test_tracker_inside_the_path_is_refused():
    machine = some_machine()
    inside = 0.5 * (machine.lower + machine.upper)
    with pytest.raises(ConfigError, match=r'tracker_place: beams .* measures 0\.15 m to 20 m'):
        check_place(small_plan(machine), Setup.of(machine, inside))
    assert check_place(small_plan(machine), Setup.of(machine)) is None
    assert default_tracker_place(machine)[1] < machine.lower[1]


@pytest.mark.parametrize('text', ['', '1,2', '1,2,3,4', 'a,b,c', '1,2,nan', '300,0,0'])
def test_wrong_place_is_refused(text):
    with pytest.raises(ConfigError, match='tracker_place'):
        read_place(text)


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


def test_wishes_that_exclude_each_other_are_refused():
    with pytest.raises(ConfigError, match='time_budget and wanted_uncertainty'):
        PlanRequest(time_budget=100.0, wanted_uncertainty=1e-6)
    for value in (0.0, -1.0, float('nan')):
        with pytest.raises(ConfigError, match='not above 0'):
            PlanRequest(time_budget=value)


def test_noise_given_counts_in_the_forecast():
    machine = some_machine()
    given = small_plan(machine)
    config, judged = PlannerConfig(), ForecastConfig(grid=2)
    loud, quiet = (
        make_plan(machine, PlanRequest(given=given, noise=noise), config, judged).forecast
        for noise in (NoiseModel.from_spec(TrackerSpec(1e-6, 8e-6)), None)
    )
    assert loud.u['EYX'].max() > 2 * quiet.u['EYX'].max()


@pytest.fixture
def machine_file(tmp_path):
    data = some_machine(offset=(0.0, 0.0, -0.15)).to_dict()
    file = tmp_path / 'machine.yaml'
    file.write_text(json.dumps(data))  # JSON is YAML
    return file


def test_plan_writes_path_forecast_and_no_program_unasked(tmp_path, machine_file, capsys):
    out = tmp_path / 'out'
    arguments = ('plan', '--machine', machine_file, '--out', out, '--tracker-place',
                 '-0.3,0.1,-0.1', {'passes': 1, 'levels': 2, 'grid': 2})  # fmt: skip
    assert run(*arguments) == 0
    said, hints = capsys.readouterr()
    names = ['manifest.json', 'path.csv', 'plan.json', 'report.html']
    assert sorted(f.name for f in out.iterdir()) == names
    assert 'no NC program: give --dialect' in hints.splitlines()[-1]
    assert len(said.splitlines()) <= 14
    assert said.splitlines()[-1] == f'open {out / "report.html"}'
    data = json.loads((out / 'plan.json').read_text())
    assert data['schema'] == 'otf-plan/2'
    assert data['assumed']['tracker_place'] == [-0.3, 0.1, -0.1]
    (part,) = data['parts']
    assert len(part['positions']) == len(part['feed']) + 1 == len(part['dwell'])
    assert set(data['forecast']['errors']) == {*SQUARENESS, *MOTIONS}
    entry = data['forecast']['errors']['EYX']
    assert len(entry['u']) == len(entry['position']) == len(entry['node_identifiable'])
    assert {f['error'] for f in data['not_shown']} == {
        n for n, e in data['forecast']['errors'].items() if not e['identifiable']
    }
    source = (out / 'report.html').read_text(encoding='utf-8')
    page = Page(source)
    assert page.faults == [] and unloading(source) == []
    assert '@top-left' in source and '(m)' not in page.text.replace('Beam (m)', '')
    assert [row[0] for row in page.rows('Position of the tracker')]
    assert 'written: path.csv, report.html, plan.json' in said
    for name, entry in data['forecast']['errors'].items():
        mean, unit = 1e6 * np.mean(entry['u']), 'µm' if entry['unit'] == 'm' else 'µrad'
        largest = 1e6 * np.max(entry['u'])
        said = (
            f'{mean:.2f}, largest {largest:.2f}\u00a0{unit}'
            if entry['identifiable']
            else 'not shown by this path'
        )
        row = re.search(rf'>{name}</text>.*?<text x="[^>]*>([^<]+)<', source)
        assert row[1] == said, name
    sight = {name: entry['visible'] for name, entry in data['effects'].items()}
    assert sight['backlash']
    assert not sight['tracker_scale']  # an equal slope of all axes
    assert not sight['target_offset']


def test_plan_judges_a_given_path(tmp_path, machine_file, capsys):
    (tmp_path / 'p.csv').write_text('x,y,z\n0,0,-0.1\n0.3,0.25,-0.1\n0.3,0,-0.1\n0,0.25,-0.1\n')
    out = tmp_path / 'out'
    arguments = ('plan', '--machine', machine_file, '--out', out, {'grid': 2})
    assert run(*arguments, '--path', tmp_path / 'p.csv') == 0
    said = capsys.readouterr().out
    assert 'Plan: the path given' in said
    page = (out / 'report.html').read_text(encoding='utf-8')
    assert 'EYZ: no part moves Z between tracker and reflector' in page


def test_recorded_plan_of_the_shared_cell_has_the_forecast_rank(cell):
    setup = Setup.of(cell.machine, config=ForecastConfig(rate=RATE))
    samples = record(cell.machine, cell.plan).measured(smooth(cell.truth), seed=5)
    result = calibrate(samples, cell.path, cell.machine)
    assert forecast(cell.plan, setup).joint.solution.rank == result.fit.rank
