# SPDX-License-Identifier: Apache-2.0
"""Budget of uncertainty: sources add up and are what they say; how shared parameters act."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from core_cells import some_machine
from nature_tracker import beam_frame

from otf_core.budget.budget import (
    Budget,
    Source,
    make_budget,
    noise_parts,
    piece_states,
    slow_amplitudes,
    standstill_freedom,
    welch_satterthwaite,
    whole_check,
)
from otf_core.budget.lines import budget_lines, correlations
from otf_core.calibration.calibrate import calibrate
from otf_core.config import CalibrationConfig
from otf_core.effects import REGISTRY
from otf_core.errors import ConfigError
from otf_core.model.expanded import coverage_factor
from otf_core.model.machine import load_machine, machine_from_dict
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import DECLARABLE, DeclaredUncertainty
from otf_core.noise.noise_model import MISFIT_TIME, NoiseComponent, NoiseModel
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.tracker import measure
from otf_core.solving.joint import settle_covariance, solve_jointly, tables_of
from otf_core.solving.sensitivity import components_across, piece_state, sensitivity
from otf_core.solving.unknowns import layout, linear_bases

NAMES = (*SQUARENESS, *MOTIONS)
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


MISFIT = (1e-7, 2e-7)
"""m; independent and lasting misfit that the small cell is weighted with."""


@pytest.fixture(scope='module')
def solved(cell):
    """The small cell without noise, prepared and solved step by step."""
    samples = cell.recording.measured(cell.truth, noise=0.0)
    recording = Recording(samples, cell.path, cell.machine)
    config = CalibrationConfig(piece_length=0.02)
    (run,), nodes = prepare_runs([recording], config)
    logs = [0.0, 0.0, 0.0, *(2 * np.log(m) for m in MISFIT)]
    run = replace(run, fitted=np.array(logs))
    unknowns = layout(linear_bases(cell.machine, nodes))
    done = solve_jointly([run], unknowns, config, lambda stage, fraction: None)
    done = settle_covariance(done, config.unidentifiable_above)
    state = piece_state(run, done.runs[0], nodes, cell.truth)
    budget = budget_of(run, samples, done)
    return SimpleNamespace(run=run, done=done, state=state, samples=samples, budget=budget)


def budget_of(run, samples, done):
    """Budget of a solution of one run."""
    states = piece_states([run], done, tables_of(run.machine, done.unknowns, done.solution))
    still = standstill_freedom([samples], [run], CalibrationConfig().standstill_speed)
    check = whole_check([run], done, [s.residual for s in done.runs])
    return make_budget([run], done, noise_parts([run], done), states, still, check)


def nodes_of(done):
    """Places of squareness and motions in the full vector."""
    blocks = done.unknowns.blocks
    return np.concatenate(
        [np.arange(blocks[n].start, blocks[n].stop) for n in (*SQUARENESS, *MOTIONS)]
    )


def part(result, source):
    """Standard uncertainties of one source, by name of table."""
    chosen = [s for s in result.budget.sources if s.name == source]
    rows = result.budget.rows
    u = np.sqrt(np.diag(rows @ sum(s.covariance for s in chosen) @ rows.T))
    sizes = [1, 1, 1, *(len(result.tables.motions[m].position) for m in MOTIONS)]
    return dict(zip(NAMES, np.split(u, np.cumsum(sizes)[:-1]), strict=True))


def test_sources_add_up_in_quadrature_to_u(declared):
    rows = declared.budget.rows
    total = sum(np.diag(rows @ s.covariance @ rows.T) for s in declared.budget.sources)
    stated = [[declared.tables.squareness[n].u] for n in (*SQUARENESS, *MOTIONS)[:3]]
    stated += [declared.tables.motions[m].u for m in MOTIONS]
    np.testing.assert_allclose(np.concatenate(stated) ** 2, total, rtol=1e-9, atol=1e-24)
    np.testing.assert_allclose(np.diag(declared.covariance), total, rtol=1e-9, atol=1e-24)
    for line in budget_lines(declared.tables, declared.budget):
        assert np.hypot.reduce(list(line.parts.values())) == pytest.approx(line.u)


def test_declared_contributions_leave_the_estimates_alone_and_widen_u(declared, calibrated):
    for name, table in calibrated.tables.motions.items():
        np.testing.assert_array_equal(declared.tables.motions[name].value, table.value)
        assert np.all(declared.tables.motions[name].u >= table.u_run * (1 - 1e-9))
    assert declared.budget.not_stated == ()
    assert len(calibrated.budget.not_stated) == 6
    assert calibrated.budget.not_stated[:2] == ('tracker scale', 'air')


def test_an_empty_declaration_leaves_the_tables_as_they_are(cell, calibrated):
    machine = with_declared(cell.machine, {})
    result = calibrate(cell.recording.measured(cell.truth), cell.path, machine)
    one, other = (r.to_dict() for r in (result, calibrated))
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


def test_sensitivity_is_the_shift_of_the_tables_that_a_range_offset_makes(solved, monkeypatch):
    held = SimpleNamespace(run=lambda start: solved.done.roughness)
    monkeypatch.setattr('otf_core.solving.joint.Search', lambda *_: held)
    offset, order = 5e-6, nodes_of(solved.done)
    terms = REGISTRY['tracker_range_offset'].terms(solved.state, {})
    columns = components_across(solved.done.runs[0], terms.columns)
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
    config = CalibrationConfig(piece_length=0.02)
    return solve_jointly([run], solved.done.unknowns, config, lambda stage, fraction: None)


def _weigh(solved, columns):
    """Multiply by the inverse of the whole noise covariance, written out leg by leg."""
    run, result = solved.done.runs[0], np.zeros_like(columns)
    for (low, high), leg in zip(run.whitener.bounds, run.whitener.factors, strict=True):
        for k, factor in enumerate(leg):
            result[k, low:high] = np.linalg.solve(factor @ factor.T, columns[k, low:high])
    return result.reshape(-1, columns.shape[2])


def _between(run, amplitudes, correlation_time):
    """Covariance of all rows, for amplitudes (c, p, k) of slow noise; and where legs differ."""
    c, p, k = amplitudes.shape
    flat = amplitudes.reshape(c * p, k)
    time, leg = np.tile(run.pieces.time, c), np.tile(run.pieces.leg, c)
    decay = np.exp(-np.abs(time[:, None] - time) / correlation_time)
    return (flat @ flat.T) * decay * (leg[:, None] != leg)


def _weighed_design(solved):
    """W A, (rows, full), without the motions that are not solved for."""
    done = solved.done
    c, p = done.runs[0].system.deviation.shape
    weighed = _weigh(solved, done.runs[0].system.design.toarray().reshape(c, p, -1))
    left_out = [m for m in MOTIONS if m not in done.solution.accepted]
    assert left_out
    for motion in left_out:
        weighed[:, done.unknowns.blocks[motion]] = 0.0
    return weighed


def test_noise_across_corners_is_that_of_all_pairs_of_legs(solved):
    run, done = solved.run, solved.done
    weighed = _weighed_design(solved)
    found = noise_parts([run], done)
    half = 0.5 * run.pieces.duration / MISFIT_TIME
    shared = done.runs[0].system.axes * (MISFIT[1] * np.sinh(half) / half)[:, None]
    for amplitudes, time, part in (
        (slow_amplitudes(run, done.runs[0]), run.noise.range.correlation_time,
         found.corners),
        (shared, MISFIT_TIME, found.misfit_corners),
    ):  # fmt: skip
        expected = weighed.T @ _between(run, amplitudes, time) @ weighed
        np.testing.assert_allclose(part, expected, atol=1e-9 * np.abs(expected).max())


def test_rows_of_a_line_share_what_unequal_angles_bring(solved):
    """All pairs of rows written out: white at one time, slow by the time between."""
    parts = [(1e-6, 0.5e-6, 0.3), (1e-6, 0.7e-6, 0.2), (4e-6, 2e-6, 0.5)]
    noise = NoiseModel(*(NoiseComponent(*p) for p in parts))
    run, done = replace(solved.run, noise=noise, fitted=None), solved.done.runs[0]
    c, p = done.system.deviation.shape
    pieces = run.pieces
    directions = beam_frame(pieces.xyz) @ done.pose.rotation.T
    directions[1:] *= np.linalg.norm(pieces.xyz, axis=1)[:, None]
    rows = np.einsum('cpi,kpi->kcp', done.system.axes, directions).reshape(3, -1)
    gap = np.abs(pieces.time[:, None] - pieces.time)
    covariance = np.zeros((c * p, c * p))
    for row, (level, white, tau) in zip(rows, parts, strict=True):
        x = pieces.duration / tau
        half = 2 * np.sinh(0.5 * x) / x
        shape = np.exp(-gap / tau) * np.outer(half, half)
        np.fill_diagonal(shape, 2 * (x - 1 + np.exp(-x)) / x**2)
        one = white**2 * np.diag(1 / pieces.count) + (level**2 - white**2) * shape
        covariance += np.outer(row, row) * np.tile(one, (c, c))
    component, leg = np.repeat(np.arange(c), p), np.tile(pieces.leg, c)
    covariance *= (component[:, None] != component) & (leg[:, None] == leg)
    weighed = _weighed_design(solved)
    expected = weighed.T @ covariance @ weighed
    found = noise_parts([run], solved.done).between
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    alike = replace(run, noise=NoiseModel(noise.range, noise.vertical, noise.vertical))
    rest = noise_parts([alike], solved.done).between
    assert np.abs(rest).max() < 0.2 * np.abs(found).max()


def _source(solved, name):
    return next(s.covariance for s in solved.budget.sources if s.name == name)


def _drawn(solved):
    """What the uncertainty of the roughness adds."""
    moved = solved.done.unknowns.gauge @ solved.done.roughness.drawn
    return moved @ moved.T


def _crossing(solved):
    """C A'W S W A C for the noise that lines share across corners, and rows within a line."""
    own = solved.done.solution.covariance
    parts = noise_parts([solved.run], solved.done)
    return own @ (parts.between + parts.corners + parts.misfit_corners) @ own


