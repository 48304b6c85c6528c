# SPDX-License-Identifier: Apache-2.0
"""Whether the latest tables still hold: a short path to check it, and the verdict on its run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.history.control_chart import History
from otf_core.history.store import Series
from otf_core.model.evaluation import lattice, rigid_columns
from otf_core.model.kinematics import displacement
from otf_core.model.path import NominalPath, leg_bounds
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.planning.forecast import leg_time
from otf_core.tracking.alignment import line_step

# A short path that shows what drifts most, to check whether tables still hold.
#
# A walk through a small lattice of the volume. Each step takes the line that adds most per second
# to what a tracker sees of the drift: the part of the drift field across the lines driven that no
# rigid motion explains.

LEVELS = 3
"""Lattice points per axis."""
POINTS_PER_LINE = 12
"""Points at which a line is looked at."""
FEED, ACCELERATION, DWELL = 0.25, 2.0, 0.2
"""m/s, m/s^2, s; as the planner and the simulator take them."""
RIGID_ALONE = 1e-3
"""Weight of what rigid motion still explains: it decides while too few lines are driven."""
REPEATED_WEIGHT = 0.25
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
    return history.series.values[-1], 'the errors themselves: no significant drift'


def _line(series: Series, vector: Array, start: Array, end: Array) -> _Seen:
    share = (np.arange(POINTS_PER_LINE)[:, None] + 0.5) / POINTS_PER_LINE
    q = start + share * (end - start)
    unit = (end - start) / np.linalg.norm(end - start)
    across = np.eye(3) - np.outer(unit, unit)
    drift = (series.rows(q) @ vector) @ across
    rigid = np.einsum('ij,njk->nik', across, rigid_columns(q))
    length = float(np.linalg.norm(end - start)) / POINTS_PER_LINE
    return _Seen(
        length * np.einsum('nci,ncj->ij', rigid, rigid),
        length * np.einsum('nci,nc->i', rigid, drift),
        length * float(np.sum(drift**2)),
    )


def interim_path(history: History, seconds: float = 120.0) -> NominalPath:
    """Choose the path.

    Parameters
    ----------
    seconds : float
        Driving time at the planner's usual feed, dwells at the corners included.
    """
    series = history.series
    vector, _ = drifting(history)
    points = lattice(series.common.machine, LEVELS)
    here, path, seen, remaining_time = 0, [0], None, seconds
    driven, lines = dict[tuple[int, int], int](), dict[tuple[int, int], _Seen]()
    while True:
        best: tuple[float, int, float, _Seen] | None = None
        for there in range(len(points)):
            length = np.array([np.linalg.norm(points[there] - points[here])])
            if there == here:
                continue
            time = float(leg_time(length, np.array([FEED]), ACCELERATION)[1][0]) + DWELL
            if time > remaining_time:
                continue
            pair = min(here, there), max(here, there)
            if pair not in lines:
                lines[pair] = _line(series, vector, points[here], points[there])
            line = lines[pair].times(REPEATED_WEIGHT ** driven.get(pair, 0))
            total = line if seen is None else seen + line
            gain = (total.worth - (0.0 if seen is None else seen.worth)) / time
            if best is None or gain > best[0]:
                best = gain, there, time, total
        if best is None:
            return NominalPath(points[np.array(path)])
        _, there, time, seen = best
        pair = min(here, there), max(here, there)
        driven[pair] = driven.get(pair, 0) + 1
        remaining_time -= time
        here = there
        path.append(there)


# Whether the latest tables hold: a short run is aligned, compensated, and what is left judged.
#
# Of every line the mean deviation across it is compared with what tables and tracker let expect:
# covariance of the tables at the line, noise of the run averaged over it.

ITERATIONS = 6
HOLDING_RATIO = 1.25
"""Tables hold if the mean deviations of the lines are no larger than so many times expected."""


@dataclass(frozen=True)
class InterimCheck:
    """What a run says of tables.

    Attributes
    ----------
    left, expected : float
        m; root mean square of the mean deviation of a line across it, found and expected if the
        tables hold.
    """

    lines: int
    left: float
    expected: float

    @property
    def ratio(self) -> float:
        """Found over expected."""
        return self.left / self.expected

    @property
    def holds(self) -> bool:
        """Return whether the tables still hold."""
        return self.ratio <= HOLDING_RATIO

    @property
    def words(self) -> str:
        """One line."""
        verdict = 'the tables still hold' if self.holds else 'the tables no longer hold'
        return (
            f'{verdict}: mean deviation of {self.lines} lines {1e6 * self.left:.2f} um, '
            f'{1e6 * self.expected:.2f} um expected ({self.ratio:.1f} times; up to '
            f'{HOLDING_RATIO} is chance)'
        )


def _residuals(run: Run, series: Series) -> tuple[Array, Array]:
    """Positions and deviations across the lines, compensated and aligned anew, (p, 3), m."""
    tables = series.runs[-1].content.tables
    pieces, pose = run.pieces, run.pose
    weight, own = pieces.count.astype(float), np.arange(len(pieces))
    for _ in range(ITERATIONS):
        points = pose.apply(pieces.xyz)
        away = points - pieces.origin
        along = np.einsum('ij,ij->i', away, pieces.direction)[:, None] * pieces.direction
        q = pieces.origin + along
        residual = points - displacement(tables, q)
        pose = pose.moved_by(*line_step(residual, pieces.origin, pieces.direction, weight, own))
    off = residual - pieces.origin
    return q, off - np.einsum('ij,ij->i', off, pieces.direction)[:, None] * pieces.direction


def _noise_variance(run: Run, rows: slice, across: Array) -> float:
    """Variance across a line of the mean of its samples, both directions together, m^2."""
    beam = run.pieces.xyz[rows].mean(axis=0)
    distance = float(np.linalg.norm(beam))
    duration = float(run.pieces.duration[rows].sum())
    count = float(run.pieces.count[rows].sum())
    variances = []
    for component, reach in zip(run.noise, (1.0, distance, distance), strict=True):
        slow = min(1.0, 2.0 * component.correlation_time / max(duration, 1e-9))
        variances.append(reach**2 * (component.white**2 / count + component.slow**2 * slow))
    unit = across @ (run.pose.rotation @ beam) / distance
    along = float(unit @ unit)  # share of the beam that points across the line
    return variances[0] * along + max(variances[1:]) * (2.0 - along)


def interim_check(recording: Recording, series: Series) -> InterimCheck:
    """Judge the latest tables of a series by a run.

    Parameters
    ----------
    recording : Recording
        Of the same machine and target offset.

    Raises
    ------
    InputError
        If samples and path do not belong together.
    """
    (run, *_), _ = prepare_runs([recording], CalibrationConfig())
    q, off = _residuals(run, series)
    residuals, noise, tables, rigid = [], [], [], []
    for first, last in leg_bounds(run.pieces.leg):
        part = slice(first, last)
        unit = run.pieces.direction[first]
        across = np.eye(3) - np.outer(unit, unit)
        residuals.append(float(np.sum(off[part].mean(axis=0) ** 2)))
        noise.append(_noise_variance(run, part, across))
        tables.append(across @ series.rows(q[part]).mean(axis=0))
        rigid.append(across @ rigid_columns(q[part]).mean(axis=0))
    # the alignment takes up what of the tables' errors is a rigid motion
    basis = np.linalg.qr(np.concatenate(rigid))[0]
    rows = np.concatenate(tables)
    rows -= basis @ (basis.T @ rows)
    unsure = float(np.einsum('ij,jk,ik->', rows, series.covariances[-1], rows)) / len(residuals)
    free = 1.0 - basis.shape[1] / (2.0 * len(residuals))
    expected = unsure + free * float(np.mean(noise))
    return InterimCheck(
        len(residuals), float(np.sqrt(np.mean(residuals))), float(np.sqrt(expected))
    )
