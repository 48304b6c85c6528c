# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares on ``quick_rows``, robust, and what further columns would explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.contradictions.quick_design import Design
from otf_core.contradictions.quick_rows import Rows
from otf_core.pieces.pieces import RAYLEIGH_MEDIAN

PRIOR = 1e-3
"""m and rad; standard deviation of every unknown before the data: fixes what nothing shows."""
FAR = 8.0
"""Robust standard deviations beyond which a piece is left out."""
REPEATS = 3


@dataclass(frozen=True)
class Fit:
    """A solved model.

    Attributes
    ----------
    design : Design
    weight : ndarray, shape (r,), 1/m^2
        Zero for pieces left out.
    factor : tuple
        Cholesky factor of the normal matrix.
    value : ndarray, shape (k,), m and rad
    residual : ndarray, shape (r,), m
    freedom : float
        Rows less the unknowns that the data determine; not a number where the weights were given.
    """

    design: Design
    weight: Array
    factor: tuple[Array, bool]
    value: Array
    residual: Array
    freedom: float

    @property
    def square(self) -> float:
        """Weighted sum of squares of the residuals."""
        return float(self.weight @ self.residual**2)

    @property
    def ratio(self) -> float:
        """Residual over the noise expected, root mean square per degree of freedom."""
        return float(np.sqrt(self.square / max(self.freedom, 1.0)))

    @property
    def rms(self) -> float:
        """Residual of a row per degree of freedom, m, weighted as in the fit."""
        return self.ratio * float(np.sqrt(np.sum(self.weight > 0) / self.weight.sum()))

    def left(self, columns: Array) -> Array:
        """Normal matrix of further columns (r, k) once those of the model are free."""
        weighted = columns * self.weight[:, None]
        cross = self.design.products(weighted)
        solved = linalg.cho_solve(self.factor, cross, check_finite=False)
        return np.asarray(columns.T @ weighted - cross.T @ solved)

    def score(self, columns: Array) -> Array:
        """Weighted products of further columns (r, k) with the residual."""
        return np.asarray(columns.T @ (self.weight * self.residual))


def gain(left: Array, score: Array, prior: float = PRIOR) -> tuple[Array, Array]:
    """Drop of the sum of squares that further columns bring, and their values.

    Parameters
    ----------
    left : ndarray, shape (..., k, k)
        From ``Fit.left``; one or many.
    score : ndarray, shape (..., k)
    prior : float
        Standard deviation of the values before the data.

    Returns
    -------
    drop : ndarray, shape (...)
    value : ndarray, shape (..., k)
    """
    root, vectors = np.linalg.eigh(left)
    least = np.maximum(1e-9 * root[..., -1:], 1.0 / prior**2)
    seen = np.einsum('...ij,...i->...j', vectors, score) / np.maximum(root, least)
    value = np.einsum('...ij,...j->...i', vectors, seen)
    return np.asarray(np.sum(score * value, axis=-1)), np.asarray(value)


def _solve(design: Design, target: Array, weight: Array) -> tuple[tuple[Array, bool], Array]:
    data = design.normal(weight)
    data[np.diag_indices_from(data)] += 1.0 / PRIOR**2
    factor = linalg.cho_factor(data, lower=True, overwrite_a=True, check_finite=False)
    score = design.products((weight * target)[:, None])[:, 0]
    return factor, linalg.cho_solve(factor, score, check_finite=False)


def _freedom(factor: tuple[Array, bool], weight: Array) -> float:
    inverse, _ = linalg.lapack.dtrtri(factor[0], lower=1)  # of a triangle, which tells the trace
    unknowns = len(inverse) - float(np.sum(np.tril(inverse) ** 2)) / PRIOR**2
    return float(np.sum(weight > 0)) - unknowns


def solve(rows: Rows, design: Design, weight: Array | None = None) -> Fit:
    """Solve for columns, leaving out pieces far from the solution.

    Parameters
    ----------
    rows : Rows
    design : Design
    weight : ndarray, shape (r,), 1/m^2, optional
        As of another fit, so that both are judged alike; then nothing more is left out.
    """
    target = rows.deviation.ravel()
    given = weight is not None
    used = 1.0 / rows.sigma.ravel() ** 2 if weight is None else weight
    full = used
    for _ in range(1 if given else REPEATS):
        factor, value = _solve(design, target, used)
        residual = target - design.times(value)
        size = np.sqrt(full * residual**2).reshape(rows.deviation.shape)
        distance = np.linalg.norm(size, axis=0)
        far = distance > FAR * float(np.median(distance)) / RAYLEIGH_MEDIAN
        now = full if given else np.where(np.tile(far, len(size)), 0.0, full)
        if np.array_equal(now > 0, used > 0):
            break
        used = now
    else:
        if not given:
            factor, value = _solve(design, target, used)
            residual = target - design.times(value)
    freedom = np.nan if given else _freedom(factor, used)
    return Fit(design, used, factor, value, np.asarray(residual), freedom)
