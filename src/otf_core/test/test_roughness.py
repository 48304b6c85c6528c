# SPDX-License-Identifier: Apache-2.0
"""Roughness of the motions: the likelihood is that of a Gaussian process, the search finds it.

Rows are explicit here: noise of unit variance, every row sees motions at random positions.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.solving.normal import NormalEquations
from otf_core.solving.roughness import (
    CoefficientPrior,
    Search,
    expected_precision,
    kernel,
    precision_like_others,
)
from otf_core.solving.solution import solve
from otf_core.solving.unknowns import cubic, layout, linear

LIMIT = 1e-4
BASES = {
    'X': cubic(np.array([0.0, 0.5]), 8),
    'Y': cubic(np.array([-0.1, 0.3]), 6),
    'Z': cubic(np.array([0.0, 0.2]), 5),
}
ACCEPTED = ('C0Y', 'EXX', 'EYX', 'EXY', 'EAX', 'EBY')
NOISE = 1e-6


def problem(accepted=ACCEPTED, rows=60, functions=None, bases=BASES, seed=1, blind=()):
    """Rows that see every motion at positions of its own, and their sums; noise ``NOISE``.

    Motions without a function are zero; those in ``blind`` act on no row.
    """
    rng, unknowns = np.random.default_rng(seed), layout(bases)
    design, observed = np.zeros((rows, unknowns.full)), NOISE * rng.standard_normal(rows)
    for name in accepted:
        if name in bases or name in blind:
            continue
        share = rng.standard_normal(rows)
        block = unknowns.blocks[name]
        if name == 'C0Y':
            design[:, block.start] = share
            continue
        basis = bases[name[2]]
        q = rng.uniform(basis.knots[0], basis.knots[-1], rows)
        design[:, block] = share[:, None] * basis.matrix(q)
        if functions and name in functions:
            observed += share * functions[name](q)
    A = (design @ unknowns.gauge) / NOISE
    y = observed / NOISE
    normal = NormalEquations(A.T @ A, A.T @ y, float(y @ y), rows)
    return SimpleNamespace(
        A=A, y=y, normal=normal, unknowns=unknowns, accepted=accepted,
        search=Search(normal, unknowns, accepted, LIMIT),
    )  # fmt: skip


@pytest.fixture(scope='module')
def some():
    return problem(functions={m: lambda q: 2e-5 * np.sin(12 * q) for m in ACCEPTED[1:]})


def test_kernel_is_waves_and_an_integrated_wiener_process_with_its_derivatives():
    basis, logs = BASES['X'], np.array([-2.0, -1.0, -3.0])
    found, slopes = kernel(basis, logs)
    x = basis.centres / 0.5
    for i, j in ((0, 0), (3, 7), (10, 4), (10, 10)):
        a, b = x[i], x[j]
        walk = quad(lambda u, a=a, b=b: (a - u) * (b - u), 0.0, min(a, b))[0]
        waves = np.exp(-0.5 * ((x[i] - x[j]) / np.exp(-1.0)) ** 2)
        assert found[i, j] == pytest.approx(np.exp(-2.0) * waves + np.exp(-3.0) * walk, rel=1e-9)
    for k, slope in enumerate(slopes):
        step = 1e-5 * np.eye(3)[k]
        near = (kernel(basis, logs + step)[0] - kernel(basis, logs - step)[0]) / 2e-5
        np.testing.assert_allclose(slope, near, atol=1e-9)


@pytest.mark.parametrize('motion', ['EYX', 'EXX', 'ECY'])
def test_prior_of_the_coefficients_is_that_of_the_motion_in_its_gauge(motion):
    """Draws of the process, put into the gauge by hand, have the stated covariance."""
    basis, rng = BASES[motion[2]], np.random.default_rng(4)
    logs = np.array([-1.0, np.log(0.3), -2.0])
    x = (basis.centres - basis.knots[0]) / np.ptp(basis.knots)
    root = np.linalg.cholesky(kernel(basis, logs)[0] + 1e-12 * np.eye(basis.size))
    draws = root @ rng.standard_normal((basis.size, 40_000))
    if motion == 'EYX':
        draws = draws - np.outer(1 - x, draws[0]) - np.outer(x, draws[-1])
        coefficients = (basis.from_values @ draws)[1:-1]
    else:
        draws = draws + 10.0 * np.outer(x, rng.standard_normal(draws.shape[1]))
        zero = 0.0 if motion == 'ECY' else basis.knots[0]
        whole = basis.from_values @ draws
        whole = whole - basis.matrix(np.array([zero]))[0] @ whole
        dropped = int(np.argmax(basis.matrix(np.array([zero]))[0]))
        coefficients = np.delete(whole, dropped, axis=0)
    stated = CoefficientPrior(ErrorMotion.of(motion), basis).at(logs)[0]
    size = np.sqrt(np.diag(stated))
    # 40 000 draws: correlations within 0.005, k = 1
    off = (coefficients @ coefficients.T / draws.shape[1] - stated) / np.outer(size, size)
    assert np.abs(off).max() < 0.03
    np.testing.assert_allclose(np.mean(coefficients**2, axis=1) / size**2, 1.0, atol=0.03)


def test_a_motion_without_data_is_as_rough_as_its_like():
    """Second differences of the motion at its nodes have the size that the others' logs say."""
    motion, basis = ErrorMotion.of('ECY'), linear(np.linspace(0.0, 0.6, 21))
    logs = {'EXX': np.array([8.0, 0.0, 8.0])}
    logs |= {
        m: np.array([-9.0, np.log(0.2), low])
        for m, low in zip(['EAX', 'EBX', 'ECX'], (-9, -7, -2), strict=True)
    }
    spread = np.linalg.inv(precision_like_others(motion, basis, logs))
    bend = np.diff(np.eye(20), 2, axis=0)[:15]
    h, waves = 0.05, np.exp(-0.5 * (np.array([0.05, 0.1]) / 0.2) ** 2)
    smooth = np.exp(-9.0) * 2.0 * (3.0 - 4.0 * waves[0] + waves[1])
    kinks = np.exp(-7.0) * quad(lambda x: (h - abs(x)) ** 2, -h, h, points=[0.0])[0]
    wanted = smooth + kinks
    np.testing.assert_allclose(np.diag(bend @ spread @ bend.T), wanted, rtol=1e-3)


