# SPDX-License-Identifier: Apache-2.0
"""Lines in the spectra of the residuals, over time and over axis position.

A line is judged against its own neighbourhood in the spectrum, the slope of the spectrum taken off
first, so coloured noise makes none. Over time the sum of the power of three directions, each over
its local level, is gamma distributed with shape 3 if there is no line; over position the power
along the axis is exponential.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from otf_core.arrays import Array
from otf_core.effects import Effect
from otf_core.effects.base import Wave
from otf_core.model.path import TRAVELS
from otf_core.solving.residuals import SampleResiduals

Peak = tuple[float, float]
"""Frequency in Hz or period in m of a line, and its score."""

LINE_SCORE = 8.0
"""Least score of a spectral line to be tried as a shape."""
NEIGHBOURHOOD = 301
"""Spectral bins that make the local level."""
NO_POWER = 1e-12
"""Share of the largest power that stands for none where logarithms are taken."""
LOWEST_FREQUENCY = 1.0
"""Hz; legs last seconds and lose their slow part."""
WOKEN = 2.0
"""s after the start of a leg in which what it wakes is looked for."""
BESIDE = 0.03
"""Relative distance of further frequencies that are tried for it."""
PERIODS = (0.0015, 0.06)
"""m; longer ones are followed by the tables, shorter ones by no tracker."""
BIN = 2.5e-4
"""m; raster of axis positions."""
NEARBY = 33
"""Wave numbers about that of the raster among which a line is placed."""


@dataclass(frozen=True)
class SpectralLine:
    """A spectral line.

    Attributes
    ----------
    effect : str
        Effect that makes such lines.
    wave : Wave
        What of it repeats.
    place : float
        Frequency in Hz or period in m.
    score : float
        Minus the logarithm of the probability that noise makes such a line anywhere.
    """

    effect: str
    wave: Wave
    place: float
    score: float


def _over_level(power: Array, place: Array) -> Array:
    """Power over its local mean level: the slope of the spectrum, then the running median.

    The slope is a parabola in logarithms: a neighbourhood is too wide for the steep end of it.
    """
    logs = np.log(np.maximum(power, max(NO_POWER * power.max(), 1e-300)))
    slope = Polynomial.fit(np.log(place), logs, 2, w=place**-0.5)
    power = power / np.exp(slope(np.log(place)))
    width = min(NEIGHBOURHOOD, max(3, len(power) // 4 * 2 + 1))
    median_to_mean = 1.0 / np.log(2.0)
    # at the ends the neighbours inside count twice; a value repeated would be its own level
    level = median_filter(power, width, mode='reflect') * median_to_mean
    return np.asarray(power / np.maximum(level, 1e-300))


def _improbability(value: float, series: int, trials: int) -> float:
    """Minus log of the probability of such a power, summed over series, in so many trials.

    A sum of n powers of noise over its level follows the Erlang distribution of shape n.
    """
    terms = sum(value**k / math.factorial(k) for k in range(series))
    return float(value - np.log(terms) - np.log(max(trials, 1)))


def line_in_time(residuals: SampleResiduals) -> Peak | None:
    """Find the strongest line over time; None for too few samples, or slower ones than 2 Hz."""
    time = residuals.state.time
    if len(time) < 100:
        return None
    step = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / step).astype(np.int64)
    series = np.zeros((int(place[-1]) + 1, 3))
    np.add.at(series, place, residuals.residual)
    length = 1 << int(np.ceil(np.log2(2 * len(series))))
    frequency = np.asarray(np.fft.rfftfreq(length, step), np.float64)
    use = (frequency >= LOWEST_FREQUENCY) & (frequency < 0.45 / step)
    if not use.any():
        return None
    power = np.abs(np.fft.rfft(series, length, axis=0)[use]) ** 2
    total = sum(_over_level(power[:, k], frequency[use]) for k in range(3))
    best = int(np.argmax(total))
    score = _improbability(float(np.asarray(total)[best]), 3, len(power))
    return float(frequency[use][best]), score


def line_since_stop(residuals: SampleResiduals) -> Peak | None:
    """Find the strongest line of what every leg does alike after its start.

    Means over the legs leave what is woken by every start; None for too few samples.
    """
    since = residuals.state.more.get('since_stop')
    time = residuals.state.time
    if since is None or len(time) < 100:
        return None
    step = float(np.median(np.diff(time)))
    near = since < WOKEN
    place = np.rint(since[near] / step).astype(np.int64)
    count = np.bincount(place)
    if len(count) * step < 0.5 * WOKEN:
        return None
    series = np.stack([
        np.bincount(place, residuals.residual[near, k]) / np.maximum(count, 1) for k in range(3)
    ], axis=1)  # fmt: skip
    series -= sum(series) / len(series)
    length = 1 << int(np.ceil(np.log2(8 * len(series))))
    frequency = np.asarray(np.fft.rfftfreq(length, step), np.float64)
    use = (frequency >= 2.0 / WOKEN) & (frequency < 0.45 / step)
    if not use.any():
        return None
    power = np.abs(np.fft.rfft(series * np.sqrt(count)[:, None], length, axis=0)[use]) ** 2
    total = sum(_over_level(power[:, k], frequency[use]) for k in range(3))
    best = int(np.argmax(total))
    score = _improbability(float(np.asarray(total)[best]), 3, len(power))
    return float(frequency[use][best]), score


def line_along_axis(residuals: SampleResiduals, axis: str) -> Peak | None:
    """Find the strongest line over the position of one axis, of displacements along it."""
    k = residuals.state.machine.axis_names.index(axis)
    across = 1.0 - residuals.state.direction[:, k] ** 2
    return _line_over_position(residuals, k, [k], across > TRAVELS)


def line_across_axis(residuals: SampleResiduals, axis: str) -> Peak | None:
    """Find the strongest line over the position of one axis, of displacements across it."""
    k = residuals.state.machine.axis_names.index(axis)
    others = [i for i in range(3) if i != k]
    return _line_over_position(residuals, k, others, np.ones(len(residuals.residual), dtype=bool))


def _line_over_position(
    residuals: SampleResiduals, axis: int, directions: list[int], use: NDArray[np.bool_]
) -> Peak | None:
    """Find the strongest line in samples in which an axis moves; None for too few of them."""
    moving = use & (np.abs(residuals.state.direction[:, axis]) > TRAVELS)
    if moving.sum() < 100:
        return None
    q = residuals.state.q[moving, axis]
    place = np.rint((q - q.min()) / BIN).astype(np.int64)
    series = [np.bincount(place, residuals.residual[moving, k]) for k in directions]
    length = 1 << int(np.ceil(np.log2(4 * len(series[0]))))
    number = np.asarray(np.fft.rfftfreq(length, BIN), np.float64)
    own = (number >= 1.0 / PERIODS[1]) & (number <= 1.0 / PERIODS[0])
    power = [np.abs(np.fft.rfft(one, length)[own]) ** 2 for one in series]
    ratio = np.sum([_over_level(one, number[own]) for one in power], axis=0)
    best = int(np.argmax(ratio))
    score = _improbability(float(ratio[best]), len(series), len(ratio))
    place_of = np.arange(len(series[0])) * BIN
    near = number[own][best] + np.linspace(-1.0, 1.0, NEARBY) * number[1]
    waves = np.exp(-2j * np.pi * near[:, None] * place_of)
    powers = sum(np.abs(waves @ one) ** 2 for one in series)
    return float(1.0 / near[int(np.argmax(powers))]), score


def _around(peak: Peak | None) -> list[Peak]:
    """A broad peak, as of what dies out, and places beside it."""
    return [] if peak is None else [(peak[0] * (1.0 + k * BESIDE), peak[1]) for k in (0, -1, 1)]


def _with_twice(peak: Peak | None) -> list[Peak | None]:
    """A line along an axis and twice its period: a second harmonic may stand out more."""
    if peak is None or 2.0 * peak[0] > PERIODS[1]:
        return [peak]
    return [peak, (2.0 * peak[0], peak[1])]


def strongest_lines(residuals: SampleResiduals, effects: Sequence[Effect]) -> list[SpectralLine]:
    """Lines that effects make, strongest first.

    Parameters
    ----------
    effects : sequence of Effect
        Those that make no lines are passed over.
    """
    in_time = [line_in_time(residuals), *_around(line_since_stop(residuals))]
    axes = residuals.state.machine.axis_names
    along_axes = [p for a in axes for p in _with_twice(line_along_axis(residuals, a))]
    lines = [
        SpectralLine(effect.name, effect.wave, *peak)
        for effect in effects
        if effect.wave is not None
        for peak in (in_time if effect.wave.in_time else along_axes)
        if peak is not None
    ]
    return sorted(lines, key=lambda line: -line.score)
