# SPDX-License-Identifier: Apache-2.0
"""What the error motions of one axis do at places: splines of its position, and a lever arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index


@dataclass(frozen=True)
class AxisPart:
    """What the motions of one axis do at some places.

    Attributes
    ----------
    first : ndarray of int64, shape (p,)
        First spline that is reached at each place.
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

    @property
    def reached(self) -> Index:
        """Places of the splines that any of the places reaches, full vector, shape (k, 6)."""
        mask = np.zeros(self.size, dtype=bool)
        for step in range(self.weight.shape[1]):
            mask[self.first + step] = True
        return self.places[mask]

    def columns(self, kept: Index) -> Index:
        """Places of the splines of some blocks at every place, full vector, shape (p, k, n)."""
        splines = self.first[:, None] + np.arange(self.weight.shape[1])
        return np.asarray(splines[:, None, :] + self.starts[kept][:, None])

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
    weight : ndarray, shape (p, k)
        What the polynomials come to, see ``reversal.reversal_weights``.
    lever : ndarray, shape (p, 3), m
        Lever arm of the rotations.
    places : ndarray of int64, shape (k, 6)
        Places of the coefficients of the three translations and three rotations, full vector.
    """

    weight: Array
    lever: Array
    places: Index

    @property
    def splines(self) -> Array:
        """Values of all polynomials, shape (p, k)."""
        return self.weight

    @property
    def reached(self) -> Index:
        """Places of all coefficients."""
        return self.places

    def columns(self, kept: Index) -> Index:
        """Places of the coefficients of some motions, full vector, shape (1, k, n)."""
        return self.places.T[None, kept]

    def at(self, place: Index | slice) -> ReversalPart:
        """Return the part at some of the places."""
        return replace(self, weight=self.weight[place], lever=self.lever[place])


def crossed(one: Array, other: Array) -> Array:
    """Vector products of vectors (..., 3), several times faster than ``numpy.cross``."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = other[..., 0], other[..., 1], other[..., 2]
    first = b * z - c * y
    found = np.empty((*first.shape, 3))
    found[..., 0], found[..., 1], found[..., 2] = first, c * x - a * z, a * y - b * x
    return found


def turned_by(arms: Array, forces: Array) -> Array:
    """Vector products of arms (p, 3) with k forces each, shape (p, 3, k)."""
    x, y, z = (arms[:, i, None] for i in range(3))
    found = np.empty_like(forces)
    np.subtract(y * forces[:, 2], z * forces[:, 1], out=found[:, 0])
    np.subtract(z * forces[:, 0], x * forces[:, 2], out=found[:, 1])
    np.subtract(x * forces[:, 1], y * forces[:, 0], out=found[:, 2])
    return found


def reaching_alike(parts: Sequence[AxisPart]) -> list[AxisPart]:
    """Parts of one axis at all shifts, each with all the splines that any of them reaches."""
    first = np.minimum.reduce([part.first for part in parts])
    width = max(int(np.max(p.first - first, initial=0)) + p.weight.shape[1] for p in parts)
    first, row, found = (
        np.minimum(first, parts[0].size - width),
        np.arange(len(first))[:, None],
        [],
    )
    for part in parts:
        weight = np.zeros((len(first), width))
        weight[row, (part.first - first)[:, None] + np.arange(part.weight.shape[1])] = part.weight
        found.append(replace(part, first=first, weight=weight))
    return found


def six_motions(direction: Array, arm: Array) -> Array:
    """Rows (p, 6, 1 or n) of three translations and three rotations along directions (p, 3)."""
    if arm.ndim == 2:
        return np.concatenate([direction, crossed(arm, direction)], axis=1)[:, :, None]
    turned = np.swapaxes(crossed(arm, direction[:, None, :]), 1, 2)
    moved = np.broadcast_to(direction[:, :, None], turned.shape)
    return np.concatenate([moved, turned], axis=1)
