# SPDX-License-Identifier: Apache-2.0
"""Functions of the angle of an endless axis: B-splines that repeat after a full turn.

The same face as ``solving.unknowns.Basis``: coefficients, values at centres, values at positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.solving.unknowns import CUBIC, LINEAR, Basis


@dataclass(frozen=True)
class PeriodicBasis(Basis):
    """B-splines over one turn: cubic over equal intervals, or linear between nodes.

    Attributes
    ----------
    knots : ndarray, shape (k,), rad
        The last one is the first one a turn later; equally spaced where cubic.
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
        """Interval of every position, and the share of it that lies below the position."""
        inside = self.knots[0] + np.mod(q - self.knots[0], self.period)
        cell = np.searchsorted(self.knots, inside, 'right') - 1
        cell = np.clip(cell, 0, self.size - 1)
        return cell, (inside - self.knots[cell]) / np.diff(self.knots)[cell]

    def matrix(self, q: Array) -> Array:
        """Values of all functions at positions q (n,), shape (n, size)."""
        cell, x = self._cells(q)
        if self.degree == LINEAR:
            weight, before = np.stack([1.0 - x, x], axis=1), 0
        else:
            weight, before = _uniform_cubic(x), 1
        dense, row = np.zeros((len(q), self.size)), np.arange(len(q))
        for step in range(self.degree + 1):
            dense[row, (cell + step - before) % self.size] += weight[:, step]
        return dense

    def linear_between(self, nodes: Array) -> PeriodicBasis:
        """Functions of a turn that are linear between nodes (n,), both ends included."""
        return PeriodicBasis(np.append(nodes[:-1], nodes[0] + 2.0 * np.pi), LINEAR)

    def at_nodes(self, nodes: Array, values: Array) -> Array:
        """Values at all nodes (n,): those at both ends are the same."""
        return np.concatenate([values, values[: len(nodes) - self.size]])

    @cached_property
    def centres(self) -> Array:
        """Where the functions are largest, shape (size,), rad."""
        return self.knots[:-1]


def _uniform_cubic(x: Array) -> Array:
    """The four functions that differ from zero, shape (n, 4), at shares (n,) of an interval."""
    four = [(1 - x) ** 3, 3 * x**3 - 6 * x**2 + 4, -3 * x**3 + 3 * x**2 + 3 * x + 1, x**3]
    return np.stack(four, axis=1) / 6.0


def over_turn(low: float, intervals: int) -> PeriodicBasis:
    """Periodic cubic splines over a turn from a position on, in equal intervals."""
    return PeriodicBasis(np.linspace(low, low + 2.0 * np.pi, intervals + 1), CUBIC)
