# SPDX-License-Identifier: Apache-2.0
"""Stages of long jobs and their shares of the time; how long a job will still take."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

# Stages of long jobs and their shares of the time, so that one number says how far a job is.

Progress = Callable[[str, float], None]
"""Takes the name of a stage, and the share of it, or of the whole job, that is done."""


def silent(stage: str, share: float) -> None:
    """Tell nobody how far the work has come."""


CALIBRATE = {
    'reading': (0.0, 0.05),
    'aligning': (0.05, 0.3),
    'solving': (0.3, 0.85),
    'writing': (0.85, 1.0),
}
DIAGNOSE = {
    'reading': (0.0, 0.0),
    'aligning': (0.0, 0.05),
    'solving': (0.05, 0.25),
    'diagnosing': (0.25, 0.85),
    'correcting': (0.85, 0.95),
    'writing': (0.95, 1.0),
}
SIMULATE = {'simulating': (0.0, 0.6), 'writing': (0.6, 1.0)}
PLAN = {
    'choosing lines': (0.0, 0.4),
    'forecasting': (0.4, 0.5),
    'looking for effects': (0.5, 0.95),
    'writing': (0.95, 1.0),
}
"""Begin and end of the stages as shares of the time."""


def of_whole(spans: Mapping[str, tuple[float, float]], progress: Progress) -> Progress:
    """Turn shares of stages into shares of the whole.

    Parameters
    ----------
    spans : mapping of stage to (begin, end)
        A stage that is not in it counts as the beginning.
    progress : callable(stage, share of the whole)

    Returns
    -------
    callable(stage, share of the stage)
        What it tells never goes back: stages that come again have been counted.
    """
    reached = 0.0

    def tell(stage: str, fraction: float) -> None:
        nonlocal reached
        low, high = spans.get(stage, (0.0, 0.0))
        reached = max(reached, low + fraction * (high - low))
        progress(stage, reached)

    return tell


# How long something will still take, from how far it has come.

MIN_ELAPSED = 1.0
"""s; earlier nothing is stated."""
MIN_FRACTION = 0.01
"""Fraction below which nothing is stated."""


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
        elapsed, progress = now - self._began, fraction - self._first
        if fraction != self._last and elapsed >= MIN_ELAPSED and progress >= MIN_FRACTION:
            self._last, self._end = fraction, now + elapsed * max(0.0, 1.0 - fraction) / progress
        return self._end - now if self._end >= now else math.nan


def approximate_time(seconds: float) -> str:
    """A time that is not known exactly, in words; empty for NaN."""
    if not math.isfinite(seconds):
        return ''
    if seconds < 10:
        return f'about {math.ceil(seconds)} s left'
    if seconds < 90:
        return f'about {10 * math.ceil(seconds / 10)} s left'
    return f'about {seconds / 60:.0f} min left'


class StepProgress:
    """Says after each of some steps, that take alike, how long the others will take."""

    def __init__(self, steps: int) -> None:
        self._steps, self._done, self._left = steps, 0, TimeLeft()
        self._left.estimate('steps', 0.0, time.monotonic())

    def after_one(self) -> str:
        """Count a step; ', about ... left' or nothing."""
        self._done += 1
        share = min(self._done / max(self._steps, 1), 1.0)
        words = approximate_time(self._left.estimate('steps', share, time.monotonic()))
        return f', {words}' if words and share < 1.0 else ''
