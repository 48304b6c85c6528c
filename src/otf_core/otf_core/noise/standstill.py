# SPDX-License-Identifier: Apache-2.0
"""Standstills of a recording: which of their blocks are at rest, and the noise seen in them.

A target that has stopped goes on moving for a while: axes settle, a structure rings, the next move
begins. This is no noise of the tracker. Each standstill is judged in blocks of a tenth of a second
against the quiet blocks of the whole recording, so that no level of noise has to be known before.
Steps and drift of a resting target and lost samples are reported separately. Heavy tails are
described by the degrees of freedom of a Student distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from otf_core.arrays import Array, Index
from otf_core.blocks import blocks
from otf_core.documents import Document, stated
from otf_core.model.axis_path import BREAK
from otf_core.model.frames import beam_frame
from otf_core.model.machine import TrackerSpec
from otf_core.model.observation import Samples
from otf_core.noise.colour import fit_colour
from otf_core.noise.noise_model import TYPICAL_CORRELATION_TIME, NoiseComponent, NoiseModel

BLOCK = 0.1
"""s; settling is slower than this, most tracker noise within a block faster."""
MIN_SAMPLES = 4
"""Samples in a block, at low rates."""
MAX_RATIO_AT_REST = 8.0
"""Ratio of a block's standard deviation to that of quiet blocks; heavy tails stay below it."""
MAX_BLOCK_CHANGE = 6.0
"""Change from block to block over its standard deviation in quiet blocks."""
MAX_FIRST_DEVIATION = 4.0
"""Deviation of the first and last blocks from the median, in the same units."""
QUIET_BLOCKS = 25.0
"""Percentile of all blocks that counts as quiet: most stops of a robot are not."""
NORMAL_PERCENTILE = 0.3186
"""This percentile of the absolute value of normal noise of unit variance."""
MIN_BLOCKS, MIN_BLOCKS_FOR_MEDIAN = 3, 8
"""Blocks; shorter standstills are not judged, or not by the deviation from their median."""
RESOLUTION = 0.2e-6
"""m and rad; levels below are indistinguishable."""
ROUNDING = 0.3
"""Standard deviation of rounding over its step."""


def spherical_deviations(xyz: Array) -> Array:
    """Range, and the two angles across the beam, relative to the mean of the points.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3), m
        Points of one standstill in the tracker frame.

    Returns
    -------
    ndarray, shape (n, 3)
        m, rad, rad; the angles about horizontal and vertical of the mean beam, both counted as
        angles of the beam itself.
    """
    mean = xyz.mean(axis=0)
    (distance,), (beam,), (horizontal,), (vertical,) = beam_frame(mean[None])
    offset = xyz - mean
    return np.stack(
        [offset @ beam, offset @ horizontal / distance, offset @ vertical / distance], axis=1
    )


def resolution(deviations: list[Array]) -> Array:
    """Levels that recordings do not distinguish: they are often rounded to 1 um and 1 urad.

    Parameters
    ----------
    deviations : list of ndarray, each of shape (n, 3), m, rad, rad

    Returns
    -------
    ndarray, shape (3,)
    """
    steps = np.abs(np.concatenate([np.zeros((0, 3)), *(np.diff(d, axis=0) for d in deviations)]))
    small = [np.percentile(s[s > 0], QUIET_BLOCKS) if (s > 0).any() else 0.0 for s in steps.T]
    return np.maximum(RESOLUTION, ROUNDING * np.array(small))


def block_size(samples: Samples) -> int:
    """Samples in a block."""
    return max(MIN_SAMPLES, round(BLOCK / samples.step))


def blocks_of(deviations: Array, size: int) -> tuple[Array, Array]:
    """Means and standard deviations of the whole blocks of a standstill, each of shape (b, 3)."""
    count = len(deviations) // size
    parts = deviations[: count * size].reshape(count, size, 3)
    return parts.mean(axis=1), parts.std(axis=1)


