# SPDX-License-Identifier: Apache-2.0
"""How long something will still take, from how far it has come."""

from __future__ import annotations

import math

EARLIEST = 1.0
"""s; earlier nothing is said."""
LEAST = 0.01
"""Fraction below which nothing is said."""


class TimeLeft:
    """Extrapolates the fraction that was reached since a job began, at its mean speed."""

    def __init__(self) -> None:
        self._job: object = None
        self._began = 0.0
        self._first = 0.0

    def estimate(self, job: object, fraction: float, now: float) -> float:
        """Time until the fraction is 1.

        Parameters
        ----------
        job : object
            Whatever names it: another one begins anew, and so does a fraction that went back.
        fraction : float
            0 to 1.
        now : float
            s, monotonic.

        Returns
        -------
        float
            s; NaN as long as there is nothing to judge by.
        """
        if job != self._job or fraction < self._first:
            self._job, self._began, self._first = job, now, fraction
        elapsed, done = now - self._began, fraction - self._first
        if elapsed < EARLIEST or done < LEAST:
            return math.nan
        return elapsed * max(0.0, 1.0 - fraction) / done
