# SPDX-License-Identifier: Apache-2.0
"""When the legs of a path began: what a start wakes keeps its phase from then on.

A drive that leaves a stop with the acceleration a has gone s = a (t - t_0)^2 / 2 after t_0, so the
root of s is a line in time, and t_0 where it is zero. A drive with limited jerk leaves it a little
later, alike on all legs, which no phase sees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.tracking.curves import Lines
from otf_core.tracking.matching import OFF_PATH

SHORT, LONG = 2e-5, 5e-3
"""m; stretch of a leg whose samples show when it began."""
REST_BEFORE_START = (0.25, 0.05)
"""s before a leg is seen to move, between which the target stands."""
MAX_SPREAD_AT_REST = 2e-5
"""m; by which samples of a target at rest differ at most."""
MIN_TRAVEL = 1e-3
"""m from the start of a leg from which it is seen to move."""
MAX_TIME_OF_START = 0.3
"""s; longest time for the stretch."""


def leg_starts(
    samples: Samples, pose: RigidTransform, leg: NDArray[np.int32], lines: Lines
) -> Array:
    """Times at which legs began from rest, shape (m,), s; NaN where that is not seen.

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine.
    leg : ndarray of int32, shape (n,)
        Of every sample, ``OFF_PATH`` where there is none.
    """
    moments, own = np.full(len(lines.length), np.nan), lines.seen_from(pose)
    first = np.flatnonzero((np.diff(leg, prepend=OFF_PATH) != 0) & (leg != OFF_PATH))
    last = np.append(first[1:], len(leg))
    for low, high in zip(first.tolist(), last.tolist(), strict=True):
        number = int(leg[low])
        corner, unit = own.corners[number], own.unit[number]
        moves = np.flatnonzero((samples.xyz[low:high] - corner) @ unit > MIN_TRAVEL)
        if len(moves):
            moments[number] = _start(samples, corner, unit, low + int(moves[0]))
    return moments


def _start(samples: Samples, corner: Array, unit: Array, first: int) -> float:
    """When a leg in the frame of the tracker began, seen to move from a sample on."""
    stamp = samples.stamp_ns
    low, high = (
        stamp[first] - round(1e9 * REST_BEFORE_START[0]),
        stamp[first] + round(1e9 * MAX_TIME_OF_START),
    )
    a, b = np.searchsorted(stamp, [low, high]).tolist()
    at = (stamp[a:b] - stamp[0]) * 1e-9
    gone = (samples.xyz[a:b] - corner) @ unit
    stands = at < at[first - a] - REST_BEFORE_START[1]
    if stands.sum() < 2 or np.ptp(gone[stands]) > MAX_SPREAD_AT_REST:
        return np.nan
    way = gone - np.median(gone[stands])
    use = ~stands & (way > SHORT) & (way < LONG)
    use &= np.cumsum(~use & ~stands & (way > LONG)) == 0
    if use.sum() < 2:
        return np.nan
    time, root = at[use] - at[first - a], np.sqrt(way[use])
    late = time - time.mean()
    slope = float(late @ root) / float(late @ late)
    return float(at[first - a] + time.mean() - root.mean() / slope) if slope > 0.0 else np.nan