def _longest(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and one past the last of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0, 0
    best = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(best[0]), int(best[1])


@dataclass(frozen=True)
class QuietBlocks:
    """What blocks of a target at rest show.

    Attributes
    ----------
    deviation : ndarray, shape (3,), m, rad, rad
        Standard deviation within a block.
    change : ndarray, shape (3,)
        Standard deviation of the change of the mean from one block to the next.
    away : ndarray, shape (3,)
        Standard deviation of means about the median of their standstill.
    """

    deviation: Array
    change: Array
    away: Array


def quiet_blocks(blocks: list[tuple[Array, Array]], least: Array) -> QuietBlocks:
    """Judge quiet blocks; standstills too short for it do not count."""

    def lowest(values: list[Array]) -> Array:
        rows = np.concatenate([np.zeros((0, 3)), *values])
        low = np.percentile(rows, QUIET_BLOCKS, axis=0) if len(rows) else np.full(3, np.inf)
        return np.asarray(np.maximum(low, least))

    judged = [b for b in blocks if len(b[0]) >= MIN_BLOCKS]
    long = [mean for mean, _ in judged if len(mean) >= MIN_BLOCKS_FOR_MEDIAN]
    return QuietBlocks(
        lowest([deviation for _, deviation in judged]),
        lowest([np.abs(np.diff(mean, axis=0)) / NORMAL_PERCENTILE for mean, _ in judged]),
        lowest([np.abs(mean - np.median(mean, axis=0)) / NORMAL_PERCENTILE for mean in long]),
    )


def _judged_blocks(
    samples: Samples, runs: Index
) -> tuple[int, list[tuple[Array, Array]], QuietBlocks]:
    """Samples in a block, the blocks of every standstill, and what quiet ones show."""
    size = block_size(samples)
    deviations = [spherical_deviations(samples.xyz[a:b]) for a, b in runs]
    own = [blocks_of(d, size) for d in deviations]
    return size, own, quiet_blocks(own, resolution(deviations))


def _settled(mean: Array, away: Array) -> tuple[int, int]:
    """Blocks (first, one past last) between settling and the next start."""
    if len(mean) < MIN_BLOCKS_FOR_MEDIAN:
        return 0, len(mean)
    off = np.any(np.abs(mean - np.median(mean, axis=0)) > MAX_FIRST_DEVIATION * away, axis=1)
    if off.all():
        return 0, 0
    lead, trail = int(np.argmin(off)), int(np.argmin(off[::-1]))
    # what settles as an exponential has not ended where it comes down to the noise: wait as long
    return min(2 * lead, len(mean)), len(mean) - trail


def trim_to_rest(samples: Samples, runs: Index) -> Index:
    """Shorten standstills to the part in which the target is at rest.

    Parameters
    ----------
    runs : ndarray of int64, shape (k, 2)
        First sample and one past the last of every standstill.

    Returns
    -------
    ndarray of int64, shape (k', 2)
        Standstills without any rest are missing. Those shorter than three blocks are not
        shortened: they are at rest as a whole or not at all.
    """
    if not len(runs):
        return runs
    size, blocks, quiet = _judged_blocks(samples, runs)
    spans = []
    for (first, last), (mean, deviation) in zip(runs, blocks, strict=True):
        jump = np.any(np.abs(np.diff(mean, axis=0)) > MAX_BLOCK_CHANGE * quiet.change, axis=1)
        bad = np.any(deviation > MAX_RATIO_AT_REST * quiet.deviation, axis=1)
        if len(mean) < MIN_BLOCKS:  # a target that turns back creeps for as long
            if not (jump.any() or bad.any()):
                spans.append((first, last))
            continue
        bad[1:] |= jump
        bad[:-1] |= jump
        low, high = _longest(~bad)
        start, stop = _settled(mean[low:high], quiet.away)
        if stop > start:
            end = last if low + stop == len(mean) else first + (low + stop) * size
            spans.append((first + (low + start) * size, end))
    return np.array(spans, dtype=np.int64).reshape(-1, 2)


QUIET_BLOCKS_ASIDE = 3
"""Blocks on either side of a step that have to be quiet."""
MIN_DRIFT_TIME = 5.0
"""s; a shorter standstill does not distinguish drift from slow noise."""


@dataclass(frozen=True)
class LostSamples(Document):
    """Samples that are missing according to the stamps."""

    samples: int = stated('missing samples')
    gaps: int = stated('pauses in which they are missing')
    longest: float = stated('longest pause', 's')


@dataclass(frozen=True)
class Step(Document):
    """A change from one level to another within a standstill."""

    time: float = stated('since the first sample', 's')
    size: Array = stated('change of range and angles', 'm, rad, rad', shape=(3,))


@dataclass(frozen=True)
class Drift(Document):
    """Straight line through the longest standstill."""

    duration: float = stated('of that standstill', 's')
    change: Array = stated('range and angles, over its duration', 'm, rad, rad', shape=(3,))


def moves_by_hand(samples: Samples, parts: int) -> Index:
    """Samples before the pauses between the parts of a run, in which a reflector was moved.

    They are the longest, and ``BREAK`` or more.
    """
    interval = np.diff(samples.stamp_ns)
    longest = np.argsort(-interval, kind='stable')[: max(parts - 1, 0)]
    return np.sort(longest[interval[longest] >= 1e9 * BREAK])


def lost_samples(samples: Samples, parts: int = 1) -> LostSamples:
    """Count missing samples: pauses in multiples of the usual interval.

    Parameters
    ----------
    parts : int
        Of the run; the beam is broken between them, so nothing is lost there.
    """
    interval, usual = np.diff(samples.stamp_ns), samples.step_ns
    interval[moves_by_hand(samples, parts)] = 0
    pauses = interval[interval >= 1.5 * usual]
    missing = np.rint(pauses / usual).astype(np.int64) - 1
    longest = float(pauses.max(initial=0)) * 1e-9
    return LostSamples(int(missing.sum()), len(pauses), longest)


def find_steps(samples: Samples, runs: Index) -> tuple[Step, ...]:
    """Find steps: quiet before, quiet after, but elsewhere.

    Parameters
    ----------
    runs : ndarray of int64, shape (k, 2)
        From ``find_standstills``.
    """
    size, blocks, quiet = _judged_blocks(samples, runs)
    limit = MAX_BLOCK_CHANGE * np.hypot(
        quiet.change, np.where(np.isfinite(quiet.away), quiet.away, 0.0)
    )
    steps = []
    for (first, _), (mean, _) in zip(runs, blocks, strict=True):
        places = np.arange(QUIET_BLOCKS_ASIDE, len(mean) - QUIET_BLOCKS_ASIDE)
        if not len(places):
            continue
        before = np.stack([mean[k - QUIET_BLOCKS_ASIDE : k] for k in places])
        after = np.stack([mean[k + 1 : k + 1 + QUIET_BLOCKS_ASIDE] for k in places])
        change = after.mean(axis=1) - before.mean(axis=1)
        calm = np.all(np.maximum(np.ptp(before, axis=1), np.ptp(after, axis=1)) < limit, axis=1)
        height = np.where(calm, np.max(np.abs(change) / limit, axis=1), 0.0)
        while height.max() > 1.0:
            best = int(height.argmax())
            sample = first + round((places[best] + 0.5) * size)
            steps.append(Step(float(samples.time[sample]), change[best]))
            height[max(best - QUIET_BLOCKS_ASIDE, 0) : best + QUIET_BLOCKS_ASIDE + 1] = 0.0
    return tuple(sorted(steps, key=lambda s: s.time))


def find_drift(samples: Samples, rest: Index) -> Drift | None:
    """Fit a line to the longest part at rest; None if that is short.

    Parameters
    ----------
    rest : ndarray of int64, shape (k, 2)
        From ``trim_to_rest``.
    """
    if not len(rest):
        return None
    first, last = rest[np.argmax(rest[:, 1] - rest[:, 0])]
    time = samples.time[first:last]
    duration = float(time[-1] - time[0])
    if duration < MIN_DRIFT_TIME:
        return None
    line = np.polyfit(time - time.mean(), spherical_deviations(samples.xyz[first:last]), 1)
    return Drift(duration, np.asarray(line[0] * duration))


SMOOTHING = 0.1
"""s; slower noise is taken off first, so that its wandering does not count as tails."""
MAX_VALUES = 5_000
"""Values that the likelihood is taken over."""
FREEDOMS = np.geomspace(2.2, 60.0, 30)
"""Degrees of freedom tried; more are indistinguishable from normal."""


@dataclass(frozen=True)
class Tails(Document):
    """Tails of the fast noise of one quantity."""

    excess_kurtosis: float = stated('0 for normal noise')
    student_freedom: float | None = stated(
        'degrees of freedom of the likeliest Student distribution; null: normal'
    )
    beyond_4_sigma: float = stated('share of values; 6e-5 for normal noise')


def _log_likelihoods(square: Array, freedom: Array) -> Array:
    """Largest log-likelihoods over the scale, found by expectation and maximisation.

    Of squares (n,) for degrees of freedom (f,), shape (f,).
    """
    free, scale = freedom[:, None], np.full((len(freedom), 1), float(np.median(square)) or 1.0)
    for _ in range(20):
        share = square / (square + free * scale)
        scale = (free + 1) * scale * share.mean(axis=1, keepdims=True)
    rest = (0.5 * (free + 1) * np.log1p(square / (free * scale))).sum(axis=1)
    constant = gammaln(0.5 * (freedom + 1)) - gammaln(0.5 * freedom)
    constant -= 0.5 * np.log(np.pi * freedom * scale[:, 0])
    return np.asarray(square.size * constant - rest)


def student_likelihood(values: Array) -> tuple[Array, float]:
    """Log-likelihoods of Student's t for each of ``FREEDOMS``, and of the normal distribution."""
    values = values[:: max(1, values.size // MAX_VALUES)]
    square = values**2 / max(float(np.mean(values**2)), 1e-300)
    normal = -0.5 * square.size * (np.log(2 * np.pi) + 1.0)
    return _log_likelihoods(square, FREEDOMS), float(normal)


def student_freedom(values: Array) -> float | None:
    """Degrees of freedom by maximum likelihood; None if normal fits as well (1 % level)."""
    likelihood, normal = student_likelihood(values)
    best = int(likelihood.argmax())
    return float(FREEDOMS[best]) if likelihood[best] > normal + 3.3 else None


def _moving_mean(values: Array, half: int) -> Array:
    """Means of values (n, c) and ``half`` on either side, mirrored at the ends.

    Of values about zero, as sums are subtracted; importing ``scipy.ndimage`` takes 25 ms.
    """
    padded = np.pad(values, ((half + 1, half), (0, 0)), mode='symmetric')
    sums = np.cumsum(padded, axis=0)
    return np.asarray((sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1))


def fast_part(windows: Sequence[Array], step: float) -> Array:
    """Values (n, c) of all windows less slower noise, of unit variance in every window."""
    half = max(2, round(0.5 * SMOOTHING / step))
    width = 2 * half + 1
    rest = [w - w.mean(axis=0) for w in windows]
    rest = [w - _moving_mean(w, half) for w in rest]
    sized = [r / np.maximum(r.std(axis=0), 1e-300) for r in rest if len(r) > width]
    return np.concatenate(sized or rest)


def tails(windows: Sequence[Array], step: float) -> tuple[Tails, ...]:
    """Tails of each quantity over windows (n, c) of values ``step`` seconds apart."""
    fits = []
    for column in fast_part(windows, step).T:
        square = float(np.mean(column**2)) or 1.0
        fits.append(
            Tails(
                float(np.mean(column**4) / square**2 - 3.0),
                student_freedom(column),
                float(np.mean(np.abs(column) > 4.0 * np.sqrt(square))),
            )
        )
    return tuple(fits)


MIN_DURATION = 0.25
"""s; shorter stops are not used."""
GUARD = 0.05
"""s; left out at both ends of a standstill: settling."""
INDISTINCT_RATIOS = (0.7, 1.6)
"""Measured over specified level that stops of a second cannot distinguish from 1."""
SLOW_TIME = 1.0
"""s; correlation time of slow but usual noise, of which little standstill shows little."""
MIN_TOTAL = 5.0
"""s; less standstill in all determines the noise too poorly."""
WINDOW = 4.0
"""s; longer standstills are cut, so that slow drift does not count as noise."""
MIN_TIME_OF_DRIFT = 8.0
"""s; of standstills as long as this a straight line is drift, and taken off."""
MIN_PART = 0.2
"""s; parts of a standstill that are shorter are not used."""
MIN_WINDOW_OF_LEVEL = 1.0
"""s; the level of shorter windows scatters much."""
QUIET_WINDOWS = 10.0
"""Percentile of the windows that counts as quiet."""
MAX_RATIO_OF_WINDOWS = 4.0
"""Ratio of a long window to quiet ones beyond which the target itself must have moved."""
MAX_REPEATED_DIFFERENCE = 1e-11
"""m and rad; points that differ by less are one point repeated."""


def find_standstills(samples: Samples, speed: float, min_duration: float = MIN_DURATION) -> Index:
    """Find where the target stands still.

    Parameters
    ----------
    speed : float
        m/s; slower counts as standstill. Taken over 0.1 s, so that noise does not hide it.
    min_duration : float
        s; shorter standstills, settling times left out, are not reported.

    Returns
    -------
    ndarray of int64, shape (k, 2)
        First sample and one past the last of every standstill, settling times left out.
    """
    if len(samples) < 4:
        return np.zeros((0, 2), dtype=np.int64)
    step = max(samples.step, 1e-9)
    half = max(1, round(0.05 / step))
    if len(samples) <= 2 * half + 1:
        return np.zeros((0, 2), dtype=np.int64)
    count = len(samples) - 2 * half
    still = np.zeros(count + 2, dtype=bool)
    for early in blocks(count):
        late = slice(early.start + 2 * half, early.stop + 2 * half)
        span = (samples.stamp_ns[late] - samples.stamp_ns[early]) * 1e-9
        moved = samples.xyz[late] - samples.xyz[early]
        slow = np.einsum('ij,ij->i', moved, moved) < (speed * span) ** 2
        still[early.start + 1 : early.stop + 1] = slow & (span < 4 * half * step)
    edges = np.flatnonzero(still[1:] != still[:-1])
    runs = edges.reshape(-1, 2) + half
    guard = max(0, round(GUARD / step) - half)
    runs += np.array([guard, -guard])
    long = runs[:, 1] - runs[:, 0] >= min_duration / step
    return np.asarray(runs[long], dtype=np.int64)


@dataclass(frozen=True)
class MeasuredNoise:
    """Noise that standstills show.

    Attributes
    ----------
    noise : NoiseModel
        Levels with the slow part that a short stop hides.
    tails : tuple of Tails
        Of range, horizontal and vertical angle.
    windows, samples : int
        Windows of standstill and samples in them.
    left_out : int
        Windows in which the target seems to have moved.
    """

    noise: NoiseModel
    tails: tuple[Tails, ...]
    windows: int
    samples: int
    left_out: int = 0


def _windows(samples: Samples, rest: Index, step: float) -> list[Array]:
    """Deviations in equal parts of each standstill, no longer than ``WINDOW``."""
    windows = []
    for first, last in rest:
        length = (last - first) * step
        parts = int(np.ceil(length / WINDOW - 1e-9))
        deviations = spherical_deviations(samples.xyz[first:last])
        if length >= MIN_TIME_OF_DRIFT:
            line = np.linspace(-1.0, 1.0, last - first)
            deviations -= np.outer(line, line @ deviations / (line @ line))
        windows += np.array_split(deviations, parts)
    return windows


def _usable(windows: list[Array], step: float) -> tuple[list[Array], int]:
    """Leave out windows that are too short or in which the target itself seems to have moved."""
    windows = [w for w in windows if len(w) * step >= MIN_PART]
    # else the last point is held, not measured
    windows = [w for w in windows if np.ptp(w, axis=0).max() > MAX_REPEATED_DIFFERENCE]
    if not windows:
        return [], 0
    level = np.array([w.std(axis=0) for w in windows])
    # the shorter a window, the more its level scatters
    quiet = np.percentile(level, QUIET_WINDOWS, axis=0)
    limit = MAX_RATIO_OF_WINDOWS * (
        1.0 + MIN_WINDOW_OF_LEVEL / (step * np.array([len(w) for w in windows]))
    )
    still = np.all(level <= limit[:, None] * np.maximum(quiet, resolution(windows)), axis=1)
    return [w for w, s in zip(windows, still, strict=True) if s], int(np.sum(~still))


def quiet_windows(samples: Samples, runs: Index) -> tuple[list[Array], int]:
    """Deviations of range and angles in windows of standstill.

    Only the part at rest is taken (``trim_to_rest``), and windows much louder than the quiet
    ones are left out: there the target moves (a machine that settles or is shaken).

    Parameters
    ----------
    runs : ndarray of int64, shape (k, 2)
        From ``find_standstills``.

    Returns
    -------
    windows : list of ndarray, each of shape (n, 3), m, rad, rad
        See ``spherical_deviations``.
    left_out : int
        Number of louder windows, and of standstills without any rest.
    """
    rest, step = trim_to_rest(samples, runs), samples.step
    windows, louder = _usable(_windows(samples, rest, step), step)
    return windows, louder + len(runs) - len(rest)


def standstill_noise(
    samples: Samples, runs: Index, min_total: float = MIN_TOTAL
) -> MeasuredNoise | None:
    """Split the noise of standstills into a white and a correlated part.

    Parameters
    ----------
    runs : ndarray of int64, shape (k, 2)
        From ``find_standstills``.
    min_total : float
        s; least standstill in all.

    Returns
    -------
    MeasuredNoise or None
        None if there is less standstill.
    """
    length = np.diff(runs, axis=1).sum() if len(runs) else 0
    if not length:
        return None
    windows, left_out = quiet_windows(samples, runs)
    if length * samples.step < min_total or not windows:
        return None
    return noise_of_windows(windows, samples.step, left_out)


def noise_of_windows(windows: list[Array], step: float, left_out: int = 0) -> MeasuredNoise:
    """Level, colour and tails of windows (n, 3) of values ``step`` seconds apart."""
    heaviness = tails(windows, step)
    parts = zip(fit_colour(windows, step), heaviness, strict=True)
    noise = NoiseModel(*(replace(c, dof=t.student_freedom) for c, t in parts))
    return MeasuredNoise(noise, heaviness, len(windows), sum(len(w) for w in windows), left_out)


def level_scatter(duration: float) -> float:
    """Factor within which standstills of some duration (s) in all show the level of slow noise.

    T seconds hold T / tau independent squares of noise correlated over tau, so the logarithm of
    the level has the standard deviation sqrt(tau / (2 T)); twice that counts.
    """
    return float(np.exp(2.0 * np.sqrt(0.5 * SLOW_TIME / duration)))


def _near(samples: Samples, seen: MeasuredNoise) -> tuple[float, float]:
    """Measured over specified levels that do not contradict.

    A stop of length w may show as little of its variance as 1 - exp(-w / tau).
    """
    duration = seen.samples * samples.step
    scatter = level_scatter(duration)
    shown = np.sqrt(-np.expm1(-duration / seen.windows / SLOW_TIME))
    return min(INDISTINCT_RATIOS[0], 1.0 / scatter, shown), max(INDISTINCT_RATIOS[1], scatter)


def _stretch(seen: NoiseModel, level: Array, near: NDArray[np.bool_]) -> float:
    """Factor on the correlation time where levels near the specified ones are taken as these.

    Short stops fix the fast part, and of the slow part only variance over time: the time goes
    with the variance. It was fitted to all components, and is stretched alike for all these.
    """
    slow, slow_specified = seen.level**2 - seen.white**2, level**2 - seen.white**2
    shown = float(np.sum((slow / level**2)[near]))
    return (
        min(max(float(np.sum((slow_specified / level**2)[near])) / shown, 0.2), 5.0)
        if shown
        else 1.0
    )


def noise_model(samples: Samples, spec: TrackerSpec, speed: float) -> NoiseModel:
    """Noise of a run: as its own standstills show it, else as specified.

    Parameters
    ----------
    speed : float
        m/s; slower counts as standstill.

    Returns
    -------
    NoiseModel
        Levels as specified where the measured ones do not contradict, and never below a third
        of them: a tracker that stands very still shows nothing of its noise in motion.
    """
    seen = standstill_noise(samples, find_standstills(samples, speed))
    if seen is None:
        return NoiseModel.from_spec(spec)
    specified, noise = np.array([spec.u_range, spec.u_angle, spec.u_angle]), seen.noise
    low, high = _near(samples, seen)
    near = (noise.level > low * specified) & (noise.level < high * specified)
    near &= noise.white < specified
    level = np.where(near, specified, np.maximum(noise.level, specified / 3))
    measured = noise.range.correlation_time or TYPICAL_CORRELATION_TIME
    time = measured * np.where(near, _stretch(noise, level, near), 1.0)
    white = np.clip(noise.white / level, np.sqrt(0.05), 1.0) * level
    parts = zip(level.tolist(), white.tolist(), time.tolist(), strict=True)
    return NoiseModel(*(NoiseComponent(*p, c.dof) for p, c in zip(parts, noise, strict=True)))
