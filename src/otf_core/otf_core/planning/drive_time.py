# SPDX-License-Identifier: Apache-2.0
"""When the machine is where on a plan: trapezoidal speed, exact stop and dwell at every corner.

t(s) on a leg of length L with peak speed v and acceleration a: sqrt(2 s / a) while speeding up,
s / v + v / (2 a) at constant speed, mirrored while slowing down; v = min(feed, sqrt(a L)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.model.plan import Plan


@dataclass(frozen=True)
class DriveTimes:
    """Timing of every leg.

    Attributes
    ----------
    length, peak, moving : ndarray, shape (n,), m, m/s, s
        Length, highest speed and driving time of each leg.
    start : ndarray, shape (n,), s
        Departure, counted from the start of the first dwell.
    acceleration : float
        m/s^2.
    duration : float
        s, all dwells included.
    """

    length: Array
    peak: Array
    moving: Array
    start: Array
    acceleration: float
    duration: float

    def at(self, leg: int, along: Array) -> Array:
        """Time since departure at positions along a leg.

        Parameters
        ----------
        leg : int
        along : ndarray, shape (k,), m
            From the start of the leg.

        Returns
        -------
        ndarray, shape (k,), s
        """
        peak, a = self.peak[leg], self.acceleration
        ramp = 0.5 * peak**2 / a
        left = self.length[leg] - along
        return np.asarray(
            np.select(
                [along < ramp, left < ramp],
                [
                    np.sqrt(2 * np.maximum(along, 0.0) / a),
                    self.moving[leg] - np.sqrt(2 * np.maximum(left, 0.0) / a),
                ],
                along / peak + 0.5 * peak / a,
            )
        )


def leg_time(length: Array, feed: Array, acceleration: float) -> tuple[Array, Array]:
    """Highest speed (m/s) and driving time (s) of legs that start and end at standstill."""
    peak = np.minimum(feed, np.sqrt(length * acceleration))
    moving = np.divide(length, peak, out=np.zeros_like(length), where=peak > 0)
    return peak, moving + peak / acceleration


def drive_times(plan: Plan, acceleration: float) -> DriveTimes:
    """Time every leg of a plan.

    Parameters
    ----------
    plan : Plan
    acceleration : float
        m/s^2, along the path.
    """
    length = plan.path.leg_lengths
    peak, moving = leg_time(length, plan.feed, acceleration)
    start = np.cumsum(plan.dwell[:-1] + np.concatenate([[0.0], moving[:-1]]))
    duration = float(start[-1] + moving[-1] + plan.dwell[-1])
    return DriveTimes(length, peak, moving, start, acceleration, duration)
