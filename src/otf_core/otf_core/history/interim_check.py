# SPDX-License-Identifier: Apache-2.0
"""Whether the latest tables hold: a short run is aligned, compensated, and what is left judged.

Of every line the mean deviation across it is compared with what tables and tracker let expect:
covariance of the tables at the line, noise of the run averaged over it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.history.series import Series
from otf_core.model.evaluation import rigid_columns
from otf_core.model.kinematics import displacement
from otf_core.model.path import leg_bounds
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.tracking.line_step import line_step

ITERATIONS = 6
HOLDS = 1.25
"""Tables hold if the mean deviations of the lines are no larger than so many times expected."""


@dataclass(frozen=True)
class InterimCheck:
    """What a run says of tables.

    Attributes
    ----------
    lines : int
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
        """Tell whether the tables still hold."""
        return self.ratio <= HOLDS

    @property
    def words(self) -> str:
        """One line."""
        verdict = 'the tables still hold' if self.holds else 'the tables no longer hold'
        return (
            f'{verdict}: mean deviation of {self.lines} lines {1e6 * self.left:.2f} um, '
            f'{1e6 * self.expected:.2f} um expected ({self.ratio:.1f} times; up to {HOLDS} is '
            f'chance)'
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
        left = points - displacement(tables, q)
        pose = pose.moved_by(*line_step(left, pieces.origin, pieces.direction, weight, own))
    off = left - pieces.origin
    return q, off - np.einsum('ij,ij->i', off, pieces.direction)[:, None] * pieces.direction


def _noise_variance(run: Run, rows: slice, across: Array) -> float:
    """Variance across a line of the mean of its samples, both directions together, m^2."""
    beam = run.pieces.xyz[rows].mean(axis=0)
    distance = float(np.linalg.norm(beam))
    duration = float(run.pieces.duration[rows].sum())
    count = float(run.pieces.count[rows].sum())
    found = []
    for component, reach in zip(run.noise, (1.0, distance, distance), strict=True):
        slow = min(1.0, 2.0 * component.correlation_time / max(duration, 1e-9))
        found.append(reach**2 * (component.white**2 / count + component.slow**2 * slow))
    unit = across @ (run.pose.rotation @ beam) / distance
    along = float(unit @ unit)  # share of the beam that points across the line
    return found[0] * along + max(found[1:]) * (2.0 - along)


def interim_check(recording: Recording, series: Series) -> InterimCheck:
    """Judge the latest tables of a series by a run.

    Parameters
    ----------
    recording : Recording
        Of the same machine and target offset.
    series : Series

    Raises
    ------
    InputError
        If samples and path do not belong together.
    """
    (run, *_), _ = prepare_runs([recording], CalibrationConfig())
    q, off = _residuals(run, series)
    left, noise, tables, rigid = [], [], [], []
    for first, last in leg_bounds(run.pieces.leg):
        part = slice(first, last)
        unit = run.pieces.direction[first]
        across = np.eye(3) - np.outer(unit, unit)
        left.append(float(np.sum(off[part].mean(axis=0) ** 2)))
        noise.append(_noise_variance(run, part, across))
        tables.append(across @ series.rows(q[part]).mean(axis=0))
        rigid.append(across @ rigid_columns(q[part]).mean(axis=0))
    # the alignment takes up what of the tables' errors is a rigid motion
    basis = np.linalg.qr(np.concatenate(rigid))[0]
    rows = np.concatenate(tables)
    rows -= basis @ (basis.T @ rows)
    unsure = float(np.einsum('ij,jk,ik->', rows, series.covariances[-1], rows)) / len(left)
    free = 1.0 - basis.shape[1] / (2.0 * len(left))
    expected = unsure + free * float(np.mean(noise))
    return InterimCheck(len(left), float(np.sqrt(np.mean(left))), float(np.sqrt(expected)))
