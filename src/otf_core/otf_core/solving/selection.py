# SPDX-License-Identifier: Apache-2.0
"""Selection of blocks of columns by what they explain of lines that are held out.

Noise is correlated within a leg, so whole lines are held out, with all passes over them. Lines are
dealt to folds. With A the rows of what is solved for, c further columns and the sums of normal
equations over all other folds, what the tables leave of the columns, and what they estimate, is

    E = c - A S,   S = (A^T W A + K^-1)^-1 A^T W c,
    (c^T W E + P) theta = c^T W e,   P the precision of the prior, e what they leave of deviations

(the Schur complement: tables and poses are estimated anew with every block). The squares that a
model leaves of line j of the fold are S_j = |W^1/2 (e - E theta)|^2, and the gain of one model
over another is

    D = sum_j ( S_j simple - S_j rich ),    s_D = sqrt(n) * standard deviation of the n differences

Blocks are added one after the other: of those that are no worse than the best by s_D (the rule of
one standard error) the one of fewest unknowns, as long as it gains more than 3 s_D. What the
others have made superfluous by the same rule is taken out at the end. Blocks are not cut: of
unknowns that are nearly alike, leaving one out that explains little moves the others by many u.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.solving.joint import (
    JointSolution,
    place_equations,
    systems_of,
    tables_of,
)
from otf_core.solving.normal import pieces_of, sum_groups, white_rows
from otf_core.solving.residuals import FOLDS, fold_of
from otf_core.solving.solution import Positive, free_columns
from otf_core.solving.system import System
from otf_core.solving.unknowns import Unknowns
from otf_core.solving.whitener import Whitener
from otf_core.threads import side_by_side

MIN_GAIN_OVER_SCATTER = 3.0
"""Gain over its own scatter from which a block is taken."""
LEGS_PER_BLOCK = 32
"""Legs whose rows are held at a time."""


@dataclass(frozen=True)
class Block:
    """Unknowns that are taken together, or not at all.

    Attributes
    ----------
    names : tuple of str
        Blocks of the layout of unknowns.
    positive : bool
        Its only unknown has a physical sense only if it is positive.
    """

    names: tuple[str, ...]
    positive: bool = False


@dataclass(frozen=True)
class _Fold:
    """Lines that are held out, and normal equations of all others.

    Attributes
    ----------
    residual, columns : ndarray, shape (r,) and (r, k)
        Whitened residuals and columns, as the others leave them.
    line : ndarray of int64, shape (r,)
    matrix, right : ndarray, shape (k, k) and (k,)
        Of the further columns beside all that is solved for, prior included.
    """

    residual: Array
    columns: Array
    line: Index
    matrix: Array
    right: Array


@dataclass(frozen=True)
class HeldOutLines:
    """Every line of some runs with the model of all other folds, and further columns.

    Attributes
    ----------
    names : tuple of str
        Further unknowns, one column each.
    lines : int
    """

    names: tuple[str, ...]
    folds: tuple[_Fold, ...]
    lines: int

    @classmethod
    def of(cls, joint: JointSolution, unknowns: Unknowns, sizes: Array) -> HeldOutLines:
        """Sum up the lines of a solution.

        Parameters
        ----------
        unknowns : Unknowns
            Those of the solution, and behind them k further ones of one value each.
        sizes : ndarray, shape (k,)
            Standard deviations of the prior of the further ones.
        """
        names = tuple(n for n in unknowns.blocks if n not in joint.unknowns.blocks)
        tables = tables_of(joint.machine, joint.unknowns, joint.solution)
        systems = systems_of([s.run for s in joint.runs], unknowns, tables)
        lines, accepted = number_lines(joint), joint.solution.accepted
        count = 1 + max(int(own.max()) for own in lines)
        rows = list(zip(systems, [s.whitener for s in joint.runs], lines, strict=True))
        sums = [
            sum_groups(system, unknowns, whitener, fold_of(line), None, FOLDS, accepted)
            for system, whitener, line in rows
        ]
        parts = [reduce(add, of_fold) for of_fold in zip(*sums, strict=True)]
        total = reduce(add, [*parts, place_equations(joint.machine, unknowns, joint.places)])
        use, further = free_columns(unknowns, accepted), free_columns(unknowns, names)
        prior = joint.roughness.precision[np.ix_(use, use)]

        def fold(number: int) -> _Fold:
            others = total.less(parts[number])
            cross, right = others.matrix[np.ix_(use, further)], others.right
            factor = Positive(others.matrix[np.ix_(use, use)] + prior)
            follow = factor.solve(np.column_stack([cross, right[use]]))
            model = np.zeros((unknowns.free, len(names) + 1))
            model[use] = -follow
            model[further, np.arange(len(names))] = 1.0
            left = np.vstack([unknowns.gauge @ model, np.eye(len(names) + 1)[-1]])
            own = [part for run in rows for part in _white_products(*run, number, left)]
            values, line = (np.concatenate(p) for p in zip(*own, strict=True))
            matrix = others.matrix[np.ix_(further, further)] - cross.T @ follow[:, :-1]
            matrix += np.diag(sizes**-2.0)
            pull = right[further] - cross.T @ follow[:, -1]
            return _Fold(values[:, -1], values[:, :-1], line, matrix, pull)

        for system, whitener, _ in rows:
            system.rows.prepare()
            whitener.inverses  # noqa: B018
        return cls(names, tuple(side_by_side(fold, range(FOLDS))), count)

    def estimate(self, names: Collection[str]) -> tuple[Array, Array]:
        """Values of some of the unknowns, and the squares that they leave.

        Returns
        -------
        values : ndarray, shape (m,)
            Means of the estimates of all folds, in the order of ``names`` of this object.
        squares : ndarray, shape (lines,)
        """
        use = np.flatnonzero([n in names for n in self.names])
        squares, values = np.zeros(self.lines), np.zeros((len(self.folds), len(use)))
        for fold, value in zip(self.folds, values, strict=True):
            left = fold.residual
            if len(use):
                value[:] = Positive(fold.matrix[np.ix_(use, use)]).solve(fold.right[use])
                left = left - fold.columns[:, use] @ value
            squares += np.bincount(fold.line, left**2, self.lines)
        return values.mean(axis=0), squares


def number_lines(joint: JointSolution) -> list[Index]:
    """Number of the line of every leg of every run, those of further runs counting on."""
    lines = [solved.whitener.line for solved in joint.runs]
    first = np.cumsum([0, *(int(own.max()) + 1 for own in lines)])
    return [own + start for own, start in zip(lines, first.tolist(), strict=False)]


def _white_products(
    system: System, whitener: Whitener, line: Index, fold: int, values: Array
) -> Iterator[tuple[Array, Index]]:
    """Whitened rows and deviations of the legs of a fold times ``values``, and their lines."""
    legs = np.flatnonzero(fold_of(line) == fold).tolist()
    for some in (legs[k : k + LEGS_PER_BLOCK] for k in range(0, len(legs), LEGS_PER_BLOCK)):
        pieces, inverses = pieces_of(whitener, some), [whitener.inverses[k] for k in some]
        columns, white = white_rows(system, inverses, pieces, system.deviation[:, :, None])
        own = np.repeat(line[some], [part.stop - part.start for part in pieces])
        yield white @ values[columns], np.tile(own, len(system.deviation))


@dataclass(frozen=True)
class Selection:
    """Blocks that the data call for.

    Attributes
    ----------
    names : tuple of str
        Their unknowns.
    gain, scatter : float
        Of all of them over none; of the best block where none is taken.
    indistinguishable_from : tuple of str
        Further unknowns of blocks of which each explains the lines as well as one that was taken.
    """

    names: tuple[str, ...]
    gain: float
    scatter: float
    indistinguishable_from: tuple[str, ...] = ()


def gain_over(simple: Array, rich: Array) -> tuple[float, float]:
    """Gain of the second model over the first and its scatter, by the squares (lines,) left."""
    difference = simple - rich
    return float(difference.sum()), float(np.sqrt(len(difference)) * difference.std(ddof=1))


def select(lines: HeldOutLines, blocks: Sequence[Block]) -> Selection:
    """Add blocks as long as they gain, then take out what is not needed."""
    chosen: list[Block] = []
    equal: set[str] = set()

    def squares(names: Collection[str]) -> Array:
        return lines.estimate(names)[1]

    start = now = squares(())
    first = 0.0, 0.0
    while len(chosen) < len(blocks):
        held = {n for block in chosen for n in block.names}
        tried = []
        for block in blocks:
            if set(block.names) <= held:
                continue
            values, left = lines.estimate(held | set(block.names))
            own = [n for n in lines.names if n in held or n in block.names]
            if not block.positive or values[own.index(block.names[0])] > 0.0:
                tried.append((block, len(set(block.names) - held), left))
        if not tried:
            break
        best = min(tried, key=lambda one: float(one[2].sum()))
        first = gain_over(start, best[2]) if not chosen else first
        alike = [one for one in tried if np.less_equal(*gain_over(one[2], best[2]))]
        block, _, left = min(alike, key=lambda one: (one[1], float(one[2].sum())))
        if not is_clear(*gain_over(now, left)):
            break
        chosen, now = [*chosen, block], left
        equal |= {n for b, _, _ in alike if len(b.names) == len(block.names) for n in b.names}
    for block in chosen[:-1]:
        rest = [other for other in chosen if other is not block]
        left = squares({n for other in rest for n in other.names})
        if not is_clear(*gain_over(left, now)):
            chosen, now = rest, left
    taken = {n for block in chosen for n in block.names}
    gain = gain_over(start, now) if chosen else first
    names = tuple(n for n in lines.names if n in taken)
    return Selection(names, *gain, tuple(n for n in lines.names if n in equal - taken))


def is_clear(gain: float, scatter: float) -> bool:
    """Tell whether a gain is far above its own scatter."""
    return gain > MIN_GAIN_OVER_SCATTER * scatter
