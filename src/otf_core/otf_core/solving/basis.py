# SPDX-License-Identifier: Apache-2.0
"""Functions of one axis position as B-splines: cubic and smooth, or linear between nodes.

f(q) = sum_k c_k B_k(q). Knots at both ends are repeated, so the first and the last coefficient
are the values there; outside the knots f is constant. Degree 1 gives the hat functions of
tables: c_k is the value at knot k.

References
----------
de Boor, A Practical Guide to Splines, Springer 2001, chapter IX. Piegl and Tiller, The NURBS
Book, Springer 1997, algorithm A2.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from otf_core.arrays import Array, Index

CUBIC, LINEAR = 3, 1


@dataclass(frozen=True)
class Basis:
    """B-splines over knots.

    Attributes
    ----------
    knots : ndarray, shape (k,), m
        Ascending; a single one for an axis that does not move.
    degree : int
        ``CUBIC`` or ``LINEAR``.
    """

    knots: Array
    degree: int

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.knots) + self.degree - 1 if len(self.knots) > 1 else 1

    @property
    def nonzero(self) -> int:
        """Functions that differ from zero at one place."""
        return min(self.degree + 1, self.size)

    @cached_property
    def _padded(self) -> Array:
        return np.pad(self.knots, self.degree, mode='edge')

    def places(self, q: Array) -> tuple[Index, Array]:
        """Functions that differ from zero at positions q (n,), m.

        Returns
        -------
        first : ndarray of int64, shape (n,)
            The first of them; the others follow.
        weight : ndarray, shape (n, nonzero)
            Their values, which add up to 1.
        """
        if self.size == 1:
            return np.zeros(len(q), dtype=np.int64), np.ones((len(q), 1))
        inside, knots = np.clip(q, self.knots[0], self.knots[-1]), self._padded
        last = len(knots) - self.degree - 2
        first = np.clip(np.searchsorted(knots, inside, 'right') - 1, self.degree, last)
        # algorithm A2.2 of The NURBS Book; scipy.interpolate takes 0.1 s to import
        weight = np.ones((self.degree + 1, len(q)))
        for order in range(1, self.degree + 1):
            saved = np.zeros(len(q))
            for k in range(order):
                above = knots[first + k + 1]
                below = knots[first + 1 + k - order]
                share = weight[k] / (above - below)
                weight[k] = saved + (above - inside) * share
                saved = (inside - below) * share
            weight[order] = saved
        return np.asarray(first - self.degree, dtype=np.int64), weight.T.copy()

    def matrix(self, q: Array) -> Array:
        """Values of all functions at positions q (n,), shape (n, size)."""
        first, weight = self.places(q)
        dense = np.zeros((len(q), self.size))
        for step in range(self.nonzero):
            dense[np.arange(len(q)), first + step] = weight[:, step]
        return dense

    @cached_property
    def centres(self) -> Array:
        """Greville abscissae, shape (size,), m: with them as coefficients f(q) = q."""
        if self.size == 1:
            return self.knots
        padded, degree = self._padded, self.degree
        return np.array([padded[k + 1 : k + degree + 1].mean() for k in range(self.size)])

    @cached_property
    def from_values(self) -> Array:
        """Coefficients of the function with given values at ``centres``, shape (size, size)."""
        return np.asarray(np.linalg.inv(self.matrix(self.centres)), dtype=float)

    def finer(self, parts: int) -> Array:
        """Knots with every interval cut into equal parts, shape (m,), m."""
        if len(self.knots) == 1:
            return self.knots
        inner = np.linspace(0.0, 1.0, parts, endpoint=False)
        low, step = self.knots[:-1], np.diff(self.knots)
        return np.append((low[:, None] + step[:, None] * inner).ravel(), self.knots[-1])


def cubic(nodes: Array, intervals: int) -> Basis:
    """Cubic splines over the range of nodes, in equal intervals."""
    if len(nodes) == 1:
        return Basis(nodes, CUBIC)
    return Basis(np.linspace(nodes[0], nodes[-1], intervals + 1), CUBIC)


def linear(nodes: Array) -> Basis:
    """Functions that are linear between nodes."""
    return Basis(nodes, LINEAR)
