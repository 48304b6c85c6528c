# SPDX-License-Identifier: Apache-2.0
"""Calibrations of one machine in one convention: vectors over time with their covariances.

A vector holds the motions that all runs know, at their common positions (see
``comparison.convention``), then C0Y, B0Z, A0Z: with the slopes that the convention takes out of
the motions of a run, so that the vector is the errors that the run knows but for a rigid motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import GRID, source_of_tables
from otf_core.comparison.convention import (
    Common,
    Source,
    common_ground,
    operator,
    vector_rows,
)
from otf_core.history.store import StoredRun
from otf_core.model.evaluation import free_rows
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.uncertainty import prediction_rows

DAY = 86400.0
NEAR = 1e-3
"""m; target offsets that differ by less count as one: of 100 urad that is 0.1 um."""


@dataclass(frozen=True)
class Series:
    """Runs of one machine.

    Attributes
    ----------
    runs : tuple of StoredRun
        In the order of time.
    common : Common
    values : ndarray, shape (r, m), m or rad
    covariances : ndarray, shape (r, m, m)
    """

    runs: tuple[StoredRun, ...]
    common: Common
    values: Array
    covariances: Array

    @property
    def days(self) -> Array:
        """Time of the runs, days since the first, shape (r,)."""
        first = self.runs[0].at
        return np.array([(run.at - first).total_seconds() / DAY for run in self.runs])

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Place of every motion and squareness error in the vectors."""
        parts, start = {}, 0
        for motion in self.common.motions:
            stop = start + len(self.common.position[motion.axis])
            parts[str(motion)] = slice(start, stop)
            start = stop
        for k, name in enumerate(SQUARENESS):
            parts[name] = slice(start + k, start + k + 1)
        return parts

    @property
    def warnings(self) -> list[str]:
        """Runs that cannot be brought to the target offset of the latest, in words."""
        offset = self.common.machine.target_offset
        words = []
        for run in self.runs:
            tables = run.content.tables
            unseen = [m for m in self.common.folded if not tables.motions[m].identifiable]
            if unseen and not np.allclose(tables.machine.target_offset, offset, atol=NEAR):
                words.append(
                    f'the run {run.name} of {run.at:%Y-%m-%d} was measured with the target '
                    f'offset {_millimetres(tables.machine.target_offset)}, the latest run with '
                    f'{_millimetres(offset)}: {", ".join(unseen)}, which it did not see, act '
                    f'there as other translations; what seems to have changed may be the target '
                    f'alone'
                )
        return words

    @cached_property
    def grid(self) -> Array:
        """Lattice over the common range, shape (n, 3), m."""
        return _grid(self.common)

    @cached_property
    def field_rows(self) -> Array:
        """From a vector to the errors on the grid without rigid motion, shape (3 n, m)."""
        return free_rows(self.rows(self.grid).reshape(3 * len(self.grid), -1), self.grid)

    def rows(self, q: Array) -> Array:
        """From a vector to the errors at positions (n, 3), m; shape (n, 3, m)."""
        return vector_rows(self.common, q)

    def lengths(self, vector: Array) -> Array:
        """Lengths of the error vectors on the grid, shape (n,), m."""
        return np.asarray(np.linalg.norm((self.field_rows @ vector).reshape(-1, 3), axis=1))

    def since(self, first: int) -> Series:
        """The runs from one on."""
        return Series(
            self.runs[first:], self.common, self.values[first:], self.covariances[first:]
        )


def _millimetres(offset: Array) -> str:
    return f'({", ".join(f"{1e3 * v:.1f}" for v in offset)}) mm'


def _grid(common: Common) -> Array:
    ends = [np.linspace(*_ends(common, a), GRID) for a in common.machine.axis_names]
    return np.stack([g.ravel() for g in np.meshgrid(*ends, indexing='ij')], axis=1)


def _ends(common: Common, axis: str) -> tuple[float, float]:
    position, limits = common.position[axis], common.machine.axes[axis]
    if len(position):
        return float(position[0]), float(position[-1])
    return limits.min, limits.max


def _to_common(source: Source, common: Common) -> Array:
    """From squareness and nodes of a source to the vector of a series, shape (m, 3 + nodes).

    The squareness errors of the vector are those that leave nothing, but a rigid motion, of what
    the source knows less the motions of the vector.
    """
    first = len(SQUARENESS)
    motions = operator(source, common)
    matrix = np.hstack([np.zeros((len(motions), first)), motions])
    q = _grid(common)
    nodes: dict[str, Array] = {m: source.tables.motions[m].position for m in MOTIONS}
    own = prediction_rows(common.machine, nodes, q).reshape(3 * len(q), -1)
    start = first
    for motion in MOTIONS:
        stop = start + len(nodes[motion])
        if motion not in (*common.motions, *common.folded):
            own[:, start:stop] = 0.0
        start = stop
    parts = vector_rows(common, q).reshape(3 * len(q), -1)
    left = own - parts[:, :-first] @ matrix
    angles = free_rows(parts[:, -first:], q)
    return np.vstack([matrix, np.linalg.lstsq(angles, free_rows(left, q), rcond=None)[0]])


def series_of(runs: Sequence[StoredRun]) -> Series:
    """Bring runs of one machine to one convention.

    Raises
    ------
    ConfigError
        If they are of different machines or share nothing.
    """
    packed = []
    for run in runs:
        tables = run.content.tables
        size = len(SQUARENESS) + sum(len(tables.motions[m].position) for m in MOTIONS)
        packed.append(unpack_covariance(run.content.extra.get('covariance'), size))
    sources = [
        source_of_tables(run.name, run.content.tables, known)
        for run, known in zip(runs, packed, strict=True)
    ]
    common = common_ground(sources[::-1])  # at the target offset of the latest
    values, covariances = [], []
    for run, source, known in zip(runs, sources, packed, strict=True):
        square = run.content.tables.squareness
        full = _to_common(source, common)
        if known is None:
            known = np.zeros((full.shape[1], full.shape[1]))
            known[:3, :3] = np.diag([square[k].u ** 2 for k in SQUARENESS])
            known[3:, 3:] = source.covariance
        vector = np.concatenate([[square[k].value for k in SQUARENESS], source.values])
        values.append(full @ vector)
        covariances.append(full @ known @ full.T)
    return Series(tuple(runs), common, np.array(values), np.array(covariances))
