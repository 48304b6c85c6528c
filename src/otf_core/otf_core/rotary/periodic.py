# SPDX-License-Identifier: Apache-2.0
"""Functions of the angle of an endless axis: cubic B-splines that repeat after a full turn.

The same face as ``solving.basis.Basis``: coefficients, values at centres, values at positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.solving.unknowns import CUBIC, Basis


@dataclass(frozen=True)
class PeriodicBasis(Basis):
    """Uniform cubic B-splines over one turn.

    Attributes
    ----------
    knots : ndarray, shape (k,), rad
        Equally spaced; the last one is the first one a turn later.
    degree : int
    """

    @property
    def period(self) -> float:
        """A turn, rad."""
        return float(self.knots[-1] - self.knots[0])

    @property
    def periodic(self) -> bool:
        """They repeat."""
        return True

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.knots) - 1

    def _cells(self, q: Array) -> tuple[Index, Array]:
        share = np.mod((q - self.knots[0]) / self.period, 1.0) * self.size
        cell = np.minimum(share.astype(np.int64), self.size - 1)
        x = share - cell
        weight = np.stack(
            [(1 - x) ** 3, 3 * x**3 - 6 * x**2 + 4, -3 * x**3 + 3 * x**2 + 3 * x + 1, x**3], axis=1
        )
        return cell, weight / 6.0

    def matrix(self, q: Array) -> Array:
        """Values of all functions at positions q (n,), shape (n, size)."""
        cell, weight = self._cells(q)
        dense, row = np.zeros((len(q), self.size)), np.arange(len(q))
        for step in range(CUBIC + 1):
            dense[row, (cell + step - 1) % self.size] += weight[:, step]
        return dense

    @cached_property
    def centres(self) -> Array:
        """Where the functions are largest, shape (size,), rad."""
        return self.knots[:-1]


def over_turn(low: float, intervals: int) -> PeriodicBasis:
    """Periodic cubic splines over a turn from a position on, in equal intervals."""
    return PeriodicBasis(np.linspace(low, low + 2.0 * np.pi, intervals + 1), CUBIC)
