# SPDX-License-Identifier: Apache-2.0
"""Whitened rows of all runs: tables and poses, effects, deviations.

With W the inverse Cholesky factor of the noise covariance (``normal.Whitener``): A holds the
columns of poses and tables, E those of an effect, y the deviations, all multiplied by W, so that
independent noise of unit variance is left in y. What an effect adds beyond the tables is what
remains of E once A is projected out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from otf_core.effects import State
from otf_core.effects.state import state_on_path
from otf_core.joint import JointSolution, SolvedRun
from otf_core.runs import Run
from otf_core.solution import TIE_BREAK, smoothness

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FOLDS = 8


def run_state(run: Run, solved: SolvedRun, nodes: dict[str, Array], tables: object = None) -> State:
    """State of the pieces of one run."""
    state = state_on_path(
        run.machine,
        run.alignment.corners,
        run.pieces.leg,
        solved.system.q,
        run.pieces.speed,
        run.pieces.time,
        solved.pose,
        nodes,
    )
    return state


@dataclass(frozen=True)
class Rows:
    """Rows of all runs, one run after the other, component by component.

    Attributes
    ----------
    runs : tuple of Run
    done : JointSolution
    states : tuple of State
        One per run, one entry per piece.
    base : ndarray, shape (r, b)
        Whitened columns of the free unknowns that are solved for, in units of the
        identifiability limit.
    deviation : ndarray, shape (r,)
        Whitened deviations.
    fold : ndarray of int, shape (r,)
        Group of legs each row belongs to, for judging on rows that were not fitted.
    limit : float
        m or rad per unit of ``base``.
    """

    runs: tuple[Run, ...]
    done: JointSolution
    states: tuple[State, ...]
    base: Array
    deviation: Array
    fold: Index
    limit: float

    def columns(self, terms: Callable[[State], Array]) -> tuple[Array, Array]:
        """Whitened columns of displacements.

        Parameters
        ----------
        terms : callable(State) -> ndarray, shape (n, 3, k)

        Returns
        -------
        white : ndarray, shape (r, k)
        size : ndarray, shape (k,), m
            Root mean square of the perpendicular displacement per unit where it acts at all.
        """
        parts, raw = [], []
        for state, solved in zip(self.states, self.done.runs, strict=True):
            plain = np.einsum('cij,ijk->cik', solved.system.axes, terms(state))
            raw.append(plain.reshape(-1, plain.shape[2]))
            white = np.empty_like(plain)
            for leg, (low, high) in enumerate(solved.whitener.bounds):
                for component in range(len(plain)):
                    block = plain[component, low:high]
                    white[component, low:high] = solved.whitener.leg_rows(leg, component, block)
            parts.append(white.reshape(-1, plain.shape[2]))
        plain = np.concatenate(raw)
        acts = np.abs(plain) > 0.02 * np.abs(plain).max(axis=0, initial=1e-300)
        size = np.sqrt((plain**2).sum(axis=0) / np.maximum(acts.sum(axis=0), 1))
        return np.concatenate(parts), size

    @cached_property
    def factor(self) -> Array:
        """Lower Cholesky factor of the normal matrix of ``base`` with the tie-breaker."""
        return np.asarray(linalg.cholesky(self.base.T @ self.base + self.ridge, lower=True))

    @cached_property
    def ridge(self) -> Array:
        """Tie-breaker for what the data do not determine, shape (b, b)."""
        use = used_columns(self.done)
        return np.asarray(TIE_BREAK * smoothness(self.done.unknowns)[np.ix_(use, use)])

    def project(self, columns: Array) -> Array:
        """Columns (r, k) less what tables and poses can follow of them."""
        inner = linalg.cho_solve((self.factor, True), self.base.T @ columns)
        return np.asarray(columns - self.base @ inner)

    @cached_property
    def residual(self) -> Array:
        """Whitened deviations less tables and poses, shape (r,)."""
        return self.project(self.deviation[:, None])[:, 0]


def used_columns(done: JointSolution) -> Index:
    """Free unknowns that are solved for."""
    blocks = done.unknowns.free_blocks
    return np.concatenate(
        [np.arange(blocks[n].start, blocks[n].stop) for n in done.solution.accepted]
    )


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
    use = used_columns(done)
    base, deviation, fold, offset = [], [], [], 0
    for run, solved in zip(runs, done.runs, strict=True):
        design = (solved.system.design @ done.unknowns.gauge)[:, use].toarray() * limit
        base.append(_whitened(solved, design))
        deviation.append(solved.whitener.vector(solved.system.deviation).reshape(-1))
        # neighbouring legs go to different folds; laps of one line do not always share one
        number = np.unique(run.pieces.leg, return_inverse=True)[1] + offset
        fold.append(np.tile((number * 5 + number // FOLDS) % FOLDS, len(solved.system.axes)))
        offset += int(number.max()) + 1
    states = tuple(
        run_state(r, s, done.unknowns.nodes) for r, s in zip(runs, done.runs, strict=True)
    )
    return Rows(
        tuple(runs),
        done,
        states,
        np.concatenate(base),
        np.concatenate(deviation),
        np.concatenate(fold),
        limit,
    )
