# SPDX-License-Identifier: Apache-2.0
"""Whitened rows of all runs: tables and poses, effects, deviations.

With W the inverse Cholesky factor of the noise covariance (``normal.Whitener``): A holds the
columns of poses and tables, E those of an effect, y the deviations, all multiplied by W, so that
independent noise of unit variance is left in y. What an effect adds beyond the tables is what
remains of E once A is projected out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from otf_core.effects import Effect, Shape, State, Terms
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Run
from otf_core.solving.columns import across, name_in_run, piece_state
from otf_core.solving.joint import JointSolution, SolvedRun, summed, tables_of
from otf_core.solving.sample_states import sample_state
from otf_core.solving.solution import TIE_BREAK, free_columns, identifiable_blocks, smoothness

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FOLDS = 8


@dataclass(frozen=True)
class Rows:
    """Rows of all runs, one run after the other, component by component.

    Attributes
    ----------
    runs : tuple of Run
    done : JointSolution
    tables : ErrorTables
        As solved.
    states : tuple of State
        One per run, one entry per piece.
    plain_base, plain_deviation : ndarray, shape (r, b) and (r,), m
        ``base`` and ``deviation`` before whitening.
    base : ndarray, shape (r, b)
        Whitened columns of the free unknowns that are solved for, in units of the
        identifiability limit.
    deviation : ndarray, shape (r,)
        Whitened deviations.
    fold : ndarray of int, shape (r,)
        Group of legs each row belongs to, for judging on rows that were not fitted.
    limit : float
        m or rad per unit of ``base``.
    use : ndarray of int, shape (b,)
        Free unknowns in ``base``: those that are solved for, and rotations that only what a
        spline times the travel is off a spline tells from translations. They are of no use as
        tables, but their trace must not be taken for something else.
    """

    runs: tuple[Run, ...]
    done: JointSolution
    tables: ErrorTables
    states: tuple[State, ...]
    plain_base: Array
    plain_deviation: Array
    base: Array
    deviation: Array
    fold: Index
    limit: float
    use: Index

    @cached_property
    def sample_states(self) -> tuple[State, ...]:
        """States of the samples in the pieces, one per run."""
        nodes = self.done.unknowns.knots
        return tuple(
            sample_state(r, s.pose, self.tables, nodes)
            for r, s in zip(self.runs, self.done.runs, strict=True)
        )

    def plain_columns(self, effect: Effect, shape: Shape) -> Array:
        """Displacements across the path per unit of each term, shape (r, k)."""
        parts = []
        for k, (run, solved) in enumerate(zip(self.runs, self.done.runs, strict=True)):
            if effect.wave is not None and len(run.recording.samples):
                columns = run.pieces.mean_of(effect.terms(self.sample_states[k], shape).columns)
            else:
                columns = effect.terms(self.states[k], shape).columns
            parts.append(across(solved, columns).reshape(-1, columns.shape[2]))
        return linalg.block_diag(*parts) if effect.own_per_run else np.concatenate(parts)

    def terms(self, effect: Effect, shape: Shape) -> Terms:
        """Terms of the columns; each run's own where they differ from run to run."""
        first = effect.terms(self.states[0], shape)
        runs = range(len(self.runs)) if effect.own_per_run else range(1)
        return Terms(
            tuple(name_in_run(name, k) for k in runs for name in first.names),
            first.units * len(runs),
            first.axes * len(runs),
            first.columns,
        )

    def by_run(self, values: Array) -> Iterator[Array]:
        """Values (r, ...) of the rows of every run, each of shape (c, p, ...)."""
        start = 0
        for solved in self.done.runs:
            shape = solved.system.deviation.shape
            stop = start + shape[0] * shape[1]
            yield values[start:stop].reshape(*shape, *values.shape[1:])
            start = stop

    def whiten(self, columns: Array) -> Array:
        """Whiten columns (r, k) of all runs."""
        width = columns.shape[1]
        parts = zip(self.done.runs, self.by_run(columns), strict=True)
        return np.concatenate([_whitened(s, part.reshape(-1, width)) for s, part in parts])

    @cached_property
    def factor(self) -> Array:
        """Lower Cholesky factor of the normal matrix of ``base`` with the tie-breaker."""
        return np.asarray(linalg.cholesky(self.base.T @ self.base + self.ridge, lower=True))

    @cached_property
    def ridge(self) -> Array:
        """Tie-breaker for what the data do not determine, shape (b, b)."""
        smooth = smoothness(self.done.unknowns)
        return np.asarray(TIE_BREAK * smooth[np.ix_(self.use, self.use)])

    def project(self, columns: Array) -> Array:
        """Columns (r, k) less what tables and poses can follow of them."""
        inner = linalg.cho_solve((self.factor, True), self.base.T @ columns)
        return np.asarray(columns - self.base @ inner)

    @cached_property
    def residual(self) -> Array:
        """Whitened deviations less tables and poses, shape (r,)."""
        return self.project(self.deviation[:, None])[:, 0]


def _whitened(solved: SolvedRun, dense: Array) -> Array:
    white = np.empty_like(dense)
    count = solved.system.deviation.shape[1]
    for leg, (low, high) in enumerate(solved.whitener.bounds):
        for component in range(len(solved.system.deviation)):
            part = slice(component * count + low, component * count + high)
            white[part] = solved.whitener.leg_rows(leg, component, dense[part])
    return white


def build_rows(runs: Sequence[Run], done: JointSolution, limit: float) -> Rows:
    """Set up the rows of solved runs.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
        Of the same runs.
    limit : float
        ``CalibrationConfig.unidentifiable_above``.
    """
    tables = tables_of(runs[0].machine, done.unknowns, done.solution)
    states = tuple(
        piece_state(r, s, done.unknowns.knots, tables)
        for r, s in zip(runs, done.runs, strict=True)
    )
    return rows_of(runs, done, tables, states, limit)


def rows_of(
    runs: Sequence[Run],
    done: JointSolution,
    tables: ErrorTables,
    states: tuple[State, ...],
    limit: float,
) -> Rows:
    """Set up rows for given states; see ``Rows``."""
    systems, whiteners = [s.system for s in done.runs], [s.whitener for s in done.runs]
    seen = identifiable_blocks(summed(systems, done.unknowns, whiteners), done.unknowns, limit)
    use = free_columns(done.unknowns, seen)
    plain, deviation, fold, offset = [], [], [], 0
    for run, solved in zip(runs, done.runs, strict=True):
        design = solved.system.design @ done.unknowns.gauge
        plain.append(design[:, use].toarray() * limit)
        deviation.append(solved.system.deviation.reshape(-1))
        # neighbouring legs go to different folds; laps of one line do not always share one
        number = np.unique(run.pieces.leg, return_inverse=True)[1] + offset
        fold.append(np.tile((number * 5 + number // FOLDS) % FOLDS, len(solved.system.axes)))
        offset += int(number.max()) + 1
    white = [_whitened(s, p) for s, p in zip(done.runs, plain, strict=True)]
    bare = [_whitened(s, d[:, None])[:, 0] for s, d in zip(done.runs, deviation, strict=True)]
    return Rows(
        runs=tuple(runs),
        done=done,
        tables=tables,
        states=states,
        plain_base=np.concatenate(plain),
        plain_deviation=np.concatenate(deviation),
        base=np.concatenate(white),
        deviation=np.concatenate(bare),
        fold=np.concatenate(fold),
        limit=limit,
        use=use,
    )