def test_noise_misfit_and_smoothness_add_up_to_the_posterior_covariance(solved):
    """No residual, so no inflation: C, what crosses corners, and what roughness leaves open."""
    own = solved.done.solution.covariance
    assert solved.budget.inflation == 1.0
    assert [s.name for s in solved.budget.sources] == ['noise', 'misfit', 'smoothness']
    expected = own + _crossing(solved) + _drawn(solved)
    np.testing.assert_allclose(solved.budget.whole, expected, atol=1e-12 * np.abs(expected).max())


def test_smoothness_is_what_data_and_noise_do_not_explain(solved):
    """C K^-1 C = C - C A'W A C: the squared bias to expect of motions drawn from the prior."""
    own = solved.done.solution.covariance
    normal = solved.done.runs[0].system.design.T @ _weighed_design(solved)
    found = _source(solved, 'smoothness') - _drawn(solved)
    np.testing.assert_allclose(found, own - own @ normal @ own, atol=1e-9 * np.abs(own).max())
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.abs(own).max()
    assert np.abs(found).max() > 1e-4 * np.abs(own).max()


def test_smoothness_is_the_expected_squared_bias(solved):
    """Without noise motions c drawn from the prior come out as C N c: off by (C N - 1) c."""
    done, gauge = solved.done, solved.done.unknowns.gauge
    use = np.flatnonzero(np.diag(done.solution.covariance)[done.unknowns.kept])
    place = np.ix_(use, use)
    covariance = done.solution.covariance[np.ix_(done.unknowns.kept, done.unknowns.kept)][place]
    root = np.linalg.cholesky(np.linalg.inv(done.roughness.precision[place]))
    drawn = root @ np.random.default_rng(1).standard_normal((use.size, 4000))
    bias = (covariance @ done.normal.matrix[place] - np.eye(use.size)) @ drawn
    found = (_source(solved, 'smoothness') - _drawn(solved))[
        np.ix_(done.unknowns.kept, done.unknowns.kept)
    ]
    assert gauge.shape[1] == len(found)
    # 4000 draws: variances within 2.2 %, k = 1
    np.testing.assert_allclose(np.mean(bias**2, axis=1), np.diag(found[place]), rtol=0.12)


