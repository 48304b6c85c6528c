# SPDX-License-Identifier: Apache-2.0
"""What a recording holds besides noise: lost samples, steps and drift while the target stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.observation import Samples
from otf_core.noise.rest import (
    IN_MOTION,
    block_size,
    blocks_of,
    quiet_blocks,
    resolution,
    spherical_deviations,
)

SIDE = 3
"""Blocks on either side of a step that have to be quiet."""
LONG = 5.0
"""s; a shorter standstill does not tell drift from slow noise."""


@dataclass(frozen=True)
class Lost:
    """Samples that the stamps say are missing.

    Attributes
    ----------
    samples, gaps : int
        Missing samples, and pauses in which they are missing.
    longest : float
        s, longest pause.
    """

    samples: int
    gaps: int
    longest: float


@dataclass(frozen=True)
class Step:
    """A change from one level to another within a standstill.

    Attributes
    ----------
    time : float
        s since the first sample.
    size : ndarray, shape (3,), m, rad, rad
        Change of range, horizontal and vertical angle.
    """

    time: float
    size: Array


@dataclass(frozen=True)
class Drift:
    """Straight line through the longest standstill.

    Attributes
    ----------
    duration : float
        s, of that standstill.
    change : ndarray, shape (3,), m, rad, rad
        Over its duration.
    """

    duration: float
    change: Array


def lost_samples(samples: Samples) -> Lost:
    """Count missing samples: pauses in multiples of the usual interval."""
    interval, usual = np.diff(samples.stamp_ns), samples.step_ns
    pauses = interval[interval >= 1.5 * usual]
    missing = np.rint(pauses / usual).astype(np.int64) - 1
    longest = float(pauses.max(initial=0)) * 1e-9
    return Lost(int(missing.sum()), len(pauses), longest)


def find_steps(samples: Samples, runs: Index) -> tuple[Step, ...]:
    """Find steps: quiet before, quiet after, but elsewhere.

    Parameters
    ----------
    samples : Samples
    runs : ndarray of int64, shape (k, 2)
        From ``find_standstills``.
    """
    size = block_size(samples)
    deviations = [spherical_deviations(samples.xyz[a:b]) for a, b in runs]
    blocks = [blocks_of(d, size) for d in deviations]
    quiet = quiet_blocks(blocks, resolution(deviations))
    limit = IN_MOTION * np.hypot(quiet.change, np.where(np.isfinite(quiet.away), quiet.away, 0.0))
    found = []
    for (first, _), (mean, _) in zip(runs, blocks, strict=True):
        places = np.arange(SIDE, len(mean) - SIDE)
        if not len(places):
            continue
        before = np.stack([mean[k - SIDE : k] for k in places])
        after = np.stack([mean[k + 1 : k + 1 + SIDE] for k in places])
        change = after.mean(axis=1) - before.mean(axis=1)
        calm = np.all(np.maximum(np.ptp(before, axis=1), np.ptp(after, axis=1)) < limit, axis=1)
        height = np.where(calm, np.max(np.abs(change) / limit, axis=1), 0.0)
        while height.max() > 1.0:
            best = int(height.argmax())
            sample = first + round((places[best] + 0.5) * size)
            found.append(Step(float(samples.time[sample]), change[best]))
            height[max(best - SIDE, 0) : best + SIDE + 1] = 0.0
    return tuple(sorted(found, key=lambda s: s.time))


def find_drift(samples: Samples, rest: Index) -> Drift | None:
    """Fit a line to the longest part at rest; None if that is short.

    Parameters
    ----------
    samples : Samples
    rest : ndarray of int64, shape (k, 2)
        From ``at_rest``.
    """
    if not len(rest):
        return None
    first, last = rest[np.argmax(rest[:, 1] - rest[:, 0])]
    time = samples.time[first:last]
    duration = float(time[-1] - time[0])
    if duration < LONG:
        return None
    line = np.polyfit(time - time.mean(), spherical_deviations(samples.xyz[first:last]), 1)
    return Drift(duration, np.asarray(line[0] * duration))
