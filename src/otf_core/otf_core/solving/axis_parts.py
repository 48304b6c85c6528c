# SPDX-License-Identifier: Apache-2.0
"""What the error motions of one axis do at places: splines of its position, and a lever arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class AxisPart:
    """What the motions of one axis do at some places.

    Attributes
    ----------
    first : ndarray of int64, shape (p,)
        First spline that differs from zero at each place.
    weight : ndarray, shape (p, n)
        Values of this and the following ones.
    lever : ndarray, shape (p, 3) or (p, n, 3), m
        Lever arm of the rotations, for every spline where they differ.
    starts : ndarray of int64, shape (6,)
        Places of the blocks of the three translations and three rotations, full vector.
    size : int
        Splines of the axis.
    """

    first: Index
    weight: Array
    lever: Array
    starts: Index
    size: int

    @cached_property
    def splines(self) -> sparse.csr_array:
        """Values of all splines, shape (p, size)."""
        count, width = self.weight.shape
        small = np.int32 if count * width < np.iinfo(np.int32).max else np.int64
        places = (self.first[:, None] + np.arange(width)).ravel().astype(small)
        ends = np.arange(0, count * width + 1, width, dtype=small)
        shape = (count, self.size)
        return sparse.csr_array((self.weight.ravel(), places, ends), shape=shape)

    @property
    def places(self) -> Index:
        """Place of every spline of every block, full vector, shape (size, 6)."""
        return self.starts + np.arange(self.size)[:, None]

    def at(self, place: Index | slice) -> AxisPart:
        """Return the part at some of the places."""
        return replace(
            self, first=self.first[place], weight=self.weight[place], lever=self.lever[place]
        )


@dataclass(frozen=True)
class ReversalPart:
    """What the reversal of the motions of one axis does at some places.

    Attributes
    ----------
    splines : ndarray, shape (p, k)
        What the polynomials come to, see ``reversal.reversal_weights``.
    lever : ndarray, shape (p, 3), m
        Lever arm of the rotations.
    places : ndarray of int64, shape (k, 6)
        Places of the coefficients of the three translations and three rotations, full vector.
    """

    splines: Array
    lever: Array
    places: Index


@dataclass(frozen=True)
class Window:
    """Splines of one axis that the shifts of some pieces reach.

    Attributes
    ----------
    parts : list of AxisPart
        One for every shift.
    first : ndarray of int64, shape (m,)
        First spline that any of them reaches.
    weights : list of ndarray, shape (m, n)
        Shares of it and the following ones in the mean, for every shift.
    kept : ndarray of int64, shape (k,)
        Which of the six motions count.
    """

    parts: list[AxisPart]
    first: Index
    weights: list[Array]
    kept: Index

    @property
    def starts(self) -> Index:
        """Places of the blocks of these motions, full vector, shape (k,)."""
        return self.parts[0].starts[self.kept]


def crossed(one: Array, other: Array) -> Array:
    """Vector products of vectors (..., 3), several times faster than ``numpy.cross``."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = other[..., 0], other[..., 1], other[..., 2]
    first = b * z - c * y
    found = np.empty((*first.shape, 3))
    found[..., 0], found[..., 1], found[..., 2] = first, c * x - a * z, a * y - b * x
    return found


def window_of(parts: list[AxisPart], kept: Index) -> Window:
    """Splines that the parts of one axis at all shifts reach."""
    if len(parts) == 1:
        return Window(parts, parts[0].first, [parts[0].weight], kept)
    first = np.minimum.reduce([part.first for part in parts])
    width = max(int(np.max(p.first - first, initial=0)) + p.weight.shape[1] for p in parts)
    first = np.minimum(first, parts[0].size - width)
    row, weights = np.arange(len(first))[:, None], []
    for part in parts:
        weight = np.zeros((len(first), width))
        place = (part.first - first)[:, None] + np.arange(part.weight.shape[1])
        weight[row, place] = part.weight / len(parts)
        weights.append(weight)
    return Window(parts, first, weights, kept)


def six_motions(direction: Array, arm: Array) -> Array:
    """Rows (p, 6, 1 or n) of three translations and three rotations along directions (p, 3)."""
    if arm.ndim == 2:
        return np.concatenate([direction, crossed(arm, direction)], axis=1)[:, :, None]
    turned = np.swapaxes(crossed(arm, direction[:, None, :]), 1, 2)
    moved = np.broadcast_to(direction[:, :, None], turned.shape)
    return np.concatenate([moved, turned], axis=1)
