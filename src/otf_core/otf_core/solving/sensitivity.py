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
from dataclasses import dataclass, replace

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.effects import Effect, State
from otf_core.effects.state import state_in_parts, state_on_path
from otf_core.model.frames import RigidTransform
from otf_core.model.signals import Courses
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
    placed = replace(run, places=solved.run.places)
    return state_at(placed, solved.system.q, solved.pose, nodes, tables)


def state_at(
    run: Observed,
    q: Array,
    pose: RigidTransform,
    nodes: dict[str, Array],
    tables: ErrorTables | None,
) -> State:
    """State of the pieces of one run, which lie at q (p, 3), m, on its path."""
    pieces = run.pieces
    if run.shape is None:
        return state_in_parts(
            run.machine,
            run.targets,
            {name: run.sight(name).place for name in run.targets},
            pieces.part,
            pieces.stretch,
            q,
            pieces.rate,
            pieces.side,
            pieces.time,
            pose,
            nodes,
            tables,
            float(pieces.time.max() + pieces.duration[-1]),
            np.abs(pieces.step) * pieces.spread[:, None],
        )
    return state_on_path(
        run.machine,
        run.shape.corners,
        np.zeros_like(pieces.leg) if pieces.standstill else pieces.stretch,
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
    square : ndarray, shape (k,)
        Diagonal of c^T W c.
    normal : ndarray, shape (k, k)
        M, a difference of large numbers.
    right : ndarray, shape (k,)
        c^T W e.
    """

    change: Array
    square: Array
    normal: Array
    right: Array


def beside_tables(
    joint: JointSolution, columns: Sequence[Array], places: Sequence[Index], count: int
) -> BesideTables:
    """Sum up the products of ``count`` columns.

    Parameters
    ----------
    columns : sequence of ndarray, shape (c, p, m)
        Of every run, those that act in it.
    places : sequence of ndarray of int64, shape (m,)
        Their places among all.
    """
    cross, whole = np.zeros((joint.unknowns.full, count)), np.zeros((count, count))
    right = np.zeros(count)
    for part, place, solved in zip(columns, places, joint.runs, strict=True):
        if not len(place):
            continue
        cross[:, place] += _pulled(solved, part)
        flat, weighted = (
            a.reshape(-1, len(place)) for a in (part, solved.whitener.weighted(part))
        )
        whole[np.ix_(place, place)] += flat.T @ weighted
        right[place] += weighted.T @ solved.residual.ravel()
    change = joint.solution.covariance @ cross
    return BesideTables(change, np.diag(whole), whole - cross.T @ change, right)


def name_in_run(name: str, run: int) -> str:
    """Name of a coefficient that belongs to one run; plain in the first."""
    return f'{name} (run {run + 1})' if run else name


def column_size(*parts: Array, places: Sequence[Index] = ()) -> Array:
    """Root mean square of columns over the rows where they act at all, shape (k,).

    Parameters
    ----------
    parts : ndarray, shape (r, m)
        One below the other.
    places : sequence of ndarray of int64, shape (m,)
        Places of the columns of every part among all; if not given, each holds all.
    """
    places = places or [np.arange(part.shape[1]) for part in parts]
    step = max(1, VALUES_PER_BLOCK // max(1, parts[0].shape[1]))
    total, most, count = np.zeros((3, 1 + max(int(own.max(initial=-1)) for own in places)))

    def squares() -> Iterator[tuple[Index, Array]]:
        for part, own in zip(parts, places, strict=True):
            yield from ((own, part[low : low + step] ** 2) for low in range(0, len(part), step))

    for own, square in squares():
        total[own] += np.ones(len(square)) @ square
        most[own] = np.maximum(most[own], square.max(axis=0))
    least = MIN_ACTING_SHARE**2 * np.maximum(most, MIN_SQUARE)
    for own, square in squares():
        count[own] += np.ones(len(square)) @ (square > least[own])
    return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))
