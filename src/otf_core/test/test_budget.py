# SPDX-License-Identifier: Apache-2.0
"""Budget of uncertainty: sources add up, shared parameters act as they must, bends are found."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from core_cells import some_machine
from scipy.interpolate import CubicSpline

from otf_core.budget.bend import node_operator
from otf_core.budget.budget import NAMES, Budget, Source, make_budget, table_order
from otf_core.budget.columns import across, piece_state, sensitivity
from otf_core.budget.declared import KEYS, DeclaredUncertainty
from otf_core.budget.freedom import coverage_factor, welch_satterthwaite
from otf_core.budget.noise import noise_parts, slow_amplitudes
from otf_core.budget.report import budget_lines, budget_to_dict, correlations, expanded
from otf_core.budget.unseen import unseen_products
from otf_core.calibrate import calibrate
from otf_core.config import CalibrationConfig, SimulationConfig
from otf_core.effects import REGISTRY
from otf_core.errors import ConfigError
from otf_core.joint import solve_jointly, tables_of
from otf_core.machine import load_machine, machine_from_dict
from otf_core.results import format_result, result_to_dict
from otf_core.runs import Recording, prepare_runs
from otf_core.sim.tracker import measure
from otf_core.tables import MOTIONS, MotionTable
from otf_core.unknowns import layout

DECLARED = {
    'tracker_scale': 2e-6,
    'air_temperature': 1.0,
    'air_pressure': 200.0,
    'tracker_range_offset': 2e-6,
    'tracker_offset': 3e-6,
    'tracker_angle': 1e-6,
    'machine_temperature': 0.5,
    'expansion': 1.2e-5,
    'target_offset': 1e-3,
}


def with_declared(machine, values):
    return replace(machine, uncertainty=DeclaredUncertainty(values))


@pytest.fixture(scope='module')
def declared(cell):
    """Calibration of the small cell with everything declared."""
    machine = with_declared(cell.machine, DECLARED)
    return calibrate(cell.recording.measured(cell.truth), cell.path, machine)


@pytest.fixture(scope='module')
def solved(cell):
    """The small cell without noise, prepared and solved step by step."""
    samples = cell.recording.measured(cell.truth, noise=0.0)
    recording = Recording(samples, cell.path, cell.machine)
    config = CalibrationConfig(piece_length=0.02)
    runs, nodes = prepare_runs([recording], config)
    done = solve_jointly(runs, layout(nodes), config, lambda stage, fraction: None)
    state = piece_state(runs[0], done.runs[0], nodes, cell.truth)
    return SimpleNamespace(run=runs[0], done=done, state=state, config=config)


def part(result, source):
    """Standard uncertainties of one source, by name of table."""
    chosen = [s for s in result.budget.sources if s.name == source]
    u = np.sqrt(np.diag(sum(s.covariance for s in chosen)))
    sizes = [1, 1, 1, *(len(result.tables.motions[m].position) for m in MOTIONS)]
    return dict(zip(NAMES, np.split(u, np.cumsum(sizes)[:-1]), strict=True))


def test_sources_add_up_in_quadrature_to_u(declared):
    total = sum(np.diag(s.covariance) for s in declared.budget.sources)
    stated = [[declared.tables.squareness[n].u] for n in NAMES[:3]]
    stated += [declared.tables.motions[m].u for m in MOTIONS]
    np.testing.assert_allclose(np.concatenate(stated) ** 2, total, rtol=1e-9, atol=1e-24)
    np.testing.assert_allclose(np.diag(declared.covariance), total, rtol=1e-9, atol=1e-24)
    for line in budget_lines(declared.tables, declared.budget):
        assert np.hypot.reduce(list(line.parts.values())) == pytest.approx(line.u)


def test_declared_contributions_leave_the_estimates_alone_and_widen_u(declared, calibrated):
    for name, table in calibrated.tables.motions.items():
        np.testing.assert_array_equal(declared.tables.motions[name].value, table.value)
        assert np.all(declared.tables.motions[name].u >= table.u * (1 - 1e-9))
    assert declared.budget.not_stated == ()
    assert len(calibrated.budget.not_stated) == 6
    assert 'not included: tracker scale, air' in format_result(calibrated)


def test_an_empty_declaration_leaves_the_tables_as_they_are(cell, calibrated):
    machine = with_declared(cell.machine, {})
    result = calibrate(cell.recording.measured(cell.truth), cell.path, machine)
    one, other = (result_to_dict(r) for r in (result, calibrated))
    for key in ('motions', 'squareness', 'covariance', 'budget', 'fit'):
        assert json.dumps(one[key]) == json.dumps(other[key]), key
    assert 'uncertainty' not in other['machine']


def test_scale_makes_positioning_uncertain_in_proportion_to_the_distance(declared):
    scale, air = part(declared, 'tracker scale'), part(declared, 'air')
    for axis in 'XYZ':
        table = declared.tables.motions[f'E{axis}{axis}']
        distance = np.abs(table.position)  # the reference position is zero on all axes
        np.testing.assert_allclose(scale[f'E{axis}{axis}'], 2e-6 * distance, rtol=1e-6, atol=1e-12)
        relative = np.hypot(0.93e-6, 2.7e-9 * 200)
        np.testing.assert_allclose(air[f'E{axis}{axis}'], relative * distance, atol=1e-12)
    for name in ('C0Y', 'EYX', 'EXZ', 'EAX'):
        assert scale[name].max() < 1e-10


def test_machine_temperature_acts_by_expansion_over_the_travel(declared):
    found = part(declared, 'machine temperature')
    table = declared.tables.motions['EYY']
    np.testing.assert_allclose(found['EYY'], 0.5 * 1.2e-5 * np.abs(table.position), atol=1e-11)
    assert found['EXY'].max() < 1e-10


def test_sensitivity_is_the_shift_of_the_tables_that_a_range_offset_makes(solved):
    offset, order = 5e-6, table_order(solved.done.unknowns)
    terms = REGISTRY['tracker_range_offset'].terms(solved.state, {})
    columns = across(solved.done.runs[0], terms.columns)
    expected = offset * sensitivity(solved.done, [columns])[order, 0]
    xyz = solved.run.pieces.xyz
    longer = xyz * (1.0 + offset / np.linalg.norm(xyz, axis=1, keepdims=True))
    again = solve_again(solved, longer)
    shift = again.solution.value[order] - solved.done.solution.value[order]
    assert np.abs(expected).max() > 1e-6
    np.testing.assert_allclose(shift, expected, atol=1e-3 * np.abs(expected).max())


def solve_again(solved, xyz):
    """Solve the same run with other measured points."""
    run = replace(solved.run, pieces=replace(solved.run.pieces, xyz=xyz))
    return solve_jointly([run], solved.done.unknowns, solved.config, lambda stage, fraction: None)


def _weigh(solved, columns):
    """Multiply by the inverse of the whole noise covariance, written out leg by leg."""
    run, result = solved.done.runs[0], np.zeros_like(columns)
    for (low, high), leg in zip(run.whitener.bounds, run.whitener.factors, strict=True):
        for k, factor in enumerate(leg):
            result[k, low:high] = np.linalg.solve(factor @ factor.T, columns[k, low:high])
    return result.reshape(-1, columns.shape[2])


def test_noise_across_corners_is_that_of_all_pairs_of_legs(solved):
    run, done = solved.run, solved.done
    amplitudes = slow_amplitudes(run, done.runs[0], solved.state)
    c, p, _ = amplitudes.shape
    flat = amplitudes.reshape(c * p, 3)
    time, leg = np.tile(run.pieces.time, c), np.tile(run.pieces.leg, c)
    decay = np.exp(-np.abs(time[:, None] - time) / run.noise.correlation_time)
    between = (flat @ flat.T) * decay * (leg[:, None] != leg)
    design = done.runs[0].system.design.toarray()
    weighed = _weigh(solved, design.reshape(c, p, -1))
    expected = weighed.T @ between @ weighed
    found = noise_parts([run], done, [solved.state]).corners
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_scatter_over_draws_of_coloured_noise_agrees_with_the_linear_u(cell, solved):
    """Monte Carlo (JCGM 101), few draws; bench/coverage.py --same-machine has many."""
    config = SimulationConfig(rate=100.0)  # its colour is the one assumed without standstill
    run, unknowns = solved.run, solved.done.unknowns
    xyz, values = run.recording.samples.xyz, []
    for draw in range(8):
        noise = measure(xyz, cell.machine, config, np.random.default_rng([5, draw])) - xyz
        moved = run.pieces.xyz + run.pieces.mean_of(noise[run.pieces.samples])
        done = solve_again(solved, moved)
        values.append(done.solution.value[table_order(unknowns)])
    tables = tables_of(cell.machine, unknowns, solved.done.solution)
    budget = make_budget([run], solved.done, tables, solved.config.standstill_speed)
    stated = np.diag(budget.covariance)
    seen = stated > 1e-18
    ratio = np.var(values, axis=0, ddof=1)[seen] / stated[seen]
    # 7 degrees of freedom of some 70 correlated nodes, about 25 free: 11 %; 4 of it
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.44)


def smooth(tables):
    motions = {}
    for name, table in tables.motions.items():
        position = np.linspace(table.position[0], table.position[-1], 121)
        value = CubicSpline(table.position, table.value)(position)
        motions[name] = MotionTable(position, value, np.zeros(121))
    return replace(tables, motions=motions)


def test_smooth_truth_widens_u_and_straight_truth_does_not(cell, calibrated):
    assert part(calibrated, 'bend between nodes')['EXX'].max() == 0.0
    assert abs(calibrated.budget.bend_factor) < 4 * calibrated.budget.u_bend_factor
    bent = calibrate(cell.recording.measured(smooth(cell.truth)), cell.path, cell.machine)
    assert bent.budget.bend_factor == pytest.approx(1.0, abs=0.25)
    assert bent.budget.bend_factor > 10 * bent.budget.u_bend_factor
    assert part(bent, 'bend between nodes')['EXX'].max() > 1e-7


def test_least_squares_table_of_a_parabola_is_off_by_a_twelfth_of_its_second_difference():
    nodes = np.linspace(0.0, 0.4, 9)
    error = node_operator(nodes) @ nodes**2
    np.testing.assert_allclose(error, -2 * 0.05**2 / 12, rtol=0.005)  # 1 / 16 of the step


def test_rotations_with_their_own_travel_as_lever_are_told_from_others():
    carried = some_machine('w-X-Y-b-Z-t')
    assert unseen_products(carried, ()) == ['EBX', 'ECX', 'EAY', 'ECY']
    assert unseen_products(carried, ('EBX', 'ECX', 'EAY')) == ['ECY']
    assert unseen_products(some_machine('w-b-X-Y-Z-t'), ()) == []


def test_few_degrees_of_freedom_make_the_coverage_factor_large():
    assert coverage_factor(np.inf) == pytest.approx(1.95996, abs=1e-5)
    assert coverage_factor(10.7) == pytest.approx(2.228, abs=1e-3)  # table of t, 10 degrees
    # GUM G.4.1: two equal variances, 8 degrees and none: 32
    freedom = welch_satterthwaite(np.array([[1.0], [1.0]]), np.array([8.0, np.inf]))
    assert freedom[0] == pytest.approx(32.0)
    one = Source('one', np.diag([1.0, 4.0]), 8.0)
    other = Source('other', np.diag([1.0, 0.0]), np.inf)
    budget = Budget((one, other), (), 0.0, np.inf, 1.0, np.zeros((2, 2)))
    assert budget.expansion(budget.variances()) == (pytest.approx(2.306, abs=1e-3), 8.0)


def test_file_holds_expanded_uncertainty_budget_and_correlations(declared):
    lines = budget_lines(declared.tables, declared.budget)
    wide = expanded(declared.tables, lines)
    found = result_to_dict(declared)
    exx = found['motions']['EXX']
    np.testing.assert_allclose(exx['U'], exx['k'] * np.array(exx['u']))
    assert exx['dof'] > 30
    assert wide['ECZ'] == {'U': [0.0] * len(exx['U'][:5]), 'k': None, 'dof': None}
    assert 'air' in found['budget']['u_rms']['EXX']['sources']
    strong = found['correlations']['strongest']
    assert 0 < len(strong) <= 20
    assert all(0.5 <= abs(pair['r']) <= 1 + 1e-9 for pair in strong)
    pairs = correlations(declared.tables, declared.covariance)
    assert found['correlations']['more'] == max(0, len(pairs) - 20)
    json.dumps(budget_to_dict(declared.tables, declared.budget, lines), allow_nan=False)


def test_declaration_is_read_echoed_and_checked(tmp_path):
    plain = some_machine().to_dict()
    data = {**plain, 'uncertainty': DECLARED}
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(data))
    assert load_machine(file).to_dict() == data
    assert set(DECLARED) == set(KEYS)
    for section, message in (
        ({'tracker_scal': 1e-6}, 'uncertainty: tracker_scal: unknown key; known here: tracker_sc'),
        ({'air_pressure': -1.0}, 'uncertainty: air_pressure: -1 is out of range'),
        ({'machine_temperature': 1.0}, 'uncertainty: expansion: missing; machine_temperature'),
        ({'tracker_scale': '1 ppm'}, 'uncertainty: tracker_scale: expected a plain number'),
        ([1e-6], 'uncertainty: expected a mapping'),
    ):
        with pytest.raises(ConfigError) as caught:
            machine_from_dict({**plain, 'uncertainty': section})
        assert message in str(caught.value)
