# SPDX-License-Identifier: Apache-2.0
"""A short path that shows what drifts most, to check whether tables still hold.

A walk through a small lattice of the volume. Each step takes the line that adds most per second
to what a tracker sees of the drift: the part of the drift field across the lines driven that no
rigid motion explains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.history.judged import History
from otf_core.history.series import Series
from otf_core.model.evaluation import lattice, rigid_columns
from otf_core.model.path import NominalPath
from otf_core.planning.forecast import leg_time

LEVELS = 3
"""Lattice points per axis."""
SAMPLES = 12
"""Points at which a line is looked at."""
FEED, ACCELERATION, DWELL = 0.25, 2.0, 0.2
"""m/s, m/s^2, s; as the planner and the simulator take them."""
RIGID_ALONE = 1e-3
"""Weight of what rigid motion still explains: it decides while too few lines are driven."""
AGAIN = 0.25
"""A line that was driven counts less when driven again."""


@dataclass(frozen=True)
class _Seen:
    """Normal equations of the rigid motion for a set of lines, and the squared drift across."""

    matrix: Array
    right: Array
    square: float

    def __add__(self, other: _Seen) -> _Seen:
        return _Seen(
            self.matrix + other.matrix, self.right + other.right, self.square + other.square
        )

    @property
    def worth(self) -> float:
        """What a tracker sees of the drift."""
        explained = self.right @ np.linalg.pinv(self.matrix, rcond=1e-9) @ self.right
        return float(self.square - explained + RIGID_ALONE * self.square)

    def times(self, weight: float) -> _Seen:
        """The same counted with a weight."""
        return _Seen(weight * self.matrix, weight * self.right, weight * self.square)


def drifting(history: History) -> tuple[Array, str]:
    """What the path is to show: vector of the series, and words.

    The drift since the last event if it is significant; else the errors themselves, since what is
    large has the most room to change.
    """
    if history.drift is not None and history.drift.significant:
        return history.drift.rate, 'the drift since the last event'
    return history.series.values[-1], 'the errors themselves: no drift is seen'


def _line(series: Series, vector: Array, start: Array, end: Array) -> _Seen:
    share = (np.arange(SAMPLES)[:, None] + 0.5) / SAMPLES
    q = start + share * (end - start)
    unit = (end - start) / np.linalg.norm(end - start)
    across = np.eye(3) - np.outer(unit, unit)
    drift = (series.rows(q) @ vector) @ across
    rigid = np.einsum('ij,njk->nik', across, rigid_columns(q))
    length = float(np.linalg.norm(end - start)) / SAMPLES
    return _Seen(
        length * np.einsum('nci,ncj->ij', rigid, rigid),
        length * np.einsum('nci,nc->i', rigid, drift),
        length * float(np.sum(drift**2)),
    )


def interim_path(history: History, seconds: float = 120.0) -> NominalPath:
    """Choose the path.

    Parameters
    ----------
    history : History
    seconds : float
        Driving time at the planner's usual feed, dwells at the corners included.
    """
    series = history.series
    vector, _ = drifting(history)
    points = lattice(series.common.machine, LEVELS)
    here, path, seen, left = 0, [0], None, seconds
    driven, lines = dict[tuple[int, int], int](), dict[tuple[int, int], _Seen]()
    while True:
        best: tuple[float, int, float, _Seen] | None = None
        for there in range(len(points)):
            length = np.array([np.linalg.norm(points[there] - points[here])])
            if there == here:
                continue
            time = float(leg_time(length, np.array([FEED]), ACCELERATION)[1][0]) + DWELL
            if time > left:
                continue
            pair = min(here, there), max(here, there)
            if pair not in lines:
                lines[pair] = _line(series, vector, points[here], points[there])
            line = lines[pair].times(AGAIN ** driven.get(pair, 0))
            total = line if seen is None else seen + line
            gain = (total.worth - (0.0 if seen is None else seen.worth)) / time
            if best is None or gain > best[0]:
                best = gain, there, time, total
        if best is None:
            return NominalPath(points[np.array(path)])
        _, there, time, seen = best
        pair = min(here, there), max(here, there)
        driven[pair] = driven.get(pair, 0) + 1
        left -= time
        here = there
        path.append(there)
