# SPDX-License-Identifier: Apache-2.0
"""The drive: programmed positions over time, trapezoidal speed, exact stop at every corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.model.plan import Plan


class Drive:
    """Programmed motion of one plan.

    Parameters
    ----------
    acceleration : float
        m/s^2, along the path.
    """

    def __init__(self, plan: Plan, acceleration: float) -> None:
        length = plan.path.leg_lengths
        self._plan = plan
        self._acceleration = acceleration
        self._peak = np.minimum(plan.feed, np.sqrt(length * acceleration))
        moving = np.divide(length, self._peak, out=np.zeros_like(length), where=self._peak > 0)
        moving += self._peak / acceleration
        stops = np.cumsum(plan.dwell[:-1] + np.concatenate([[0.0], moving[:-1]]))
        self._start = stops
        self._moving = moving
        self.duration = float(stops[-1] + moving[-1] + plan.dwell[-1])

    def position(self, time: Array) -> Array:
        """Programmed position.

        Parameters
        ----------
        time : ndarray, shape (n,), s
            Since the start of the first dwell.

        Returns
        -------
        ndarray, shape (n, 3), m
        """
        leg, elapsed = self._departed(time)
        travelled = self._travelled(leg, elapsed)
        path = self._plan.path
        return np.asarray(path.points[leg] + travelled[:, None] * path.directions[leg])

    def leg_and_speed(self, time: Array) -> tuple[NDArray[np.int64], Array]:
        """Which leg is driven how fast.

        Parameters
        ----------
        time : ndarray, shape (n,), s

        Returns
        -------
        leg : ndarray of int64, shape (n,)
            Leg of the plan; while standing the one just driven, at the start the first.
        speed : ndarray, shape (n,), m/s
            Along the path.
        """
        leg, elapsed = self._departed(time)
        ramp = np.minimum(elapsed, self._moving[leg] - elapsed)
        return leg, np.minimum(self._peak[leg], self._acceleration * ramp)

    def _departed(self, time: Array) -> tuple[NDArray[np.int64], Array]:
        leg = np.clip(np.searchsorted(self._start, time, side='right') - 1, 0, None)
        return leg, np.clip(time - self._start[leg], 0.0, self._moving[leg])

    def _travelled(self, leg: NDArray[np.int64], elapsed: Array) -> Array:
        peak, acceleration = self._peak[leg], self._acceleration
        ramp = peak / acceleration
        remaining = self._moving[leg] - elapsed
        length = self._plan.path.leg_lengths[leg]
        return np.select(
            [elapsed < ramp, remaining < ramp],
            [0.5 * acceleration * elapsed**2, length - 0.5 * acceleration * remaining**2],
            peak * (elapsed - 0.5 * ramp),
        )
