# SPDX-License-Identifier: Apache-2.0
"""Sizes of a gap: quadratic difference, share that is gone, its interval, held-out legs."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import (
    cause_of,
    coloured,
    dense_base,
    holding,
    noise,
    rms_um,
    solved_rows,
    trace_of,
)
from scipy.stats import binom

from otf_core.diagnosis.engine.gap_sizes import (
    SIMULATED_U,
    Residuals,
    gap_um,
    plain_residuals,
    residuals_with,
    shrink_interval,
    shrink_percent,
)
from otf_core.effects import REGISTRY
from otf_core.solving.residuals import FOLDS

BACKLASH, COUPLING = REGISTRY['backlash'], REGISTRY['cross_coupling']

# ---------------------------------------------------------------- sizes


@pytest.mark.parametrize(
    ('measured', 'simulated', 'expected'),
    [(5.0, 3.0, 4.0), (2.0, 0.0, 2.0), (3.0, 3.0, 0.0), (2.9, 3.0, 0.0), (0.0, 0.0, 0.0)],
)
def test_gap_is_what_adds_to_the_simulation_in_squares(measured, simulated, expected):
    assert gap_um(measured, simulated) == pytest.approx(expected)


@pytest.mark.parametrize(
    ('before', 'after', 'expected'),
    [(4.0, 1.0, 75.0), (4.0, 4.0, 0.0), (4.0, 5.0, 0.0), (4.0, 0.0, 100.0), (0.0, 0.0, 0.0),
     (0.0, 3.0, 0.0)],
)  # fmt: skip
def test_shrink_is_the_share_that_is_gone_and_never_less_than_none(before, after, expected):
    assert shrink_percent(before, after) == pytest.approx(expected)


def test_residual_of_a_piece_is_the_distance_from_the_path_for_the_noise_alone():
    """Whatever weights the solution of the calibration has."""
    rows = planted()
    rows = replace(rows, done=replace(rows.done, solution=replace(rows.done.solution, value=None)))
    found = plain_residuals(rows)
    assert found.rms_um == pytest.approx(rms_um(found.rows))
    squares = [np.sum(p**2, axis=0) for p in rows.by_run(coloured(rows, rows.residual))]
    np.testing.assert_allclose(found.square, np.concatenate(squares), rtol=1e-6)


def test_legs_are_numbered_through_all_runs():
    rows = solved_rows()
    found = plain_residuals(rows).leg
    first, second = (len(np.unique(r.pieces.leg)) for r in rows.runs)
    assert np.array_equal(np.unique(found), np.arange(first + second))
    count = len(rows.runs[0].pieces)
    assert found[:count].max() == first - 1
    changes = np.flatnonzero(np.diff(rows.runs[1].pieces.leg))
    np.testing.assert_array_equal(np.flatnonzero(np.diff(found[count:])), changes)


# ---------------------------------------------------------------- interval


def drawn(rng, gap, left, simulated, legs=80, pieces=20, spread=0.4):
    """Residuals before and after: noise, and waves whose strength differs from leg to leg.

    The mean square of the strength is one, so the gaps are known: ``gap`` and ``left``, m.
    """
    strength = np.exp(spread * rng.standard_normal(legs) - spread**2)
    leg, place = np.repeat(np.arange(legs), pieces), 0.3 * np.arange(legs * pieces)
    noise_alone = simulated / np.sqrt(2) * rng.standard_normal((2, len(leg)))
    found = []
    for size, phase in ((gap, 0.0), (left, 1.0)):
        values = noise_alone.copy()
        values[0] += np.sqrt(2) * size * strength[leg] * np.sin(place + phase)
        found.append(Residuals(np.sum(values**2, axis=0), leg, values.reshape(-1)))
    return found


@pytest.mark.parametrize(
    ('gap', 'left', 'spread'),
    [(5e-6, 2e-6, 0.4), (1e-6, 0.4e-6, 0.4), (2e-6, 0.8e-6, 0.0), (1e-6, 0.0, 0.3)],
    ids=['large gap', 'gap like the noise', 'all legs alike', 'nothing left'],
)
def test_interval_holds_the_true_shrink_in_95_of_100_draws(gap, left, spread):
    """The simulated residual is known to 4 % only; 400 draws, band of 99 % of a binomial."""
    rng, draws = np.random.default_rng(77), 400
    true, simulated = 100.0 * (1.0 - left / gap), 1e-6
    held = 0
    for _ in range(draws):
        before, after = drawn(rng, gap, left, simulated, spread=spread)
        known_um = 1e6 * simulated * (1.0 + 0.04 * rng.standard_normal())
        low, high = shrink_interval(before, after, known_um, SIMULATED_U * known_um)
        held += low <= true <= high
    least, most = binom.interval(0.99, draws, 0.95)
    assert least <= held <= most


def test_interval_is_the_jackknife_worked_by_hand():
    """Three legs with mean squares 4, 9, 16 um^2 before and 1 um^2 after; no noise at all."""
    leg = np.repeat([0, 1, 2], 5)
    before = Residuals(1e-12 * np.repeat([4.0, 9.0, 16.0], 5), leg, np.zeros(0))
    after = Residuals(1e-12 * np.ones(15), leg, np.zeros(0))
    whole = 100 * (1 - 1 / np.sqrt(29 / 3))
    left = [100 * (1 - 1 / np.sqrt(mean)) for mean in (12.5, 10.0, 6.5)]
    u = np.sqrt(2 / 3 * np.sum((left - np.mean(left)) ** 2))
    found = shrink_interval(before, after, 0.0, 0.0)
    np.testing.assert_allclose(found, (whole - 2 * u, whole + 2 * u), rtol=1e-9)


def test_interval_of_legs_alike_is_that_of_the_simulated_residual():
    """No scatter; 8 % more or less simulated noise. Before 5, after 3.2, simulated 3 um."""
    leg = np.repeat(np.arange(40), 5)
    before, after = (Residuals(np.full(200, s * 1e-12), leg, np.zeros(0)) for s in (25.0, 10.24))

    def shrink(simulated):
        return 100 * (1 - np.sqrt(max(0.0, 10.24 - simulated**2)) / np.sqrt(25 - simulated**2))

    found = shrink_interval(before, after, 3.0, 3.0 * SIMULATED_U)
    np.testing.assert_allclose(found, (shrink(3.0 * 0.92), shrink(3.0 * 1.08)), rtol=1e-9)
    assert found[1] == 100.0  # 3.24 um simulated: nothing is left


def test_interval_of_a_single_leg_says_nothing():
    one = Residuals(np.ones(9), np.zeros(9, dtype=np.int64), np.zeros(0))
    assert shrink_interval(one, replace(one, square=0.1 * one.square), 0.0, 0.0) == (0.0, 100.0)


def test_interval_without_a_gap_is_empty_at_zero():
    same = Residuals(1e-12 * np.ones(40), np.repeat(np.arange(20), 2), np.zeros(0))
    assert shrink_interval(same, same, 2.0, 2.0 * SIMULATED_U) == (0.0, 0.0)


# ---------------------------------------------------------------- legs that were not fitted on


def planted(seed=1):
    """Rows with backlash and noise."""
    own = trace_of(cause_of(BACKLASH), B_X=4e-6, B_Y=-3e-6)
    return holding(own + noise(seed))


@pytest.mark.parametrize('held_out', [True, False])
def test_residuals_are_those_of_dense_fits_without_the_fold(held_out):
    rows, cause = planted(), cause_of(BACKLASH)
    found = residuals_with(rows, [cause], held_out=held_out).rows
    whole = rows.project(rows.whiten(cause.option.plain))
    for fold in range(FOLDS):
        judged = rows.fold == fold
        fitted = ~judged if held_out else np.ones_like(judged)
        value = np.linalg.lstsq(whole[fitted], rows.residual[fitted], rcond=None)[0]
        left = rows.left(rows.plain_deviation - cause.option.plain @ value)
        np.testing.assert_allclose(found[judged], left[judged], atol=1e-13)


@pytest.mark.parametrize('fold', [0, 3])
def test_legs_of_a_fold_have_no_say_in_the_coefficients_they_are_judged_with(fold):
    """A change of them that tables and poses cannot follow comes through undiminished."""
    rows, cause = planted(), cause_of(BACKLASH)
    own = rows.fold == fold
    white = np.zeros(len(own))
    wild = cause.option.own[own] @ np.full(3, 2e-4)  # as if they had backlash of 200 um more
    base = dense_base(rows)[own]
    white[own] = wild - base @ np.linalg.lstsq(base, wild, rcond=None)[0]
    extra = coloured(rows, white)
    changed = holding(rows.plain_deviation + extra)
    before, after = (residuals_with(r, [cause]).rows for r in (rows, changed))
    came = rows.left(extra)
    assert rms_um(came[own]) > 10.0
    np.testing.assert_allclose((after - before)[own], came[own], atol=1e-11)
    # all others are judged with coefficients that these legs have moved
    assert rms_um((after - before - came)[~own]) > 0.5
    inside = [residuals_with(r, [cause], held_out=False).rows for r in (rows, changed)]
    assert rms_um((inside[1] - inside[0] - came)[own]) > 0.5


def test_an_effect_that_is_not_there_makes_held_out_legs_no_better():
    """30 coefficients of nothing: each fits one unit of noise, and costs one where it is judged.

    In units of the variance of a row, the sum of squares falls by 30 on the legs fitted on and
    rises by some 34 (8/7 of 30) on the others; a draw scatters by 8, the mean of four by 4.
    """
    cause, inside, outside = cause_of(COUPLING), [], []
    for seed in range(4):
        rows = holding(noise(100 + seed))
        whole = rows.whiten(plain_residuals(rows).rows[:, None])
        for held_out, found in ((False, inside), (True, outside)):
            left = residuals_with(rows, [cause], held_out=held_out).rows
            found.append(np.sum(rows.whiten(left[:, None]) ** 2) - np.sum(whole**2))
    assert np.mean(inside) == pytest.approx(-30.0, abs=12.0)
    assert np.mean(outside) == pytest.approx(34.0, abs=12.0)


def test_no_cause_leaves_what_the_calibration_left():
    rows = planted()
    np.testing.assert_array_equal(residuals_with(rows, []).rows, plain_residuals(rows).rows)
