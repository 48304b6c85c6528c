# SPDX-License-Identifier: Apache-2.0
"""The certified run with nothing given: what is searched for is judged by the likelihood itself.

The likelihood is the density of the deviations, normal with the covariance A K A' + R of
certified/, and knows nothing of how the core searches.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from certified import dense_least_squares as dense
from certified.error_model import ErrorModel
from certified.measured_rows import table_nodes
from certified.noise_matrix import noise_matrices
from scipy.optimize import minimize
from scipy.stats import Covariance, multivariate_normal
from test_certified import CONFIG, EXPECTED, RUN, SEEN, recording

from otf_core.calibration.assembly import assemble
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.diagnosis.diagnose import diagnose
from otf_core.diagnosis.engine.gap_sizes import simulated_um
from otf_core.diagnosis.engine.residual_rows import build_rows
from otf_core.pieces.runs import prepare_runs
from otf_core.solving.model_choice import solve_with_reversal
from otf_core.solving.roughness import MIN_GAIN, Search

NODES = table_nodes(RUN)
LIMIT = CONFIG.unidentifiable_above
UNIT = np.array([LIMIT**2, 1.0, LIMIT**2])
TOGETHER = dense.TOGETHER
NOISE_PRIOR = np.array([0.0, 0.0, 0.0, *[2 * np.log(5e-8)] * 2])
NOISE_SPREAD = np.array([0.7, 0.7, 0.7, 5.0, 5.0])
ONE_U = 0.5
"""Loss of log likelihood by a number that is off by its standard uncertainty."""


def silent(stage, fraction):
    pass


def published_noise(run):
    """Noise of a run of the result as certified/ counts it."""
    spec, noise = RUN['machine']['tracker'], run.noise.range
    return {
        'white': (noise.white / spec['u_range']) ** 2,
        'slow': (noise.slow / spec['u_range']) ** 2,
        'correlation_time': noise.correlation_time,
        'misfit_piece': run.misfit.independent,
        'misfit_line': run.misfit.slow,
    }


def log_density(step, noise, roughness):
    """Log density of the deviations of one step of the dense solution."""
    model, tracker = ErrorModel(RUN, NODES, 1), RUN['machine']['tracker']
    parts = noise_matrices(step.rows, step.pieces, step.pieces.xyz, step.pose[0], tracker, noise)
    spread = step.design @ np.linalg.inv(model.prior(roughness))
    root = np.linalg.cholesky(spread @ spread.T + parts[0] + parts[1])
    covariance = Covariance.from_cholesky(root)
    return multivariate_normal(cov=covariance).logpdf(step.rows.deviation)


@pytest.fixture(scope='module')
def found():
    """What the core found on its own, and the dense solution with that."""
    runs, nodes = prepare_runs([recording('samples.csv')], CONFIG)
    solved = solve_with_reversal(runs, nodes, CONFIG, silent)
    result = assemble(solved, CONFIG)
    noise = published_noise(result.runs[0])
    roughness = {m: UNIT * np.exp(solved.joint.roughness.logs[m]) for m in SEEN}
    model, pose = ErrorModel(RUN, NODES, 1), solved.runs[0].pose
    start = pose.rotation, pose.translation
    first, last = dense.solve(RUN, model, noise, model.prior(roughness), start=start)
    return SimpleNamespace(
        solved=solved,
        nodes=nodes,
        noise=noise,
        roughness=roughness,
        start=start,
        first=first,
        last=last,
    )


def test_noise_and_roughness_suffice_to_compute_the_tables_anew(found):
    result = calibrate_recordings([recording('samples.csv')], CONFIG)
    assert list(result.not_identifiable) == RUN['not_identifiable']
    assert result.table_costs[1].grid < 1e-15  # straight between the nodes
    wanted = dense.calibration(
        RUN, found.noise, found.roughness, NODES, 1, NODES, start=found.start
    )
    for name, motion in wanted['motions'].items():
        table, digits = result.tables.motions[name], 1e-6 * motion['u'].max()
        np.testing.assert_allclose(table.value, motion['value'], rtol=0, atol=digits)
        # what the roughness adds is taken at the points of the path of the repetition before the
        # last, those of the dense solution are final: 5e-6 of u apart
        np.testing.assert_allclose(table.u_run, motion['u'], rtol=0, atol=10 * digits)
    before = EXPECTED['straight']['fit']['path_mae_before']  # rigidly aligned
    assert result.fit.path_mae_before == pytest.approx(before, rel=1e-9)
    for name in ('path_mae_after', 'residual_rms', 'variance_ratio', 'inflation', 'rank'):
        assert getattr(result.fit, name) == pytest.approx(wanted['fit'][name], rel=1e-6), name


def changed(roughness, name, place, step):
    """Roughness with one logarithm moved."""
    moved = {m: v.copy() for m, v in roughness.items()}
    moved[name][place] *= np.exp(step)
    return moved


def test_likelihood_of_the_roughness_is_the_density_of_the_deviations(found, monkeypatch):
    monkeypatch.setattr('otf_core.solving.roughness.MAX_STEPS', 0)
    done = found.solved.joint

    def of_core(roughness):
        logs = {m: np.log(v / UNIT) for m, v in roughness.items()}
        search = Search(done.normal, done.unknowns, done.solution.accepted, LIMIT)
        return search.run(logs).log_likelihood

    for move in (('EXX', 0, 1.0), ('EXY', 1, -0.5), ('EBY', 0, -2.0), ('EYZ', 2, 6.0)):
        other = changed(found.roughness, *move)
        wanted = log_density(found.first, found.noise, other) - log_density(
            found.first, found.noise, found.roughness
        )
        assert of_core(other) - of_core(found.roughness) == pytest.approx(wanted, abs=1e-4), move


def test_roughness_is_at_the_top_of_the_likelihood(found):
    logs = {m: np.log(v / UNIT) for m, v in found.roughness.items()}
    step, score = 0.02, []
    for name in SEEN:
        alike = [logs[m] for m in SEEN if (m[1] in 'XYZ') == (name[1] in 'XYZ')]
        pull = (logs[name] - np.median(alike, axis=0)) / TOGETHER**2
        for place in range(3):
            up, down = (
                log_density(
                    found.first, found.noise, changed(found.roughness, name, place, sign * step)
                )
                for sign in (1, -1)
            )
            score.append((up - down) / (2 * step) - pull[place])
    model = ErrorModel(RUN, NODES, 1)
    information = dense.roughness_information(found.first, model, found.roughness)
    gain = 0.5 * np.array(score) @ np.linalg.solve(information, score)
    assert 0 <= gain < MIN_GAIN


def test_noise_is_near_the_top_of_the_likelihood(found):
    def loss(logs):
        white, slow, time, piece, line = np.exp(logs)
        noise = {'white': 0.5 * white, 'slow': 0.5 * slow, 'correlation_time': 0.3 * time}
        noise |= {'misfit_piece': np.sqrt(piece), 'misfit_line': np.sqrt(line)}
        away = (logs - NOISE_PRIOR) / NOISE_SPREAD
        return 0.5 * away @ away - log_density(found.last, noise, found.roughness)

    own = loss(found.solved.runs[0].fitted)
    top = minimize(loss, found.solved.runs[0].fitted, method='BFGS', options={'gtol': 0.02})
    assert top.fun <= own < top.fun + ONE_U


@pytest.fixture(scope='module')
def rows(found):
    return build_rows(*found.solved.plain, LIMIT)


def test_gap_of_a_whole_diagnosis_is_what_tables_leave(found):
    assert found.solved.choice.model == 'none'
    gap = diagnose([recording('samples.csv')], (), CONFIG).gap
    wanted = dense.residual_um(RUN, found.roughness, 'samples.csv', found.noise, found.start)
    assert gap.measured_um == pytest.approx(wanted, rel=1e-6)
    square = gap.measured_um**2 - gap.simulated_um**2
    assert gap.before_um == pytest.approx(np.sqrt(square), rel=1e-12)


def test_the_simulation_leaves_what_its_noise_lets_expect(rows):
    # the smoothness of the rows is found, that of the reference is given
    wanted, _ = dense.simulated_square(RUN, dense.given_roughness(RUN))
    assert simulated_um(rows) ** 2 == pytest.approx(wanted, rel=0.03)
