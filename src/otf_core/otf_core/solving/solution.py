# SPDX-License-Identifier: Apache-2.0
"""Rank-revealing solution of the normal equations (paper 1.2.6, 1.2.7).

The normal matrix is reduced motion by motion: a block of columns that the accepted ones leave
without information is dropped and its motion reported as not identifiable. 'Undetermined' has a
physical meaning: the data leave more than ``unidentifiable_above`` (m, rad) uncertain. What single
places of an accepted motion lack in data, its smoothness supplies (``roughness``). Symmetric
positive definite matrices are scaled to a diagonal of ones before they are factored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg.lapack import dpotrf, dpotri

from otf_core.arrays import Array, Index
from otf_core.model.motions import is_motion
from otf_core.solving.normal import NormalEquations
from otf_core.solving.unknowns import Unknowns, is_reversal

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


TIE_BREAK = 1e-2
"""Weight of the smoothness condition, in units of 1 / unidentifiable_above^2."""
BENDS = 0.1
"""The same where it is judged what the data show of single values: what they show is then known to
less than the limit, what they do not to several times it."""
SIZE_WEIGHT = 1e-2
"""Weight of the size of the values beside that of their second differences."""


@dataclass(frozen=True)
class Solution:
    """Estimates of the full vector of unknowns.

    Attributes
    ----------
    value : ndarray, shape (full,), m and rad
    covariance : ndarray, shape (full, full)
        For the noise assumed in the normal equations and the prior.
    accepted : tuple of str
        Blocks that were solved for; all others are zero.
    unknowns : int
        Free unknowns after the gauge.
    data : ndarray, shape (k, k)
        Normal matrix of those solved for, in units of ``unidentifiable_above``.
    """

    value: Array
    covariance: Array
    accepted: tuple[str, ...]
    unknowns: int
    data: Array

    @cached_property
    def rank(self) -> int:
        """Independent combinations of the unknowns that the data determine."""
        return int(np.sum(linalg.eigvalsh(self.data) > 1.0))


def smoothness(unknowns: Unknowns) -> Array:
    """Tie-breaker where no roughness is known: squared second differences, a trace of size."""
    total = np.zeros((unknowns.full, unknowns.full))
    for name, block in unknowns.blocks.items():
        count = block.stop - block.start
        if count > 2 and is_motion(name):
            bend = np.diff(np.eye(count), 2, axis=0)
            total[block, block] = bend.T @ bend
    gauge = unknowns.gauge.toarray()
    return np.asarray(gauge.T @ total @ gauge + SIZE_WEIGHT * np.eye(unknowns.free))


def identifiable_blocks(
    normal: NormalEquations, unknowns: Unknowns, limit: float
) -> tuple[str, ...]:
    """Blocks that add information to the ones before them.

    Parameters
    ----------
    normal : NormalEquations
        Of a system built with ``nodal_lever``.
    limit : float
        m and rad; ``unidentifiable_above``. In its units an eigenvalue of the normal matrix
        below 1 means undetermined.

    Notes
    -----
    Reversal is not solved for where the motion itself is not identifiable: what little tells
    them apart is the shape assumed along the axis, no property of the machine.
    """
    matrix = normal.matrix * limit**2
    smooth = smoothness(unknowns)
    accepted: list[str] = []
    factor = np.zeros_like(matrix)
    use = np.zeros(0, dtype=int)
    for name, block in unknowns.free_blocks.items():
        new = np.arange(block.start, block.stop)
        if not new.size or (is_reversal(name) and name[:3] not in accepted):
            continue
        old, end = use.size, use.size + new.size
        cross = np.zeros((0, new.size))
        if old:  # SciPy 1.11, which Ubuntu 24.04 has, refuses an empty system
            cross = linalg.solve_triangular(
                factor[:old, :old], matrix[np.ix_(use, new)], lower=True, check_finite=False
            )
        added = matrix[np.ix_(new, new)] - cross.T @ cross
        if linalg.eigvalsh(added)[-1] <= 1.0:
            continue
        factor[old:end, :old] = cross.T
        factor[old:end, old:end] = linalg.cholesky(
            added + TIE_BREAK * smooth[np.ix_(new, new)], lower=True
        )
        use = np.concatenate([use, new])
        accepted.append(name)
    return tuple(accepted)


def free_columns(unknowns: Unknowns, blocks: Sequence[str]) -> Index:
    """Places of blocks in the free vector."""
    parts = (unknowns.free_blocks[n] for n in blocks)
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def solve(
    normal: NormalEquations,
    unknowns: Unknowns,
    limit: float,
    accepted: tuple[str, ...],
    prior: Array,
) -> Solution:
    """Solve in the gauge of ``unknowns``.

    Parameters
    ----------
    limit : float
        m and rad; ``unidentifiable_above``.
    accepted : tuple of str
        Blocks to solve for.
    prior : ndarray, shape (free, free), 1 / (m, rad)^2
        Inverse covariance before any data, see ``roughness.Roughness``.
    """
    use = free_columns(unknowns, accepted)
    data = normal.matrix[np.ix_(use, use)] * limit**2
    weight = data + prior[np.ix_(use, use)] * limit**2
    factor = Positive(weight)
    free = np.zeros(unknowns.free)
    free[use] = factor.solve(normal.right[use] * limit)
    cover = np.zeros((unknowns.free, unknowns.free))
    cover[np.ix_(use, use)] = factor.inverse
    covariance = unknowns.lifted(cover)
    value = unknowns.gauge @ free * limit
    return Solution(value, covariance * limit**2, accepted, unknowns.free, data)


def determined_by_data(
    normal: NormalEquations,
    unknowns: Unknowns,
    accepted: tuple[str, ...],
    limit: float,
    rows: Array,
) -> NDArray[np.bool_]:
    """Determine which combinations of unknowns the data determine without what is known before.

    Parameters
    ----------
    limit : float
        m and rad; ``unidentifiable_above``.
    rows : ndarray, shape (m, full)
        Such as the nodes of the tables, see ``tabulate.Tabulation``.

    Returns
    -------
    ndarray of bool, shape (m,)
    """
    use = free_columns(unknowns, accepted)
    place = np.ix_(use, use)
    weight = normal.matrix[place] * limit**2 + BENDS * smoothness(unknowns)[place]
    own = (rows @ unknowns.gauge)[:, use]
    return np.asarray(np.einsum('ij,ji->i', own, Positive(weight).solve(own.T)) <= 1.0)
