# SPDX-License-Identifier: Apache-2.0
"""Columns of shared parameters over the pieces of all runs, beside the weighted system.

A displacement theta c of the measured points, c known and theta not, moves the estimates of
generalised least squares by theta S with

    S = (A^T W A)^-1 A^T W c

(GUM, JCGM 102 section 6: the sensitivity to an input that is not estimated; a "consider
parameter"). The estimates stay as they are; their covariance gains u(theta)^2 S S^T. Where theta
is estimated with the tables, its normal matrix and right side are, with residuals e,

    M = c^T W c - c^T W A S = c^T W (c - A S),    c^T W e
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import Effect, State
from otf_core.effects.state import state_on_path
from otf_core.model.courses import Courses
from otf_core.model.frames import RigidTransform
from otf_core.model.tables import ErrorTables
from otf_core.pieces.pieces import Pieces
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution, SolvedRun
from otf_core.threads import side_by_side

Columns = Callable[[slice], Array]
"""Columns (c, m, k), m, of m pieces of a run."""
PIECES_PER_BLOCK = 2048
"""Pieces whose columns are made together, and the rest of their line."""
MIN_ACTING_SHARE, MIN_SQUARE = 0.02, 1e-300
"""Share of its largest value, and m^2, above which a column acts."""
ROUNDING = 1e-10
"""Share of the squares of columns below which what the tables leave of them is rounding."""
VALUES_PER_BLOCK = 65_536
"""Values that are evaluated together."""
PLACES_PER_BLOCK = 600_000
"""Pieces or samples times columns at which an effect is evaluated together; bounds the memory."""


def piece_state(
    run: Observed, solved: SolvedRun, nodes: dict[str, Array], tables: ErrorTables
) -> State:
    """State of the pieces of one run; standstills count as points of the first leg."""
    return state_at(run, solved.system.q, solved.pose, nodes, tables)


def state_at(
    run: Observed,
    q: Array,
    pose: RigidTransform,
    nodes: dict[str, Array],
    tables: ErrorTables | None,
) -> State:
    """State of the pieces of one run, which lie at q (p, 3), m, on its path."""
    pieces = run.pieces
    return state_on_path(
        run.machine,
        run.shape.corners,
        np.zeros_like(pieces.leg) if pieces.standstill else pieces.line,
        q,
        pieces.speed,
        run.late + pieces.time,
        pose,
        nodes,
        tables,
        run.late + pieces.end,
        run.shape,
        Courses(run.signals, run.first_ns, pieces.time),
        run.leg_starts,
    )


@dataclass(frozen=True)
class Places:
    """Where the pieces of one run lie, and their samples unless all effects act at pieces."""

    pieces: Pieces
    state: State
    samples: State | None = None

    def columns(self, effect: Effect, function: Callable[[State], Array], width: int) -> Array:
        """Evaluate columns (p, 3, ``width``), means over the samples where the effect needs it."""
        return (
            self.means(function, width) if effect.changes_within_pieces else function(self.state)
        )

    def means(self, function: Callable[[State], Array], width: int) -> Array:
        """Means over the samples of columns (p, 3, ``width``); at pieces without samples."""
        if self.samples is None:
            return function(self.state)
        samples, step = self.samples, max(1, PLACES_PER_BLOCK // max(width, 1))
        starts = range(0, len(samples), step)
        return self.pieces.mean_of(function(samples.part(slice(k, k + step))) for k in starts)


def components_across(solved: SolvedRun, columns: Array, pieces: slice = slice(None)) -> Array:
    """Components (c, m, k) along the rows of displacements (m, 3, k) of some pieces."""
    return np.asarray(np.einsum('cij,ijk->cik', solved.system.axes[:, pieces], columns))


def project_columns(joint: JointSolution, columns: Sequence[Columns | Array]) -> Array:
    """Return A^T W c, shape (full, k), for columns (c, p, k) of every run."""
    return np.asarray(sum(_pulled(s, of) for s, of in zip(joint.runs, columns, strict=True)))


def _pulled(solved: SolvedRun, of: Columns | Array) -> Array:
    """A^T W c of one run, the columns of some lines at a time."""
    bounds, rows = solved.whitener.bounds, solved.system.rows
    rows.prepare()  # shared by both threads

    def pulled(lines: tuple[int, int]) -> Array:
        pieces = slice(bounds[lines[0]][0], bounds[lines[1] - 1][1])
        own = of(pieces) if callable(of) else of[:, pieces]
        return rows.pulled(pieces, solved.whitener.weighted(own, lines))

    return np.asarray(sum(side_by_side(pulled, list(_together(bounds)))))


def _together(bounds: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """First line and one past the last of those whose columns are made together."""
    low = 0
    for k, (_, end) in enumerate(bounds, start=1):
        if end - bounds[low][0] >= PIECES_PER_BLOCK or k == len(bounds):
            yield low, k
            low = k


def sensitivity(joint: JointSolution, columns: Sequence[Columns | Array]) -> Array:
    """Change of the estimates per unit of each column, shape (full, k).

    Parameters
    ----------
    columns : sequence of callable or ndarray
        One entry per run: columns (c, m, k), m, of some of its pieces, or of all (c, p, k).
    """
    return np.asarray(joint.solution.covariance @ project_columns(joint, columns))


@dataclass(frozen=True)
class BesideTables:
    """Products of k columns c that are estimated together with the tables and poses.

    Attributes
    ----------
    change : ndarray, shape (full, k)
        S.
    weighted : list of ndarray, shape (c, p, k)
        W c of every run.
    square : ndarray, shape (k,)
        Diagonal of c^T W c.
    normal : ndarray, shape (k, k)
        M, a difference of large numbers.
    right : ndarray, shape (k,)
        c^T W e.
    """

    change: Array
    weighted: list[Array]
    square: Array
    normal: Array
    right: Array


def beside_tables(joint: JointSolution, columns: Sequence[Array]) -> BesideTables:
    """Sum up the products of columns (c, p, k) of every run."""
    cross = project_columns(joint, columns)
    change = joint.solution.covariance @ cross
    normal, right, weighted = -cross.T @ change, np.zeros(cross.shape[1]), []
    square = np.zeros(cross.shape[1])
    for part, solved in zip(columns, joint.runs, strict=True):
        weighted.append(solved.whitener.weighted(part))
        flat, of_flat = (a.reshape(-1, part.shape[2]) for a in (part, weighted[-1]))
        product = flat.T @ of_flat
        normal += product
        square += np.diag(product)
        right += of_flat.T @ solved.residual.ravel()
    return BesideTables(change, weighted, square, normal, right)


def name_in_run(name: str, run: int) -> str:
    """Name of a coefficient that belongs to one run; plain in the first."""
    return f'{name} (run {run + 1})' if run else name


def column_size(*parts: Array) -> Array:
    """Root mean square of columns over the rows where they act at all, shape (k,).

    Parameters
    ----------
    parts : ndarray, shape (r, k)
        One below the other.
    """
    step = max(1, VALUES_PER_BLOCK // max(1, parts[0].shape[1]))

    def squares() -> Iterator[Array]:
        for part in parts:
            yield from (part[low : low + step] ** 2 for low in range(0, len(part), step))

    total, most = zip(*((np.ones(len(s)) @ s, s.max(axis=0)) for s in squares()), strict=True)
    least = MIN_ACTING_SHARE**2 * np.maximum(np.max(most, axis=0), MIN_SQUARE)
    count = np.sum([np.ones(len(s)) @ (s > least) for s in squares()], axis=0)
    return np.asarray(np.sqrt(np.sum(total, axis=0) / np.maximum(count, 1.0)))
