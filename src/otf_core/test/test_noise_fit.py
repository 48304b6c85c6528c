# SPDX-License-Identifier: Apache-2.0
"""Sizes of noise and misfit from residuals: slopes of a density written out, sizes found again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import (
    corner_path,
    leg_parts,
    observed,
    pieces_of,
    some_machine,
    transform_pose,
    zero_tables,
)

from otf_core.model.path import leg_bounds
from otf_core.noise.noise_model import (
    INDEPENDENT,
    LASTING,
    SLOW,
    TIME,
    WHITE,
    Misfit,
    NoiseComponent,
    NoiseModel,
    covariance_parts,
    misfit_of,
    scale_noise,
)
from otf_core.solving.system import build_system
from otf_core.solving.unknowns import cubic, layout
from otf_core.solving.variance_components import (
    PRIOR_SIGMAS,
    _lines,
    _slopes,
    fit_noise,
)

RANGE = NoiseComponent(1e-6, 1e-6 * np.sqrt(0.5), 0.3)
ANGLE = NoiseComponent(2e-6, 2e-6 * np.sqrt(0.4), 0.3)
NOISE = NoiseModel(RANGE, ANGLE, ANGLE)
START = np.array([0.0, 0.0, 0.0, 2 * np.log(5e-8), 2 * np.log(5e-8)])
ZIGZAG = [(0, 0, 0), (1, 1, 0.2), (0.1, 0.9, 1), (0.9, 0, 1), (0, 0.5, 0.5)]


def rows_of(corners, size):
    """Pieces of 0.1 s along a path and their rows."""
    machine = some_machine()
    pose = transform_pose(machine, 1)
    pieces = pieces_of(machine, corner_path(machine, *corners), zero_tables(machine), pose, size)
    count = len(pieces)
    time = 0.1 * np.arange(count) + 0.5 * pieces.leg
    pieces = replace(pieces, time=time, duration=np.full(count, 0.1))
    ends = zip('XYZ', machine.lower, machine.upper, strict=True)
    unknowns = layout({a: cubic(np.array([low, high]), 3) for a, low, high in ends})
    system = build_system(observed(machine, pieces, pose), unknowns)
    return SimpleNamespace(machine=machine, pieces=pieces, system=system, unknowns=unknowns)


def dense(rows, logs, noise=NOISE):
    """Covariance of all rows, first components first."""
    count = len(rows.pieces)
    total = np.zeros((2 * count, 2 * count))
    for low, high in leg_bounds(rows.pieces.leg):
        for c in range(2):
            part = slice(c * count + low, c * count + high)
            parts = (rows.system, rows.pieces, scale_noise(noise, logs), misfit_of(logs))
            total[part, part] = sum(leg_parts(*parts, c, low, high))
    return total


@pytest.fixture(scope='module')
def short():
    return rows_of(ZIGZAG, 0.02)


@pytest.fixture(scope='module')
def long():
    corners = np.random.default_rng(3).uniform(0, 1, (46, 3))
    return rows_of(corners, 0.012)


def drawn(rows, logs, seed):
    """Rows of noise and misfit alone, (2, p)."""
    rng, found = np.random.default_rng(seed), np.zeros((2, len(rows.pieces)))
    for low, high in leg_bounds(rows.pieces.leg):
        for c in range(2):
            parts = (rows.system, rows.pieces, scale_noise(NOISE, logs), misfit_of(logs))
            root = np.linalg.cholesky(sum(leg_parts(*parts, c, low, high)))
            found[c, low:high] = root @ rng.standard_normal(high - low)
    return found


TRUTH = START + np.array([0.6, -0.5, 0.7, 2 * np.log(8.0), 2 * np.log(12.0)])
"""White noise up, slow noise down and slower, misfit of 0.4 um and 0.6 um."""


def test_sizes_are_found_again_within_their_uncertainty(long):
    nothing = np.zeros((long.unknowns.full,) * 2)
    ratios = []
    for seed in range(4):
        residual = drawn(long, TRUTH, seed)
        found = fit_noise(long.system, long.pieces, residual, NOISE, nothing).logs
        lines = _lines(long.system, long.pieces, residual, nothing)
        data = _slopes(NOISE, found, lines)[1]
        u = np.sqrt(np.diag(np.linalg.inv(data + np.diag(1 / PRIOR_SIGMAS**2))))
        ratios.append((found - TRUTH) / u)
        assert np.abs(found - TRUTH)[[WHITE, INDEPENDENT, LASTING]].max() < 1.5
    # 20 ratios of five correlated sizes each time, of a standard deviation of 1
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6
    assert np.abs(ratios).max() < 3.5


def test_estimates_that_took_up_noise_are_allowed_for():
    """Residuals of a fit are smaller than the noise; A V A' tells by how much."""
    rows = rows_of(ZIGZAG, 0.008)
    gauge = rows.unknowns.gauge.toarray()
    A = rows.system.design.toarray() @ gauge
    loud = START + np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    weight = np.linalg.inv(dense(rows, loud))
    own = np.linalg.inv(A.T @ weight @ A + np.eye(A.shape[1]) / 1e-4**2)
    found = {True: [], False: []}
    for seed in range(5):
        y = drawn(rows, loud, 20 + seed).ravel()
        residual = (y - A @ (own @ (A.T @ weight @ y))).reshape(2, -1)
        for told in found:
            cover = gauge @ own @ gauge.T if told else 0.0 * gauge @ gauge.T
            logs = fit_noise(rows.system, rows.pieces, residual, NOISE, cover, loud).logs
            found[told].append(np.log(np.trace(dense(rows, logs))))
    lost = np.log(np.trace(dense(rows, loud))) - np.mean(found[True])
    # slow noise and pose look alike here: one draw is good to 0.5, five to 0.2; 2 of it
    assert abs(lost) < 0.4
    assert np.mean(found[True]) - np.mean(found[False]) > 0.3


