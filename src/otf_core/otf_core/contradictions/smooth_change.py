# SPDX-License-Identifier: Apache-2.0
"""A step against a smooth change: what drifts with time and place is no tracker that moved.

Smooth change: a rigid motion, a strain of the volume and a reversal of the axes, each a polynomial
of time. A step in time is a kink that no polynomial of low order follows; an axis that expands, or
play that grows, is followed to the end.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import Legendre
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.contradictions.quick_fit import Fit, gain
from otf_core.contradictions.quick_rows import UNIT, Rows, pose_columns, reversal_columns

ORDER, USUAL = 6, 3
"""Highest order of the polynomials, and that of the rigid motions in the usual model."""


def sharp_share(rows: Rows, fit: Fit, run: int, time: float) -> float:
    """Share of what a step explains that a smooth change does not explain as well.

    Parameters
    ----------
    rows : Rows
    fit : Fit
        Of the usual model.
    run : int
    time : float
        s; first piece after the step.
    """
    mine = rows.run == run
    pose = pose_columns(rows)
    step = pose * _per_row(rows, mine & (rows.time >= time))
    smooth = np.concatenate(_smooth(rows, mine, pose), axis=1)
    left, score = fit.left(np.hstack([step, smooth])), fit.score(np.hstack([step, smooth]))
    both, _ = gain(left, score)
    width = step.shape[1]
    alone, _ = gain(left[:width, :width], score[:width])
    followed, _ = gain(left[width:, width:], score[width:])
    return float((both - followed) / alone)


def _smooth(rows: Rows, mine: NDArray[np.bool_], pose: Array) -> list[Array]:
    """Columns of a smooth change of one run beyond the usual model, in blocks (r, k)."""
    time = rows.time[mine]
    x = 2.0 * (rows.time - time.min()) / max(float(np.ptp(time)), 1e-9) - 1.0
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    strain = np.stack([
        rows.component(rows.q[:, [j]] * UNIT[i] + (i != j) * rows.q[:, [i]] * UNIT[j])
        for i, j in pairs
    ], axis=1)  # fmt: skip
    other = np.hstack([strain, reversal_columns(rows)])
    found = []
    for order in range(1, ORDER + 1):
        course = _per_row(rows, np.where(mine, Legendre.basis(order)(x), 0.0))
        found.append(other * course)
        if order > USUAL:
            found.append(pose * course)
    return found


def _per_row(rows: Rows, values: Array | NDArray[np.bool_]) -> Array:
    """Values of pieces (p,) at all rows, shape (c p, 1)."""
    return np.tile(np.asarray(values, dtype=np.float64), len(rows.axes))[:, None]