def covariance(some, logs):
    """Covariance of the solved-for unknowns before any data, written as one dense matrix."""
    search = some.search
    found = np.diag(np.full(len(search.use), 1e4 * LIMIT**2))
    for motion, place in search.places.items():
        found[place, place] = search.priors[motion].at(logs[motion])[0] * LIMIT**2
    return found


def test_solution_is_the_posterior_of_the_gaussian_process(some):
    search = some.search
    A, rough_now = some.A[:, search.use], search.run()
    prior = covariance(some, rough_now.logs)
    whole = np.eye(len(A)) + A @ prior @ A.T
    mean = prior @ A.T @ np.linalg.solve(whole, some.y)
    cover = prior - prior @ A.T @ np.linalg.solve(whole, A @ prior)
    found = solve(some.normal, some.unknowns, LIMIT, some.accepted, rough_now.precision)
    free = found.value[some.unknowns.kept]
    own = found.covariance[np.ix_(some.unknowns.kept, some.unknowns.kept)]
    place = np.ix_(search.use, search.use)
    np.testing.assert_allclose(free[search.use], mean, atol=1e-6 * np.abs(mean).max())
    np.testing.assert_allclose(own[place], cover, atol=1e-6 * np.abs(cover).max())
    assert np.all(np.delete(free, search.use) == 0.0)
    # the dense way loses digits: 1.3e-8 with SciPy 1.11
    np.testing.assert_allclose(
        rough_now.square, some.y @ np.linalg.solve(whole, some.y), rtol=1e-7
    )


FINE = {axis: cubic(basis.knots, 20) for axis, basis in BASES.items()}
SEEN = ('EXX', 'EYX', 'EZX', 'EXY', 'EYY')


def drawn(rng, size, length, basis):
    """A smooth draw: waves of a size and a length in shares of the range."""
    low, span = basis.knots[0], np.ptp(basis.knots)
    x = np.linspace(0.0, 1.0, 201)
    own = np.exp(-0.5 * ((x[:, None] - x) / length) ** 2) + 1e-9 * np.eye(201)
    value = size * (np.linalg.cholesky(own) @ rng.standard_normal(201))
    return lambda q: np.interp((q - low) / span, x, value)


@pytest.mark.parametrize('length', [0.08, 0.3])
def test_size_and_length_of_drawn_waves_are_found(length):
    rng = np.random.default_rng(11)
    functions = {m: drawn(rng, 2e-5, length, FINE[m[2]]) for m in SEEN}
    found = problem(SEEN, 800, functions, FINE).search.run()
    logs = np.array(list(found.logs.values()))
    # a motion holds 1 / length waves, five motions at least 15: 20 % each, and l with s
    assert np.exp(np.median(logs[:, 1])) == pytest.approx(length, rel=0.35)
    assert 1e-5 < LIMIT * np.exp(0.5 * np.median(logs[:, 0])) < 4e-5


def test_motions_that_no_row_sees_are_as_rough_as_the_others():
    rng = np.random.default_rng(12)
    functions = {m: drawn(rng, 2e-5, 0.2, FINE[m[2]]) for m in SEEN}
    found = problem((*SEEN, 'EZY', 'EAX'), 800, functions, FINE, blind=('EZY', 'EAX')).search.run()
    others = np.median([found.logs[m] for m in SEEN], axis=0)
    np.testing.assert_allclose(found.logs['EZY'], others, atol=0.3)
    # the only one of its unit stays where it started
    np.testing.assert_allclose(found.logs['EAX'], np.log([0.1, 0.15, 0.01]), atol=1e-6)


def test_expected_precision_is_of_motions_of_the_size_asked_for():
    # a vector of three sums of four motions of one size: its mean length
    unknowns, size = layout(FINE), 2e-6
    precision = expected_precision(unknowns, LIMIT, size * np.sqrt(12.0))
    for motion in ('EYX', 'EZY'):
        place = unknowns.free_blocks[motion]
        spread = np.sqrt(np.diag(np.linalg.inv(precision[place, place])))
        assert unit_of(motion) == 'm'
        # less the line through both ends: up to 1.3 of the size amid the range
        assert 0.8 * size < np.median(spread) < 1.4 * size
    poses = precision[unknowns.free_blocks['pose 0'], unknowns.free_blocks['pose 0']]
    np.testing.assert_allclose(poses, 1e-4 / LIMIT**2 * np.eye(6))
    assert np.linalg.eigvalsh(precision).min() > 0
