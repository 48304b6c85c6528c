# SPDX-License-Identifier: Apache-2.0
"""How long something will still take, from how far it has come."""

from __future__ import annotations

import math
import time

MIN_ELAPSED = 1.0
"""s; earlier nothing is said."""
MIN_FRACTION = 0.01
"""Fraction below which nothing is said."""


class TimeLeft:
    """Extrapolates the fraction that was reached since a job began, at its mean speed.

    Between two steps of the fraction the time is counted down.
    """

    def __init__(self) -> None:
        self._job: object = None
        self._began = 0.0
        self._first = self._last = 0.0
        self._end = math.nan

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
            s; NaN as long as there is nothing to judge by, and when it takes longer than that.
        """
        if job != self._job or fraction < self._first:
            self._job, self._began, self._end = job, now, math.nan
            self._first = self._last = fraction
        elapsed, done = now - self._began, fraction - self._first
        if fraction != self._last and elapsed >= MIN_ELAPSED and done >= MIN_FRACTION:
            self._last, self._end = fraction, now + elapsed * max(0.0, 1.0 - fraction) / done
        return self._end - now if self._end >= now else math.nan


def about(seconds: float) -> str:
    """A time that is not known exactly, in words; empty for NaN."""
    if not math.isfinite(seconds):
        return ''
    if seconds < 10:
        return f'about {math.ceil(seconds)} s left'
    if seconds < 90:
        return f'about {10 * math.ceil(seconds / 10)} s left'
    return f'about {seconds / 60:.0f} min left'


class StepsLeft:
    """Says after each of some steps, that take alike, how long the others will take."""

    def __init__(self, steps: int) -> None:
        self._steps, self._done, self._left = steps, 0, TimeLeft()
        self._left.estimate('steps', 0.0, time.monotonic())

    def after_one(self) -> str:
        """Count a step; ', about ... left' or nothing."""
        self._done += 1
        share = min(self._done / max(self._steps, 1), 1.0)
        words = about(self._left.estimate('steps', share, time.monotonic()))
        return f', {words}' if words and share < 1.0 else ''
