# SPDX-License-Identifier: Apache-2.0
"""Columns that begin at a moment: what a step there would explain, for many moments at once.

A step at moment t is the sum of the columns of all time blocks after t, so sums over blocks give
the normal matrix, its product with the model and the score of every candidate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from otf_core.contradictions.fit import Fit, gain
from otf_core.contradictions.rows import Rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]


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
    shape = (len(row_block), len(starts) * width)
    spread = sparse.csr_array(
        (values.ravel(), (np.repeat(use, width), place.ravel())), shape=shape
    )

    def after(sums: Array) -> Array:
        return np.asarray(np.cumsum(sums[::-1], axis=0)[::-1])

    cross = (fit.design.T @ spread).toarray().reshape(-1, len(starts), width)
    cross = np.cumsum(cross[:, ::-1], axis=1)[:, ::-1]
    score = after((spread.T @ fit.residual).reshape(len(starts), width))
    own = np.zeros((len(starts), width, width))
    np.add.at(own, row_block[use], values[:, :, None] * columns[use][:, None, :])
    own = after(own)
    lower = fit.factor[0]
    half = linalg.solve_triangular(lower, cross.reshape(len(lower), -1), lower=True)
    half = half.reshape(len(lower), len(starts), width)
    left = own - np.einsum('amk,aml->mkl', half, half)
    found = [gain(a, b, prior) for a, b in zip(left, score, strict=True)]
    return Profile(starts, np.array([g for g, _ in found]), np.array([v for _, v in found]))
