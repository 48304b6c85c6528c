# SPDX-License-Identifier: Apache-2.0
"""Offset and rate of a clock from packets that can only come late: a line beneath all of them.

A packet that says device time d arrives at host time a = d + offset + rate d + delay, delay >= 0.
So a - d lies on or above the line offset + rate d (Moon, Skelly, Towsley: Estimation and removal
of clock skew from network delay measurements, INFOCOM 1999). For delays with an exponential
distribution of unknown mean the likeliest rate minimises n log(mean delay above the highest line
beneath all points). The density of real delays rises from zero, so that the least of n is known
to one part in root n, not in n: root n log(mean) is minimised instead. Packets that are very late
do not move the mean, and what is known of the rate is added as a normal distribution: of quartz
clocks at first, of this clock later. That keeps the line quiet in the first seconds.

Where the host has started the clock itself, its zero lies between the command and its answer. That
bounds the line from both sides, as a packet that happens to be quick does from above. A tracker
takes as long to start each time, so what bounds one start bounds all later ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

USUAL_RATE = 20e-6
"""Standard deviation of the rate of quartz clocks; recorded trackers have 15 to 20 ppm."""
RATES = np.arange(-100e-6, 100.1e-6, 1e-6)
"""Rates that are tried."""

USUAL_DELAY = 1e6
"""ns; median delay of packets, as far as none have told."""
ASSUMED = 4
"""Packets that this counts as much as."""
VERY_LATE = 5.0
"""Medians; packets later than that count as if late by as much."""
SHARPEST = 1e4
"""ns; delays are not resolved better."""
LOWERED = 1.1
"""Mean of the least of n delays is this many medians, divided by the root of n: 1.25 for delays
whose density rises from zero, such as sums of the age of a packet's last sample and of its way,
less for those whose density does not."""

MILLISECOND = 1e6
"""ns"""
TELLING = 6e6
"""ns; bounds of the start that are further apart say nothing."""
WANDERS = 2e-6
"""A quartz that has been seen keeps its rate within this."""
UNSURE = 3.0
"""How much further off the least late packets may be than by what is usual, against the start."""
MANY, DOUBTED = 10, 5e6
"""Packets that are all late, after the answer to a start, by more than they may be, show that the
tracker has started after it; fewer that are late by so many ns let one doubt."""
MOST_LOWERED = 3e6
"""ns; for few packets, some of them very late."""


@dataclass(frozen=True)
class ClockPrior:
    """What is known of a clock before its packets.

    Attributes
    ----------
    rate : float
        Host seconds per device second, less one.
    u_rate : float
        Its standard uncertainty.
    delay : float, ns
        Median delay of packets.
    floor : int or None, ns
        Host time before which the clock did not show zero; None if nobody knows.
    ceiling : int or None, ns
        Host time after which it did not, as far as the packets do not contradict.
    """

    rate: float = 0.0
    u_rate: float = USUAL_RATE
    delay: float = USUAL_DELAY
    floor: int | None = None
    ceiling: int | None = None


NOTHING = ClockPrior()


@dataclass(frozen=True)
class Line:
    """Host minus device time as a line over device time; nanoseconds stay integers.

    Attributes
    ----------
    origin : int, ns
        Device time at which the difference is ``base``.
    base : int, ns
    rate : float
        Host seconds per device second, less one.
    u_rate : float
        Standard uncertainty of the rate.
    u_base : float, ns
        Standard uncertainty of ``base``.
    bound : float, ns
        ``base`` cannot be off by more; infinite if nothing bounds it from both sides.
    started : float, ns
        So long after the command to start the clock showed zero at the latest; infinite if
        unknown.
    """

    origin: int
    base: int
    rate: float
    u_rate: float = 0.0
    u_base: float = 0.0
    bound: float = math.inf
    started: float = math.inf

    def at(self, device_ns: NDArray[np.int64] | int) -> NDArray[np.int64]:
        """Host minus device time at these device times, ns."""
        drift = self.rate * (np.asarray(device_ns) - self.origin)
        return np.asarray(self.base + np.rint(drift).astype(np.int64))

    def ahead(self, step_ns: int) -> Line:
        """Return the same of a clock that is ahead of this one by a step."""
        return replace(self, origin=self.origin + step_ns, base=self.base - step_ns)


def lower_line(
    device_ns: NDArray[np.int64], delay_ns: NDArray[np.int64], known: ClockPrior = NOTHING
) -> Line:
    """Return the likeliest line beneath all points.

    Parameters
    ----------
    device_ns : ndarray of int64, shape (n,), ns
        Increasing.
    delay_ns : ndarray of int64, shape (n,), ns
        Arrival minus device time.

    Returns
    -------
    Line
        Lowered by what the least of n delays exceeds zero on average.
    """
    origin, base, n = int(device_ns[-1]), int(delay_ns[-1]), len(device_ns)
    x, y = (device_ns - origin).astype(float), (delay_ns - base).astype(float)
    above = y - RATES[:, None] * x
    least = above.min(axis=1)
    above -= least[:, None]
    median = np.median(above, axis=1)
    mean = np.minimum(above, VERY_LATE * median[:, None]).mean(axis=1)
    cost = (
        math.sqrt(n) * np.log(mean + SHARPEST) + 0.5 * ((RATES - known.rate) / known.u_rate) ** 2
    )
    delay = (n * median + ASSUMED * known.delay) / (n + ASSUMED)
    u = np.minimum(LOWERED * delay / math.sqrt(n), MOST_LOWERED)
    offset, drift = least - u, RATES * origin
    zero, late = (float(np.interp(known.rate, RATES, v)) for v in (least - drift, UNSURE * u))
    start = _start(known, base, zero, late if n >= MANY else math.inf)
    if start:
        u_start = math.hypot((start[1] - start[0]) / math.sqrt(12), WANDERS * origin)
        apart = offset - (sum(start) / 2 + drift)
        u = UNSURE * u
        both = u**2 + u_start**2
        cost += 0.5 * apart**2 / both
        offset, u = offset - apart * u**2 / both, u * u_start / np.sqrt(both)
    likely = np.exp(cost.min() - cost)
    likely /= likely.sum()
    rate, best, u_best = (float(likely @ v) for v in (RATES, offset, u))
    u_rate = math.sqrt(float(likely @ (RATES - rate) ** 2))
    bound = started = math.inf
    if start:
        unsure, drifted, touched = u_rate * origin, rate * origin, float(likely @ least)
        started = touched - drifted + UNSURE * unsure - start[0]
        lowest, highest = start[0] + drifted - unsure, start[1] + drifted + unsure
        best = _between(lowest, min(highest, touched), best)
        bound = max(best - lowest, highest - best)
        bound = touched - lowest if touched - highest > DOUBTED else bound
    return Line(origin, base + round(best), rate, u_rate, u_best, bound, started)


def _start(
    known: ClockPrior, base: int, highest: float, exceeding: float
) -> tuple[float, float] | None:
    """Return between which offsets the clock has started, ns from ``base``; None if unknown.

    ``highest`` is that of the highest line beneath all packets, at zero; a ceiling that it exceeds
    by more than ``exceeding`` does not hold.
    """
    if known.floor is None or known.floor - base >= highest:
        return None
    lowest, ceiling = float(known.floor - base), highest
    if known.ceiling is not None and known.ceiling - base < highest:
        contradicted = highest - exceeding > known.ceiling - base
        ceiling = highest if contradicted else float(known.ceiling - base)
    return (lowest, ceiling) if ceiling - lowest < TELLING else None


def _between(lowest: float, highest: float, offset: float) -> float:
    """Keep an estimate between its bounds, and the nearer to their middle the closer they are.

    Bounds up to 2 ms apart then leave an error of at most 1 ms, also if every packet is late by
    more than the estimate knows.
    """
    if lowest >= highest:
        return highest
    half = (highest - lowest) / 2
    slack = MILLISECOND - half if half < MILLISECOND else 1.5 * (half - MILLISECOND)
    middle = (lowest + highest) / 2
    return min(max(offset, middle - slack, lowest), middle + slack, highest)
