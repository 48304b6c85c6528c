# SPDX-License-Identifier: Apache-2.0
"""Standstills of a recording, and the tracker noise seen in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.memory import blocks
from otf_core.model.machine import TrackerSpec
from otf_core.model.observation import Samples
from otf_core.noise.colour import fit_colour
from otf_core.noise.model import TYPICAL_CORRELATION_TIME, NoiseComponent, NoiseModel
from otf_core.noise.rest import at_rest, resolution, spherical_deviations
from otf_core.noise.tails import Tails, tails

MIN_DURATION = 0.25
"""s; shorter stops are not used."""
GUARD = 0.05
"""s; left out at both ends of a standstill: settling."""
NEAR = (0.7, 1.6)
"""Measured over specified level that stops of a second cannot tell from 1."""
SLOWEST = 1.0
"""s; correlation time of slow but usual noise, of which little standstill shows little."""
MIN_TOTAL = 5.0
"""s; less standstill in all says too little about the noise."""
WINDOW = 4.0
"""s; longer standstills are cut, so that slow drift does not count as noise."""
DRIFTING = 8.0
"""s; of standstills as long as this a straight line is drift, and taken off."""
SHORTEST = 0.2
"""s; parts of a standstill that are shorter are not used."""
LONG = 1.0
"""s; the level of shorter windows scatters much."""
QUIET = 10.0
"""Percentile of the windows that counts as quiet."""
LOUD = 4.0
"""Ratio of a long window to quiet ones beyond which the target itself must have moved."""
HELD = 1e-11
"""m and rad; points that differ by less are one point repeated."""


def find_standstills(samples: Samples, speed: float, min_duration: float = MIN_DURATION) -> Index:
    """Find where the target stands still.

    Parameters
    ----------
    samples : Samples
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
    found = []
    for first, last in rest:
        length = (last - first) * step
        parts = int(np.ceil(length / WINDOW - 1e-9))
        deviations = spherical_deviations(samples.xyz[first:last])
        if length >= DRIFTING:
            line = np.linspace(-1.0, 1.0, last - first)
            deviations -= np.outer(line, line @ deviations / (line @ line))
        found += np.array_split(deviations, parts)
    return found


def _usable(windows: list[Array], step: float) -> tuple[list[Array], int]:
    """Leave out windows that are too short or in which the target itself seems to have moved."""
    windows = [w for w in windows if len(w) * step >= SHORTEST]
    # else the last point is held, not measured
    windows = [w for w in windows if np.ptp(w, axis=0).max() > HELD]
    if not windows:
        return [], 0
    level = np.array([w.std(axis=0) for w in windows])
    # the shorter a window, the more its level scatters
    quiet = np.percentile(level, QUIET, axis=0)
    limit = LOUD * (1.0 + LONG / (step * np.array([len(w) for w in windows])))
    still = np.all(level <= limit[:, None] * np.maximum(quiet, resolution(windows)), axis=1)
    return [w for w, s in zip(windows, still, strict=True) if s], int(np.sum(~still))


def quiet_windows(samples: Samples, runs: Index) -> tuple[list[Array], int]:
    """Deviations of range and angles in windows of standstill.

    Only the part at rest is taken (``rest.at_rest``), and windows much louder than the quiet
    ones are left out: there the target moves (a machine that settles or is shaken).

    Parameters
    ----------
    samples : Samples
    runs : ndarray of int64, shape (k, 2)
        From ``find_standstills``.

    Returns
    -------
    windows : list of ndarray, each of shape (n, 3), m, rad, rad
        See ``spherical_deviations``.
    left_out : int
        Number of louder windows, and of standstills without any rest.
    """
    rest, step = at_rest(samples, runs), samples.step
    windows, louder = _usable(_windows(samples, rest, step), step)
    return windows, louder + len(runs) - len(rest)


def standstill_noise(
    samples: Samples, runs: Index, min_total: float = MIN_TOTAL
) -> MeasuredNoise | None:
    """Split the noise of standstills into a white and a correlated part.

    Parameters
    ----------
    samples : Samples
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
    found = tails(windows, step)
    parts = zip(fit_colour(windows, step), found, strict=True)
    noise = NoiseModel(*(replace(c, dof=t.freedom) for c, t in parts))
    return MeasuredNoise(noise, found, len(windows), sum(len(w) for w in windows), left_out)


def _near(samples: Samples, seen: MeasuredNoise) -> tuple[float, float]:
    """Measured over specified levels that do not contradict.

    T seconds hold T / tau independent squares of noise correlated over tau, so the logarithm of
    its level has the standard deviation sqrt(tau / (2 T)); twice that counts.
    A stop of length w may show as little of its variance as 1 - exp(-w / tau).
    """
    duration = seen.samples * samples.step
    scatter = np.exp(2.0 * np.sqrt(0.5 * SLOWEST / duration))
    shown = np.sqrt(-np.expm1(-duration / seen.windows / SLOWEST))
    return min(NEAR[0], 1.0 / scatter, shown), max(NEAR[1], scatter)


def _stretch(seen: NoiseModel, level: Array, near: NDArray[np.bool_]) -> float:
    """Factor on the correlation time where levels near the specified ones are taken as these.

    Short stops fix the fast part, and of the slow part only variance over time: the time goes
    with the variance. It was fitted to all components, and is stretched alike for all these.
    """
    slow, taken = seen.level**2 - seen.white**2, level**2 - seen.white**2
    shown = float(np.sum((slow / level**2)[near]))
    return min(max(float(np.sum((taken / level**2)[near])) / shown, 0.2), 5.0) if shown else 1.0


def noise_model(samples: Samples, spec: TrackerSpec, speed: float) -> NoiseModel:
    """Noise of a run: as its own standstills show it, else as specified.

    Parameters
    ----------
    samples : Samples
    spec : TrackerSpec
    speed : float
        m/s; slower counts as standstill.

    Returns
    -------
    NoiseModel
        Levels as specified where the measured ones do not contradict, and never below a third
        of them: a tracker that stands very still says nothing about its noise in motion.
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
