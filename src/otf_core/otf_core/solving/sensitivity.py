# SPDX-License-Identifier: Apache-2.0
"""Columns of shared parameters over the pieces of all runs, and what they do to the estimates.

A displacement theta c of the measured points, c known and theta not, moves the estimates of
generalised least squares by theta S with

    S = (A^T W A)^-1 A^T W c

(GUM, JCGM 102 section 6: the sensitivity to an input that is not estimated; a "consider
parameter"). The estimates stay as they are; their covariance gains u(theta)^2 S S^T.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.effects import State
from otf_core.effects.state import state_on_path
from otf_core.model.courses import Courses
from otf_core.model.frames import RigidTransform
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution, SolvedRun
from otf_core.threads import side_by_side

Columns = Callable[[slice], Array]
"""Columns (c, m, k), m, of m pieces of a run."""
PIECES_PER_BLOCK = 2048
"""Pieces whose columns are made together, and the rest of their line."""
MIN_ACTING_SHARE, MIN_SQUARE = 0.02, 1e-300
"""Share of its largest value, and m^2, above which a column acts."""
VALUES_PER_BLOCK = 65_536
"""Values that are evaluated together."""


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


def across(solved: SolvedRun, columns: Array, pieces: slice = slice(None)) -> Array:
    """Components (c, m, k) along the rows of displacements (m, 3, k) of some pieces."""
    return np.asarray(np.einsum('cij,ijk->cik', solved.system.axes[:, pieces], columns))


def projected(joint: JointSolution, columns: Sequence[Columns | Array]) -> Array:
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
    return np.asarray(joint.solution.covariance @ projected(joint, columns))


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
