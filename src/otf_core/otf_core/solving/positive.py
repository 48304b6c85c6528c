# SPDX-License-Identifier: Apache-2.0
"""Symmetric positive definite matrices, scaled to a diagonal of ones before they are factored."""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.linalg.lapack import dpotrf, dpotri

from otf_core.arrays import Array

RIDGES = (0.0, 1e-14, 1e-12, 1e-10)
"""Added to the diagonal of ones, the next one where rounding has made the matrix indefinite."""


class Positive:
    """Cholesky factor of a matrix.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive definite by more than rounding.
    """

    def __init__(self, matrix: Array) -> None:
        self._scale = 1.0 / np.sqrt(np.diag(matrix))
        unit = matrix * self._scale[:, None]
        unit *= self._scale
        for ridge in RIDGES:
            _diagonal(unit)[:] += ridge
            self._factor, failed = dpotrf(unit, lower=1)
            if not failed:
                return
        raise linalg.LinAlgError('matrix is not positive definite')

    def solve(self, right: Array) -> Array:
        """Solve for right sides of shape (n,) or (n, k)."""
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        inner = linalg.cho_solve((self._factor, True), right * scale, check_finite=False)
        return np.asarray(inner * scale)

    @property
    def inverse(self) -> Array:
        """Inverse matrix, shape (n, n)."""
        half = dpotri(self._factor, lower=1)[0]  # of zeros above the diagonal
        whole = np.asarray(half + half.T)
        _diagonal(whole)[:] *= 0.5
        whole *= self._scale[:, None]
        whole *= self._scale
        return whole

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant."""
        return 2.0 * float(np.sum(np.log(np.diag(self._factor)) - np.log(self._scale)))


def _diagonal(matrix: Array) -> Array:
    """View of the diagonal of a contiguous matrix, shape (n,)."""
    return np.asarray(matrix.reshape(-1, order='A')[:: len(matrix) + 1])
