# SPDX-License-Identifier: Apache-2.0
"""Budget of uncertainty: sources add up and are what they say; how shared parameters act."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from otf_core.budget.budget import (
    Budget,
    Source,
    make_budget,
    noise_parts,
    piece_states,
    standstill_freedom,
    welch_satterthwaite,
    whole_check,
)
from otf_core.calibration.calibrate import calibrate
from otf_core.config import CalibrationConfig
from otf_core.model.expanded import coverage_factor
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.sections import DeclaredUncertainty
from otf_core.noise.noise_model import NoiseModel
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.sim.tracker import measure
from otf_core.solving.joint import settle_covariance, solve_jointly, tables_of
from otf_core.solving.sensitivity import piece_state
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


def solve_again(solved, xyz):
    """Solve the same run with other measured points."""
    run = replace(solved.run, pieces=replace(solved.run.pieces, xyz=xyz))
    config = CalibrationConfig(piece_length=0.02)
    return solve_jointly([run], solved.done.unknowns, config, lambda stage, fraction: None)


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
