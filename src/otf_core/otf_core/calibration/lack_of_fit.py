# SPDX-License-Identifier: Apache-2.0
"""Lack of fit: residuals that recur in every pass over a line, separated from noise.

Noise of the tracker, drift and vibration come anew in every pass; what a machine does at a place
comes again, and so does what a tracker does as it points there. So with residual vectors v and w
of two passes over the same piece of a line

    E[ v . w ] = | b |^2  -  tr( B_v V B_w^T )

b being what the model does not contain there, B the derivatives of the piece by all unknowns
(across the line) and V their covariance: residuals of generalised least squares have the
covariance S - A V A^T, and between passes S is zero. The mean of | b |^2 needs no knowledge of
the noise, which may hide a lack as large as itself. It is the sum of squares for lack of fit of
repeated observations; how sure it is tells the scatter between lines.

Of several runs the passes of one and the same are compared, and those of different ones beside it:
what comes again within runs alone is the tracker's, from another place, or the machine changed.

References
----------
N. Draper, H. Smith, Applied Regression Analysis, 3rd ed., 1998, section 2.1: lack of fit and pure
error from repeat runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.pieces.runs import Observed
from otf_core.solving.joint import JointSolution

PLACE_LENGTH = 0.008
"""m; pieces whose middles lie in the same stretch of a line are the same place."""
SAME_LINE, SAME_DIRECTION = 2e-3, 1e-3
"""m, and change of a unit vector, below which lines count as the same."""
MAX_PAIRS = 400
"""Pairs of pieces of which the share of the unknowns is worked out."""
MIN_REPEATED_LINES = 12
"""Lines driven more than once; with fewer no lack of fit is reported."""
MIN_SIGNIFICANCE = 3.0
"""Standard deviations, by the scatter between lines, from which on it is reported. Of runs
of which nothing comes again this was 2.6 at most in 48."""
MIN_SHARE_OF_U = 0.5
"""Of the uncertainty of the grid, below which it changes that by less than an eighth."""
MIN_SHARE_BETWEEN_RUNS = 0.5
"""Share of what comes again within runs that comes again between them where it is the same."""


@dataclass(frozen=True)
class LackOfFit:
    """What tables leave in every pass.

    Attributes
    ----------
    square, u : float
        m^2; mean square of the length across the path, which may come out negative, and its
        standard uncertainty.
    lines : int
        Lines that were driven more than once.
    between : float, optional
        m^2; the same mean square between passes of different runs, where there are enough.
    """

    square: float
    u: float
    lines: int
    between: float | None = None

    @property
    def size(self) -> float:
        """Root mean square of the length across the path, m; zero where noise hides it."""
        return float(np.sqrt(max(self.square, 0.0)))

    def warning(self, grid_u: float) -> str | None:
        """Words where it is sure, and matters beside the uncertainty of the grid (m)."""
        if (
            self.lines < MIN_REPEATED_LINES
            or self.square < MIN_SIGNIFICANCE * self.u
            or self.size < MIN_SHARE_OF_U * grid_u
        ):
            return None
        cause = (
            'the tracker has an error when pointing there, or the machine changed between the runs'
            if self.between is not None and self.between < MIN_SHARE_BETWEEN_RUNS * self.square
            else 'the machine behaves in a way that tables of single axes cannot represent '
            '(waves of a screw, steps, sag, the second order of large errors), or the tracker has '
            'an error when pointing there'
        )
        where = '' if self.between is None else ' of a run'
        return (
            f'in every pass{where} over a line the tables leave the same residual of '
            f'{1e6 * self.size:.2g} um, compared with a mean uncertainty of the grid of '
            f'{1e6 * grid_u:.2g} um: {cause}; the stated errors are wrong by at least as much, '
            f'which u does not include; ./otf diagnose searches for the cause'
        )


def find_lack_of_fit(runs: Sequence[Observed], joint: JointSolution) -> LackOfFit | None:
    """What a solution leaves in every pass; None where no line was driven twice.

    Parameters
    ----------
    runs : sequence of Observed
        With the pieces of the solution.
    """
    if any(run.pieces.standstill or run.shape is None for run in runs):
        return None
    across = [np.einsum('cp,cpi->pi', s.residual, s.system.axes) for s in joint.runs]
    residual = np.concatenate(across)
    line, one, other, alike = _pairs(runs, joint)

    def of_pairs(which: NDArray[np.bool_]) -> LackOfFit | None:
        if not which.any():
            return None
        return _mean_products(line[which], one[which], other[which], residual, joint)

    within, between = of_pairs(alike), of_pairs(~alike)
    if between is None or between.lines < MIN_REPEATED_LINES:
        return within
    if within is None or within.lines < MIN_REPEATED_LINES:
        return between
    return replace(within, between=between.square)


def _mean_products(
    line: Index, one: Index, other: Index, residual: Array, joint: JointSolution
) -> LackOfFit:
    """Mean product of pairs of pieces, given by their lines and places through all runs."""
    product = np.einsum('pi,pi->p', residual[one], residual[other])
    some = np.unique(np.linspace(0, len(one) - 1, MAX_PAIRS).astype(np.int64))
    rows = [_rows(joint, of[some]) for of in (one, other)]
    of_unknowns = np.einsum(
        'pik,kl,pil->p', rows[0], joint.solution.covariance, rows[1], optimize=True
    )
    total, count = np.bincount(line, product), np.bincount(line)
    total, count = total[count > 0], count[count > 0]
    mean = float(total.sum() / count.sum())
    scatter = float(np.sqrt(np.sum((total - mean * count) ** 2)) / count.sum())
    return LackOfFit(mean + float(of_unknowns.mean()), scatter, len(count))


def _rows(joint: JointSolution, places: Index) -> Array:
    """Derivatives (m, 3, full) across the path of pieces, counted through all runs."""
    rows = np.zeros((len(places), 3, joint.unknowns.full))
    first = 0
    for run in joint.runs:
        end = first + len(run.system.q)
        own = (places >= first) & (places < end)
        piece = places[own] - first
        rows[own] = np.einsum(
            'cpi,cpk->pik', run.system.axes[:, piece], run.system.rows.dense(piece)
        )
        first = end
    return rows


def _pairs(
    runs: Sequence[Observed], joint: JointSolution
) -> tuple[Index, Index, Index, NDArray[np.bool_]]:
    """Line and both pieces of every two passes that follow each other over the same place.

    And whether both are of one run.
    """
    lines, cells, legs, straight = [], [], [], []
    for k, (run, solved) in enumerate(zip(runs, joint.runs, strict=True)):
        direction, q = _without_sense(run.pieces.direction), solved.system.q
        along = np.einsum('pi,pi->p', q, direction)
        foot = q - along[:, None] * direction
        lines.append(np.rint(np.hstack([direction / SAME_DIRECTION, foot / SAME_LINE])))
        cells.append(np.floor(along / PLACE_LENGTH).astype(np.int64))
        legs.append(np.column_stack([np.full(len(q), k), run.pieces.leg]))
        on_curves = (
            run.shape is not None
            and not run.shape.straight
            and run.shape.curved[run.pieces.stretch]
        )
        straight.append(np.broadcast_to(np.logical_not(on_curves), len(q)))
    use = np.flatnonzero(np.concatenate(straight))
    if not len(use):
        return use, use, use, np.zeros(0, dtype=bool)
    line, cell = _numbered(np.concatenate(lines)[use]), np.concatenate(cells)[use]
    run, leg = np.concatenate(legs)[use].T
    order = np.lexsort([leg, run, cell, line])
    passes = np.column_stack([line, cell, run, leg])[order]
    first = np.append(True, np.any(passes[1:] != passes[:-1], axis=1))
    passes, piece = passes[first], use[order[first]]
    again = np.all(passes[1:, :2] == passes[:-1, :2], axis=1)
    alike = passes[1:, 2] == passes[:-1, 2]
    return passes[1:, 0][again], piece[:-1][again], piece[1:][again], alike[again]


def _numbered(lines: Array) -> Index:
    """Numbers (p,) of lines (p, 6), alike for those that are alike; neighbours mostly are."""
    new = np.append(True, np.any(lines[1:] != lines[:-1], axis=1))
    number = np.unique(lines[new], axis=0, return_inverse=True)[1].reshape(-1)
    return np.asarray(number[np.cumsum(new) - 1])


def _without_sense(direction: Array) -> Array:
    """Directions (p, 3) of which the largest component is positive."""
    largest = np.argmax(np.round(np.abs(direction), 6), axis=1)
    sign = np.sign(direction[np.arange(len(direction)), largest])
    return np.asarray(direction * sign[:, None])
