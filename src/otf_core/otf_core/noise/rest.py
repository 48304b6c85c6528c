# SPDX-License-Identifier: Apache-2.0
"""Where in a standstill the target is at rest: settling, shaking and the next start left out.

A target that has stopped goes on moving for a while: axes settle, a structure rings, the next move
begins. This is no noise of the tracker. Each standstill is judged in blocks of a tenth of a second
against the quiet blocks of the whole recording, so that no size of noise has to be known before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.beam_frame import beam_frame
from otf_core.model.observation import Samples

BLOCK = 0.1
"""s; settling is slower than this, most tracker noise within a block faster."""
MIN_SAMPLES = 4
"""Samples in a block, at low rates."""
SHAKEN = 8.0
"""Ratio of a block's standard deviation to that of quiet blocks; heavy tails stay below it."""
IN_MOTION = 6.0
"""Change from block to block over its standard deviation in quiet blocks."""
SETTLED = 4.0
"""Deviation of the first and last blocks from the median, in the same units."""
QUIET = 25.0
"""Percentile of all blocks that counts as quiet: most stops of a robot are not."""
NORMAL = 0.3186
"""This percentile of the absolute value of normal noise of unit variance."""
SHORT, LONG = 3, 8
"""Blocks; shorter standstills are not judged, or not by the deviation from their median."""
RESOLUTION = 0.2e-6
"""m and rad; levels below are not told apart."""
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
    """Levels that recordings do not tell apart: they are often rounded to 1 um and 1 urad.

    Parameters
    ----------
    deviations : list of ndarray, each of shape (n, 3), m, rad, rad

    Returns
    -------
    ndarray, shape (3,)
    """
    steps = np.abs(np.concatenate([np.zeros((0, 3)), *(np.diff(d, axis=0) for d in deviations)]))
    small = [np.percentile(s[s > 0], QUIET) if (s > 0).any() else 0.0 for s in steps.T]
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
class Quiet:
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


def quiet_blocks(blocks: list[tuple[Array, Array]], least: Array) -> Quiet:
    """Judge quiet blocks; standstills too short for it do not count."""

    def lowest(values: list[Array]) -> Array:
        rows = np.concatenate([np.zeros((0, 3)), *values])
        low = np.percentile(rows, QUIET, axis=0) if len(rows) else np.full(3, np.inf)
        return np.asarray(np.maximum(low, least))

    judged = [b for b in blocks if len(b[0]) >= SHORT]
    long = [mean for mean, _ in judged if len(mean) >= LONG]
    return Quiet(
        lowest([deviation for _, deviation in judged]),
        lowest([np.abs(np.diff(mean, axis=0)) / NORMAL for mean, _ in judged]),
        lowest([np.abs(mean - np.median(mean, axis=0)) / NORMAL for mean in long]),
    )


def _settled(mean: Array, away: Array) -> tuple[int, int]:
    """Blocks (first, one past last) between settling and the next start."""
    if len(mean) < LONG:
        return 0, len(mean)
    off = np.any(np.abs(mean - np.median(mean, axis=0)) > SETTLED * away, axis=1)
    if off.all():
        return 0, 0
    lead, trail = int(np.argmin(off)), int(np.argmin(off[::-1]))
    # what settles as an exponential has not ended where it comes down to the noise: wait as long
    return min(2 * lead, len(mean)), len(mean) - trail


def at_rest(samples: Samples, runs: Index) -> Index:
    """Shorten standstills to the part in which the target is at rest.

    Parameters
    ----------
    samples : Samples
    runs : ndarray of int64, shape (k, 2)
        First sample and one past the last of every standstill.

    Returns
    -------
    ndarray of int64, shape (k', 2)
        Standstills without any rest are missing; those shorter than three blocks are returned
        as they are.
    """
    if not len(runs):
        return runs
    size = block_size(samples)
    deviations = [spherical_deviations(samples.xyz[a:b]) for a, b in runs]
    blocks = [blocks_of(d, size) for d in deviations]
    quiet = quiet_blocks(blocks, resolution(deviations))
    found = []
    for (first, last), (mean, deviation) in zip(runs, blocks, strict=True):
        if len(mean) < SHORT:
            found.append((first, last))
            continue
        jump = np.any(np.abs(np.diff(mean, axis=0)) > IN_MOTION * quiet.change, axis=1)
        bad = np.any(deviation > SHAKEN * quiet.deviation, axis=1)
        bad[1:] |= jump
        bad[:-1] |= jump
        low, high = _longest(~bad)
        start, stop = _settled(mean[low:high], quiet.away)
        if stop > start:
            end = last if low + stop == len(mean) else first + (low + stop) * size
            found.append((first + (low + start) * size, end))
    return np.array(found, dtype=np.int64).reshape(-1, 2)
