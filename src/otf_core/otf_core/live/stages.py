# SPDX-License-Identifier: Apache-2.0
"""Stages of long jobs and their shares of the time, so that one number says how far a job is."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Progress = Callable[[str, float], None]
"""Takes what is being done, and the share of it, or of the whole, that is done."""


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