def test_the_prior_holds_what_residuals_do_not_show(short):
    white = NoiseModel(*(replace(c, white=c.level) for c in NOISE))
    nothing = np.zeros((short.unknowns.full,) * 2)
    residual = 3e-6 * np.random.default_rng(3).standard_normal((2, len(short.pieces)))
    found = fit_noise(short.system, short.pieces, residual, white, nothing).logs
    assert found[SLOW] == 0.0
    assert found[TIME] == pytest.approx(0.0, abs=1e-12)
    few = rows_of(ZIGZAG[:2], 0.2)
    zero = np.zeros((few.unknowns.full,) * 2)
    alone = fit_noise(few.system, few.pieces, drawn(few, START, 4), NOISE, zero).logs
    assert np.abs(alone - START)[[WHITE, SLOW, TIME]].max() < 0.7


def test_factors_act_on_white_and_slow_variance_each_for_itself():
    found = scale_noise(NOISE, np.array([np.log(3.0), np.log(0.5), np.log(0.8), 0.0, 0.0]))
    for part, old, before in zip(found, (1e-6, 2e-6, 2e-6), (0.5, 0.4, 0.4), strict=True):
        assert part.correlation_time == pytest.approx(0.8 * 0.3)
        assert part.white**2 == pytest.approx(3.0 * old**2 * before)
        assert part.slow**2 == pytest.approx(0.5 * old**2 * (1 - before))


def test_parts_of_the_covariance_are_averages_of_the_processes_over_the_pieces():
    """Against sums over samples: white, Gauss-Markov of the tracker, and of 3 s."""
    time, duration, count = np.array([0.1, 0.35]), np.array([0.2, 0.3]), np.array([200, 300])
    shares = np.array([[0.6, 0.5], [0.8, 0.9], [-0.3, 0.2]])
    t = [c + d * ((np.arange(n) + 0.5) / n - 0.5)
         for c, d, n in zip(time, duration, count, strict=True)]  # fmt: skip

    def mean(tau):
        return np.array([[np.exp(-np.abs(a[:, None] - b) / tau).mean() for b in t] for a in t])

    vertical = NoiseComponent(3e-6, 3e-6 * np.sqrt(0.1), 0.8)
    noise = NoiseModel(RANGE, ANGLE, vertical)
    found = covariance_parts(noise, Misfit(1e-7, 3e-7), shares, (time, duration, count))
    own = np.array([[1e-6], [2e-6], [3e-6]]) * shares
    white = (0.5 * own[0] ** 2 + 0.4 * own[1] ** 2 + 0.1 * own[2] ** 2) / count
    fast = 0.5 * np.outer(own[0], own[0]) + 0.6 * np.outer(own[1], own[1])
    slow = fast * mean(0.3) + 0.9 * np.outer(own[2], own[2]) * mean(0.8)
    np.testing.assert_allclose(found[0], white)
    np.testing.assert_allclose(found[1], slow, rtol=1e-4)
    np.testing.assert_allclose(found[2], 1e-14)
    np.testing.assert_allclose(found[3], 9e-14 * mean(3.0), rtol=1e-4)
