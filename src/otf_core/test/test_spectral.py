# SPDX-License-Identifier: Apache-2.0
"""Spectral lines: as rare in noise of any colour as their score says, and found where they are."""

from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine
from scipy.signal import lfilter
from scipy.stats import binom, gamma

from otf_core.diagnosis.engine.spectral import (
    LINE_SCORE,
    _improbability,
    line_across_axis,
    line_along_axis,
    line_in_time,
    line_since_stop,
    strongest_lines,
)
from otf_core.effects import REGISTRY
from otf_core.solving.residuals import detrend_legs

EFFECTS = list(REGISTRY.values())
RATE, LENGTH, LEG, STOP = 200.0, 0.3, 400, 40
DRAWS = 40


def coloured(rng, count, tau, white):
    """Noise (count, 3) of unit variance, a share of it white, the rest correlated over tau, s."""
    slow = rng.standard_normal((count, 3))
    if tau:
        memory = np.exp(-1.0 / RATE / tau)
        slow = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], slow, axis=0)
    return np.sqrt(1 - white) * slow + np.sqrt(white) * rng.standard_normal((count, 3))


def driven(rng, legs=24, *, oblique=False, tau=0.0, white=0.0, wave=None):
    """Residuals of samples on legs of 0.3 m and 2 s with stops between them, back and forth.

    Samples are 0.75 mm apart: a wave of that period would be seen as one of no period at all.
    Along the axes in turn, or along space diagonals. ``wave(time, q)`` is displacement (n, 3)
    in units of the noise.
    """
    count = legs * (LEG + STOP)
    leg, within = np.divmod(np.arange(count), LEG + STOP)
    # the tracker's clock knows nothing of the legs
    share = np.clip((within + rng.uniform(0, 1, legs)[leg]) / LEG, 0.0, 1.0)
    place = LENGTH * np.where(leg // 3 % 2 == 0, share, 1.0 - share)
    q = np.full((count, 3), 0.1)
    direction = np.eye(3)[leg % 3]
    q[np.arange(count), leg % 3] = place
    if oblique:
        q = place[:, None] * np.ones(3)
        direction = np.full((count, 3), 1 / np.sqrt(3))
    time = np.arange(count) / RATE
    values = coloured(rng, count, tau, white)
    if wave is not None:
        values = values + wave(time, q)
    values -= direction * np.sum(direction * values, axis=1)[:, None]
    use = within < LEG
    state = SimpleNamespace(
        time=time[use], q=q[use], direction=direction[use], machine=some_machine()
    )
    state.more = {'since_stop': (within / RATE)[use]}
    return SimpleNamespace(leg=leg[use], state=state, residual=detrend_legs(values[use], leg[use]))


COLOURS = [(0.0, 0.0), (0.05, 0.0), (0.3, 0.5), (2.0, 0.5), (0.3, 0.0)]
"""Correlation time in s and white share: white, fast, as of trackers, slow, not white at all."""


@pytest.mark.parametrize(('tau', 'white'), COLOURS)
@pytest.mark.parametrize('kind', ['vibration', 'ringing', 'cyclic_error'])
def test_noise_of_any_colour_makes_a_line_no_more_often_than_the_score_says(kind, tau, white):
    """A score of -log(a) comes up in a share a of all runs at most; band of 99.9 % of a draw."""
    rng = np.random.default_rng([5, int(100 * tau)])
    scores = []
    for _ in range(DRAWS):
        if kind == 'vibration':
            _, score = line_in_time(driven(rng, legs=10, tau=tau, white=white))
        elif kind == 'ringing':
            _, score = line_since_stop(driven(rng, legs=10, tau=tau, white=white))
        else:
            run = driven(rng, legs=12, oblique=True, tau=tau, white=white)
            _, score = line_along_axis(run, 'X')
        scores.append(score)
    for share in (0.2, 0.05):
        seen = np.sum(np.array(scores) > -np.log(share))
        assert seen <= binom.ppf(0.999, DRAWS, share)
    assert np.sum(np.array(scores) > 8.0) <= 1  # tried as a shape from there on: 1 in 3000


@pytest.mark.parametrize('frequency', [1.3, 7.3, 23.0, 44.0])
def test_vibration_is_found_at_its_frequency(frequency):
    """As large as the noise of a single sample."""

    def wave(time, q):
        return np.outer(np.sin(2 * np.pi * frequency * time + 0.4), [0.8, 0.0, 0.6])

    for tau, white in COLOURS[::2]:
        rng = np.random.default_rng(6)
        found = driven(rng, tau=tau, white=white, wave=wave)
        line = strongest_lines(found, EFFECTS)[0]
        assert line.effect == 'vibration'
        assert line.score > 30.0
        # lines of a run of 53 s are 0.019 Hz wide
        assert line.place == pytest.approx(frequency, abs=0.01)


@pytest.mark.parametrize('frequency', [8.3, 11.0, 19.0])
def test_ringing_after_every_start_is_found_at_its_frequency(frequency):
    """Larger than the noise of a single sample at first, gone after a second."""

    def wave(time, q):
        since = time % ((LEG + STOP) / RATE)
        swing = np.exp(-since / 0.4) * np.sin(2 * np.pi * frequency * since + 0.7)
        return 1.5 * np.outer(swing, [0.0, 0.6, 0.8])

    found = driven(np.random.default_rng(16), oblique=True, tau=0.3, white=0.5, wave=wave)
    place, score = line_since_stop(found)
    assert score > 8.0
    assert place == pytest.approx(frequency, rel=0.03)
    asked = [x.place for x in strongest_lines(found, EFFECTS) if x.effect == 'vibration']
    assert place in asked and len(asked) == 4


@pytest.mark.parametrize(('axis', 'period'), [('X', 0.02), ('Y', 0.005), ('Z', 0.03)])
def test_cyclic_error_is_found_on_its_axis_at_its_period(axis, period):
    """Half as large as the noise; the axes move one after the other and together."""
    k = 'XYZ'.index(axis)

    def wave(time, q):
        return 0.5 * np.sin(2 * np.pi * q[:, k, None] / period + 1.0) * np.eye(3)[k]

    for tau, white in COLOURS[::2]:
        rng = np.random.default_rng(7)
        found = driven(rng, oblique=True, tau=tau, white=white, wave=wave)
        place, score = line_along_axis(found, axis)
        assert score > 20.0
        # lines over 0.3 m are period^2 / 0.3 m wide
        assert place == pytest.approx(period, abs=0.15 * period**2 / LENGTH)


@pytest.mark.parametrize(('axis', 'period'), [('X', 0.02), ('Z', 0.0073)])
def test_what_repeats_along_an_axis_and_displaces_across_it_is_found(axis, period):
    k = 'XYZ'.index(axis)

    def wave(time, q):
        return 0.5 * np.sin(2 * np.pi * q[:, k, None] / period) * np.eye(3)[k - 1]

    for tau, white in COLOURS[::2]:
        found = driven(np.random.default_rng(13), oblique=True, tau=tau, white=white, wave=wave)
        place, score = line_across_axis(found, axis)
        assert score > 20.0
        assert place == pytest.approx(period, abs=0.05 * period**2 / LENGTH)
    quiet = line_across_axis(driven(np.random.default_rng(14), oblique=True), axis)
    assert quiet[1] < LINE_SCORE


def test_strongest_line_comes_first():
    lines = strongest_lines(driven(np.random.default_rng(8), oblique=True), EFFECTS)
    assert sorted({x.effect for x in lines}) == ['cyclic_error', 'vibration']
    assert sum(x.effect == 'vibration' for x in lines) == 4
    periods = [x.place for x in lines if x.effect == 'cyclic_error']
    single = periods[::2] if len(periods) == 6 else periods
    assert len(single) == 3 and sorted(periods) == sorted([*single, *(2.0 * p for p in single)])
    scores = [x.score for x in lines]
    assert scores == sorted(scores, reverse=True)


def test_an_axis_that_stands_or_moves_alone_shows_no_error_along_it():
    found = driven(np.random.default_rng(9))  # across the path nothing of X is seen while X moves
    assert line_along_axis(found, 'X') is None
    still = SimpleNamespace(**vars(found.state))
    still.direction = np.tile([0.0, 0.6, 0.8], (len(still.time), 1))
    assert line_along_axis(SimpleNamespace(state=still, residual=found.residual), 'X') is None


def test_few_samples_show_no_line():
    found = driven(np.random.default_rng(10))
    short = {n: getattr(found.state, n)[:99] for n in ('time', 'q', 'direction')}
    few = SimpleNamespace(
        state=SimpleNamespace(**short, machine=some_machine(), more={}),
        residual=found.residual[:99],
    )
    assert strongest_lines(few, EFFECTS) == []


def test_slow_samples_show_no_vibration():
    """At 2 Hz nothing can be said from 1 Hz on."""
    found = driven(np.random.default_rng(11))
    slow = SimpleNamespace(**vars(found.state))
    slow.time = 0.5 * np.arange(len(slow.time))
    assert line_in_time(SimpleNamespace(state=slow, residual=found.residual)) is None


def test_a_direction_in_which_nothing_is_left_adds_nothing():
    """As X where all lines run along X: a wave in Y and Z is found all the same."""

    def wave(time, q):
        return np.outer(np.sin(2 * np.pi * 7.3 * time), [0.0, 0.8, 0.6])

    found = driven(np.random.default_rng(12), wave=wave)
    found.residual[:, 0] = 0.0
    place, score = line_in_time(found)
    assert score > 30.0
    assert place == pytest.approx(7.3, abs=0.01)


@pytest.mark.parametrize(
    ('value', 'series', 'trials'), [(0.3, 3, 1), (40.0, 3, 5000), (9.0, 1, 7)]
)
def test_score_is_how_improbable_gamma_distributed_power_is(value, series, trials):
    expected = -gamma.logsf(value, series) - np.log(trials)
    assert _improbability(value, series, trials) == pytest.approx(expected, rel=1e-9)
    assert np.isfinite(_improbability(1e6, series, trials)), 'stronger lines stay in order'
