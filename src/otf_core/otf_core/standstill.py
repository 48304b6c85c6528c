# SPDX-License-Identifier: Apache-2.0
"""Standstills of a recording, and the tracker noise seen in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from otf_core.machine import TrackerSpec
from otf_core.noise import TYPICAL_CORRELATION_TIME, TYPICAL_WHITE_SHARE, NoiseModel
from otf_core.observation import Samples

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MIN_DURATION = 0.25
"""s; shorter stops are not used."""
GUARD = 0.05
"""s; left out at both ends of a standstill: settling."""
MIN_TOTAL = 5.0
"""s; less standstill in all says too little about the noise."""
CORRELATION_TIMES = np.geomspace(0.03, 3.0, 25)


def find_standstills(samples: Samples, speed: float) -> Index:
    """Find where the target stands still.

    Parameters
    ----------
    samples : Samples
    speed : float
        m/s; slower counts as standstill. Taken over 0.1 s, so that noise does not hide it.

    Returns
    -------
    ndarray of int64, shape (k, 2)
        First sample and one past the last of every standstill, settling times left out.
    """
    if len(samples) < 4:
        return np.zeros((0, 2), dtype=np.int64)
    step = max(float(np.median(np.diff(samples.stamp_ns))) * 1e-9, 1e-9)
    half = max(1, round(0.05 / step))
    if len(samples) <= 2 * half + 1:
        return np.zeros((0, 2), dtype=np.int64)
    span = (samples.stamp_ns[2 * half :] - samples.stamp_ns[: -2 * half]) * 1e-9
    moved = np.linalg.norm(samples.xyz[2 * half :] - samples.xyz[: -2 * half], axis=1)
    still = np.concatenate([[False], (moved < speed * span) & (span < 4 * half * step), [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    runs = edges.reshape(-1, 2) + half
    guard = max(0, round(GUARD / step) - half)
    runs += np.array([guard, -guard])
    long = runs[:, 1] - runs[:, 0] >= MIN_DURATION / step
    return np.asarray(runs[long], dtype=np.int64)


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
    distance = float(np.linalg.norm(mean))
    beam = mean / distance
    horizontal = np.array([-beam[1], beam[0], 0.0])
    size = float(np.linalg.norm(horizontal))
    horizontal = horizontal / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])
    vertical = np.cross(beam, horizontal)
    offset = xyz - mean
    return np.stack(
        [offset @ beam, offset @ horizontal / distance, offset @ vertical / distance], axis=1
    )


@dataclass(frozen=True)
class StandstillNoise:
    """Noise of range and two angles over standstills.

    Attributes
    ----------
    total : ndarray, shape (3,)
        Standard deviations (m, rad, rad), the slow part that a short stop hides included.
    white : ndarray, shape (3,)
        Standard deviations of the white part.
    correlation_time : float
        s.
    standstills, samples : int
    """

    total: Array
    white: Array
    correlation_time: float
    standstills: int
    samples: int


def _centred_covariance(time: float, length: int, lags: int, step: float) -> Array:
    """Expected autocovariance sums of Gauss-Markov noise of unit variance, mean removed."""
    gap = np.abs(np.subtract.outer(np.arange(length), np.arange(length))) * step / time
    matrix = np.exp(-gap)
    row = matrix.mean(axis=1)
    matrix = matrix - row[:, None] - row[None, :] + row.mean()
    return np.array([np.trace(matrix, k) for k in range(lags)])


def standstill_noise(samples: Samples, runs: Index) -> StandstillNoise | None:
    """Split the noise of standstills into a white and a correlated part.

    Each standstill loses its mean, which hides part of the slow noise; the expected
    autocovariance of what is left is known and is fitted to what is seen (non-negative least
    squares over lags, for a grid of correlation times).

    Returns
    -------
    StandstillNoise or None
        None if the standstills are shorter than ``MIN_TOTAL`` in all.
    """
    step = float(np.median(np.diff(samples.stamp_ns))) * 1e-9
    length = np.diff(runs, axis=1)[:, 0] if len(runs) else np.zeros(0, dtype=np.int64)
    if length.sum() * step < MIN_TOTAL:
        return None
    # longer standstills are cut, so that one expected shape serves all
    window = int(np.clip(np.median(length), 8, max(8, round(2.0 / step), 16)))
    window = min(window, 400)
    thin = max(1, int(np.median(length)) // 400) if np.median(length) > 400 else 1
    lags = max(4, window // 2)
    sums, count = np.zeros((3, lags)), 0
    for first, last in runs:
        for start in range(first, last - window * thin + 1, window * thin):
            part = spherical_deviations(samples.xyz[start : start + window * thin : thin])
            part = part - part.mean(axis=0)
            for k in range(lags):
                sums[:, k] += np.einsum('ij,ij->j', part[k:], part[: len(part) - k])
            count += 1
    if count < 3:
        return None
    observed = sums / count
    return _fit_colour(observed, window, step * thin, count, int(length.sum()))


def _fit_colour(
    observed: Array, window: int, step: float, count: int, samples: int
) -> StandstillNoise:
    lags = observed.shape[1]
    scale = window - np.arange(lags)
    white_shape = np.array([window - 1.0] + [-(window - k) / window for k in range(1, lags)])
    best = (np.inf, np.zeros((3, 2)), float(CORRELATION_TIMES[0]))
    for time in CORRELATION_TIMES:
        slow_shape = _centred_covariance(time, window, lags, step)
        design = np.stack([white_shape, slow_shape], axis=1) / scale[:, None]
        fits = [nnls(design, row / scale / observed[i, 0]) for i, row in enumerate(observed)]
        misfit = sum(f[1] ** 2 for f in fits)
        if misfit < best[0]:
            parts = np.array([f[0] * observed[i, 0] for i, f in enumerate(fits)])
            best = (misfit, parts, float(time))
    parts = best[1]
    return StandstillNoise(
        np.sqrt(parts.sum(axis=1)), np.sqrt(parts[:, 0]), best[2], count, samples
    )


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
        Levels never below a third of the specified ones: a tracker that stands very still says
        nothing about its noise in motion.
    """
    seen = standstill_noise(samples, find_standstills(samples, speed))
    if seen is None:
        return NoiseModel.from_spec(spec)
    angle = float(np.sqrt(np.mean(seen.total[1:] ** 2)))
    white_angle = float(np.sum(seen.white[1:] ** 2) / max(np.sum(seen.total[1:] ** 2), 1e-300))
    white_range = float(seen.white[0] ** 2 / max(seen.total[0] ** 2, 1e-300))
    return NoiseModel(
        max(float(seen.total[0]), spec.u_range / 3),
        max(angle, spec.u_angle / 3),
        float(np.clip(white_range, 0.05, 1.0)) if white_range else TYPICAL_WHITE_SHARE,
        float(np.clip(white_angle, 0.05, 1.0)) if white_angle else TYPICAL_WHITE_SHARE,
        seen.correlation_time or TYPICAL_CORRELATION_TIME,
    )