def test_misfit_is_its_part_of_the_weights_alone(solved):
    """C A'W S W A C, S of the misfit written out from its two sizes."""
    run, own = solved.run, solved.done.solution.covariance
    c, p = solved.done.runs[0].system.deviation.shape
    time, half = run.pieces.time, 0.5 * run.pieces.duration / MISFIT_TIME
    smoothed = np.sinh(half) / half
    lasting = np.exp(-np.abs(time[:, None] - time) / MISFIT_TIME) * np.outer(smoothed, smoothed)
    x = 2 * half
    np.fill_diagonal(lasting, 2 * (x - 1 + np.exp(-x)) / x**2)
    lasting *= run.pieces.leg[:, None] == run.pieces.leg
    one = MISFIT[0] ** 2 * np.eye(p) + MISFIT[1] ** 2 * lasting
    weighed = _weighed_design(solved).reshape(c, p, -1)
    within = own @ sum(part.T @ one @ part for part in weighed) @ own
    parts = noise_parts([run], solved.done)
    expected = within + own @ parts.misfit_corners @ own
    found = _source(solved, 'misfit')
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_residuals_beyond_the_weights_enter_as_misfit(solved):
    loud = [replace(s, residual=1e-6 * np.ones_like(s.residual)) for s in solved.done.runs]
    done = replace(solved.done, runs=tuple(loud))
    budget = budget_of(solved.run, solved.samples, done)
    assert budget.inflation > 5.0
    data = done.solution.covariance - (_source(solved, 'smoothness') - _drawn(solved))
    added = budget.whole - solved.budget.whole
    np.testing.assert_allclose(
        added, (budget.inflation - 1.0) * data, atol=1e-9 * np.abs(added).max()
    )


