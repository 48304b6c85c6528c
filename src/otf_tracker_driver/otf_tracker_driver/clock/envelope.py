# SPDX-License-Identifier: Apache-2.0
"""Offset and rate of a clock from packets that can only come late: a line beneath all of them.

A packet that says device time d arrives at host time a = d + offset + rate d + delay, delay >= 0.
So a - d lies on or above the line offset + rate d (Moon, Skelly, Towsley: Estimation and removal
of clock skew from network delay measurements, INFOCOM 1999). For delays with an exponential
distribution of unknown mean the likeliest rate minimises n log(mean delay above the highest line
beneath all points); the mean is taken from the median, which packets that are very late do not
move, and what is known of quartz clocks is added as a normal distribution of the rate. That keeps
the line quiet in the first seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

USUAL_RATE = 20e-6
"""Standard deviation of the rate of quartz clocks; recorded trackers have 15 to 20 ppm."""
RATES = np.arange(-100e-6, 100.1e-6, 1e-6)
"""Rates that are tried."""


SHARPEST = 1e4
"""ns; delays are not resolved better."""
LOWERED = 1.1
"""Mean of the least of n delays is this many medians, divided by the root of n: 1.25 for delays
whose density rises from zero, such as sums of the age of a packet's last sample and of its way,
less for those whose density does not."""

MOST_LOWERED = 3e6
"""ns; for few packets, some of them very late."""


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
    """

    origin: int
    base: int
    rate: float

    def at(self, device_ns: NDArray[np.int64] | int) -> NDArray[np.int64]:
        """Host minus device time at these device times, ns."""
        drift = self.rate * (np.asarray(device_ns) - self.origin)
        return np.asarray(self.base + np.rint(drift).astype(np.int64))


def beneath(device_ns: NDArray[np.int64], delay_ns: NDArray[np.int64]) -> Line:
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
    origin, base, n = int(device_ns[0]), int(delay_ns[0]), len(device_ns)
    x, y = (device_ns - origin).astype(float), (delay_ns - base).astype(float)
    above = y - RATES[:, None] * x
    least = above.min(axis=1)
    median = np.median(above, axis=1) - least
    cost = n * np.log(median + SHARPEST) + 0.5 * (RATES / USUAL_RATE) ** 2
    best = int(cost.argmin())
    lowered = min(LOWERED * float(median[best]) / math.sqrt(n), MOST_LOWERED)
    return Line(origin, base + round(float(least[best]) - lowered), float(RATES[best]))
