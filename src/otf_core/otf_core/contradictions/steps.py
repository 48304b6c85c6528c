# SPDX-License-Identifier: Apache-2.0
"""Columns that begin at a moment: what a step there would explain, for many moments at once.

A step at moment t is the sum of the columns of all time blocks after t, so sums over blocks give
the normal matrix, its product with the model and the score of every candidate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from otf_core.arrays import Array, Index
from otf_core.contradictions.quick_fit import Fit, gain
from otf_core.contradictions.quick_rows import Rows


@dataclass(frozen=True)
class Profile:
    """What a step explains, moment by moment.

    Attributes
    ----------
    start : ndarray of int64, shape (m,)
        First piece, in order of time, that lies after each moment.
    gain : ndarray, shape (m,)
        Drop of the weighted sum of squares.
    value : ndarray, shape (m, k)
        Size of the step.
    """

    start: Index
    gain: Array
    value: Array


def step_profile(
    rows: Rows, fit: Fit, columns: Array, order: Index, starts: Index, prior: float = 1.0
) -> Profile:
    """Try a step at every moment.

    Parameters
    ----------
    rows : Rows
    fit : Fit
    columns : ndarray, shape (c p, k)
        What steps; zero for pieces of other runs.
    order : ndarray of int64, shape (n,)
        Pieces of the run in order of time.
    starts : ndarray of int64, shape (m,), ascending
        Moments: places in ``order`` from which on the step is there; the first above 0.
    prior : float
        Standard deviation of the step before the data.
    """
    components, width = len(rows.axes), columns.shape[1]
    block = np.full(len(rows), -1)
    block[order] = np.searchsorted(starts, np.arange(len(order)), side='right') - 1
    row_block = np.tile(block, components)
    use = np.flatnonzero(row_block >= 0)
    place = row_block[use, None] * width + np.arange(width)
    values = columns[use] * fit.weight[use, None]
    entries = values.ravel(), (place.ravel(), np.repeat(use, width))
    blocks = sparse.csr_array(entries, shape=(len(starts) * width, len(row_block)))

    def after(sums: Array) -> Array:
        turned = sums.reshape(len(starts), -1)[::-1]
        np.cumsum(turned, axis=0, out=turned)
        return sums

    cross = after(fit.design.sums(blocks))
    score = after(blocks @ fit.residual).reshape(-1, width)
    own = after(blocks @ columns).reshape(-1, width, width)
    half = linalg.solve_triangular(
        fit.factor[0], cross.T, lower=True, overwrite_b=True, check_finite=False
    ).reshape(-1, len(starts), width)
    left = own - np.einsum('amk,aml->mkl', half, half)
    return Profile(starts, *gain(left, score, prior))