def test_scatter_over_draws_of_coloured_noise_agrees_with_the_linear_u(cell, solved):
    """Monte Carlo (JCGM 101), few draws.

    The truth stays, so that the bias of the prior does not scatter: noise alone does.
    """
    spec = NoiseModel.from_spec(cell.machine.tracker)
    run, values = solved.run, []
    xyz, order = run.recording.samples.xyz, nodes_of(solved.done)
    for draw in range(8):
        noise = measure(xyz, spec, 100.0, np.random.default_rng([5, draw])) - xyz
        moved = run.pieces.xyz + run.pieces.mean_of([noise[run.pieces.samples]])
        values.append(solve_again(solved, moved).solution.value[order])
    stated = np.diag(_source(solved, 'noise'))[order]
    seen = stated > 1e-18
    ratio = np.var(values, axis=0, ddof=1)[seen] / stated[seen]
    # 7 degrees of freedom of some 70 correlated nodes, about 25 free: 11 %; 4 of it
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.44)
    assert np.all(stated <= np.diag(solved.budget.whole)[order])


def test_few_degrees_of_freedom_make_the_coverage_factor_large():
    assert coverage_factor(np.inf) == coverage_factor(61.0) == 2.0
    assert coverage_factor(10.7) == pytest.approx(2.228, abs=1e-3)  # table of t, 10 degrees
    # GUM G.4.1: two equal variances, 8 degrees and none: 32
    freedom = welch_satterthwaite(np.array([[1.0], [1.0]]), np.array([8.0, np.inf]))
    assert freedom[0] == pytest.approx(32.0)
    one = Source('one', np.diag([1.0, 4.0]), 8.0)
    other = Source('other', np.diag([1.0, 0.0]), np.inf)
    budget = Budget((one, other), (), 1.0, np.eye(2), np.zeros(2))
    assert budget.expansion(budget.variances()) == (pytest.approx(2.306, abs=1e-3), 8.0)


def test_file_holds_budget_correlations_and_coverage_factors(declared):
    found = declared.to_dict()
    exx = found['motions']['EXX']
    np.testing.assert_allclose(exx['u'], declared.expanded['EXX'] / exx['k'], atol=1e-15)
    assert (exx['dof'] is None or exx['dof'] > 30) and found['motions']['ECZ']['k'] is None
    assert not any(found['motions']['ECZ']['u'])
    assert 'air' in found['budget']['u_rms']['EXX']['sources']
    strong = found['correlations']['strongest']
    assert 0 < len(strong) <= 20
    assert all(0.5 <= abs(pair['r']) <= 1 + 1e-9 for pair in strong)
    pairs = correlations(declared.tables, declared.covariance)
    assert found['correlations']['more'] == max(0, len(pairs) - 20)
    json.dumps(found, allow_nan=False)


def test_declaration_is_read_echoed_and_checked(tmp_path):
    plain = some_machine().to_dict()
    data = {**plain, 'uncertainty': DECLARED}
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(data))
    assert load_machine(file).to_dict() == data
    assert set(DECLARED) == set(DECLARABLE)
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
