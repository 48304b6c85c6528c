# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the rows of all pieces by the unknowns, never all of them at once.

A row is a . J(q) for the direction a of the row: motions of one axis share the splines of its
position, and a rotation acts as r . (L x a) for its lever arm L. So products with a vector need
the error vector of every piece only, and dense rows are made for a few legs at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.model.kinematics import lever, squareness_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.solving.reversal import reversal_columns
from otf_core.solving.unknowns import Unknowns, is_reversal, pose_block

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SOME, MANY = 2048, 8192
"""Pieces whose reversal, or products with columns, are made together."""
HELD = 150_000
"""Pieces whose splines are held; those of a longer run are made anew whenever they are used."""


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

    def at(self, place: Index | slice) -> AxisPart:
        """Return the part at some of the places."""
        return replace(
            self, first=self.first[place], weight=self.weight[place], lever=self.lever[place]
        )


@dataclass(frozen=True)
class Design:
    """Derivatives of the deviations, means over the samples of every piece.

    Attributes
    ----------
    machine : Machine
    unknowns : Unknowns
    run : int
        Which pose block the rows belong to.
    q, points : ndarray, shape (p, 3), m
        Nominal positions and measured points of the pieces, machine frame.
    axes : ndarray, shape (c, p, 3)
        Directions of the rows.
    shifts : tuple of ndarray, shape (p, 3) or (3,), m
        Places within a piece whose values are averaged, from its centre.
    travel : ndarray, shape (p, 3)
        Unit direction of travel or approach.
    side : ndarray, shape (p, 3)
        See ``reversal.reversal_columns``.
    nodal_lever : bool
        See ``system.build_system``.
    """

    machine: Machine
    unknowns: Unknowns
    run: int
    q: Array
    points: Array
    axes: Array
    shifts: tuple[Array, ...]
    travel: Array
    side: Array
    nodal_lever: bool = False

    def at(self, pieces: Index) -> Design:
        """Return the derivatives of some pieces, by their places."""
        return replace(
            self,
            q=self.q[pieces],
            points=self.points[pieces],
            axes=self.axes[:, pieces],
            shifts=tuple(s if s.ndim == 1 else s[pieces] for s in self.shifts),
            travel=self.travel[pieces],
            side=self.side[pieces],
        )

    @cached_property
    def _parts(self) -> list[list[AxisPart]]:
        """The three axes at every shift, at all pieces."""
        return self._made(slice(None))

    def _made(self, pieces: Index | slice) -> list[list[AxisPart]]:
        q, shifts = self.q[pieces], [s if s.ndim == 1 else s[pieces] for s in self.shifts]
        return [[self._part(k, q + shift) for k in range(3)] for shift in shifts]

    def _at(self, pieces: Index | slice) -> list[list[AxisPart]]:
        """The three axes at every shift, at some pieces."""
        if len(self.q) > HELD:
            return self._made(pieces)
        return [[part.at(pieces) for part in parts] for parts in self._parts]

    def _part(self, axis: int, q: Array) -> AxisPart:
        name = self.machine.axis_names[axis]
        basis = self.unknowns.bases[name]
        first, weight = basis.places(q[:, axis])
        arm = lever(self.machine, name, q)
        if self.nodal_lever:
            nodal = np.repeat(q[:, None, :], basis.nonzero, axis=1)
            nodal[:, :, axis] = basis.centres[first[:, None] + np.arange(basis.nonzero)]
            arm = lever(self.machine, name, nodal.reshape(-1, 3)).reshape(nodal.shape)
        starts = np.array([self.unknowns.blocks[m].start for m in MOTIONS if m.axis == name])
        return AxisPart(first, weight, arm, starts, basis.size)

    @property
    def _pose(self) -> Index:
        block = self.unknowns.blocks[pose_block(self.run)]
        return np.arange(block.start, block.stop)

    @property
    def _angles(self) -> Index:
        return np.array([self.unknowns.blocks[name].start for name in SQUARENESS])

    @property
    def _reversals(self) -> Index:
        blocks = self.unknowns.blocks
        return np.array([blocks[n].start for n in blocks if is_reversal(n)], dtype=np.int64)

    def _reversal(self, pieces: Index | slice) -> Array:
        """Displacements (m, 3, k) by the reversal coefficients of some pieces."""
        q, fixed = self.q[pieces], (self.travel[pieces], self.side[pieces])
        found = np.zeros((*q.shape, len(self._reversals)))
        if not self.unknowns.reversal:
            return found
        place = {n: k for k, n in enumerate(filter(is_reversal, self.unknowns.blocks))}
        at = [q + (s if s.ndim == 1 else s[pieces]) for s in self.shifts]
        travel, side = (np.concatenate([values] * len(at)) for values in fixed)
        places = np.concatenate(at)
        names, columns = reversal_columns(self.machine, places, travel, side, self.unknowns)
        mean = columns.reshape(len(at), *q.shape, len(names)).mean(axis=0)
        found[:, :, [place[name] for name in names]] = mean
        return found

    def _blocks(self, size: int) -> Iterator[slice]:
        """Pieces, some at a time."""
        return (slice(low, low + size) for low in range(0, len(self.q), size))

    def _few(self, pieces: Index | slice) -> tuple[Index, Array]:
        """Places (k,) and rows (c, m, k) of pose, squareness and reversal."""
        axes, q = self.axes[:, pieces], self.q[pieces]
        # a . (dr x p) = dr . (p x a); what squareness does is linear within a piece
        angles = np.stack([squareness_influence(name, q) for name in SQUARENESS], axis=2)
        influence = np.concatenate([angles, self._reversal(pieces)], axis=2)
        rows = [-axes, -crossed(self.points[pieces], axes)]
        rows.append(np.einsum('cpi,pik->cpk', axes, influence))
        return np.concatenate([self._pose, self._angles, self._reversals]), np.concatenate(
            rows, axis=2
        )

    def released(self) -> Design:
        """Return the same without what products keep to be fast."""
        return replace(self)

    def prepare(self) -> None:
        """Make what all rows share; afterwards rows may be made by several threads."""
        if len(self.q) <= HELD:
            self._parts  # noqa: B018

    def dense(self, pieces: Index | slice) -> Array:
        """Rows of some pieces, shape (c, m, full)."""
        full = self.unknowns.full
        few, windows = self._few(pieces), self._windows(pieces)
        return self._filled(pieces, few, windows, np.arange(full), full)

    def touched(self, pieces: Index, width: int = 0) -> tuple[Index, Array]:
        """Rows of some pieces by the unknowns that they depend on.

        Parameters
        ----------
        pieces : ndarray of int64
            m of the pieces.
        width : int
            Further columns of zeros behind the unknowns.

        Returns
        -------
        columns : ndarray of int64, shape (k,)
            Places of these unknowns in the full vector, ascending.
        rows : ndarray, shape (c, m, k + width)
        """
        windows, few = self._windows(pieces), self._few(pieces)
        mask = np.zeros(self.unknowns.full, dtype=bool)
        mask[few[0]] = True
        for window in windows:
            own = np.zeros(window.parts[0].size, dtype=bool)
            for step in range(window.weights[0].shape[1]):
                own[window.first + step] = True
            for start in window.parts[0].starts.tolist():
                mask[start : start + len(own)] |= own
        columns = np.flatnonzero(mask)
        size = len(columns) + width
        return columns, self._filled(pieces, few, windows, np.cumsum(mask) - 1, size)

    def _windows(self, pieces: Index | slice) -> list[_Window]:
        """What the three axes do at some pieces."""
        return [_window(list(parts)) for parts in zip(*self._at(pieces), strict=True)]

    def _filled(
        self,
        pieces: Index | slice,
        few: tuple[Index, Array],
        windows: Sequence[_Window],
        place_of: Index,
        size: int,
    ) -> Array:
        """Rows (c, m, size) of some pieces, every unknown in the column of its own."""
        axes = self.axes[:, pieces]
        dense = np.zeros((*axes.shape[:2], size))
        dense[:, :, place_of[few[0]]] = few[1]
        flat = dense.reshape(len(axes), -1)
        row = (np.arange(axes.shape[1]) * size)[:, None, None]
        for window in windows:
            splines = window.first[:, None] + np.arange(window.weights[0].shape[1])
            place = row + place_of[splines[:, None, :] + window.parts[0].starts[:, None]]
            for values, direction in zip(flat, axes, strict=True):
                values[place] = sum(
                    _six(direction, part.lever) * weight[:, None, :]
                    for part, weight in zip(window.parts, window.weights, strict=True)
                )
        return dense

    @property
    def splines(self) -> Index:
        """First spline of every axis at every piece, shape (p, 3)."""
        found = [[part.first for part in self._at(some)[0]] for some in self._blocks(MANY)]
        return np.concatenate([np.stack(first, axis=1) for first in found])

    @cached_property
    def csr(self) -> sparse.csr_array:
        """All rows as a sparse matrix, shape (c p, full): rows of one direction, then the next."""
        count = self.axes.shape[1]
        blocks = [
            sparse.csr_array(dense)
            for c in range(len(self.axes))
            for dense in (self.dense(slice(low, low + 1024))[c] for low in range(0, count, 1024))
        ]
        return sparse.csr_array(sparse.vstack(blocks))

    def times(self, value: Array) -> Array:
        """Deviations for values of the unknowns.

        Parameters
        ----------
        value : ndarray, shape (full,) or (full, k)

        Returns
        -------
        ndarray, shape (c, p) or (c, p, k)
        """
        if value.ndim > 1:
            return np.stack([self.times(v) for v in value.T], axis=2)
        moved, angles, sizes = (value[k] for k in (self._pose, self._angles, self._reversals))
        total = -moved[:3] - crossed(moved[3:], self.points)
        for angle, name in zip(angles, SQUARENESS, strict=True):
            total += angle * squareness_influence(name, self.q)
        if np.any(sizes):
            for some in self._blocks(SOME):
                total[some] += self._reversal(some) @ sizes
        for some in self._blocks(MANY):
            for part in chain.from_iterable(self._at(some)):
                six = part.splines @ value[part.starts + np.arange(part.size)[:, None]]
                total[some] += (six[:, :3] + crossed(six[:, 3:], part.lever)) / len(self.shifts)
        return np.asarray(np.einsum('cpi,pi->cp', self.axes, total))

    def transposed(self, rows: Array) -> Array:
        """Transposed design times rows (c, p) or (c, p, k), shape (full,) or (full, k)."""
        wide = rows.reshape(*rows.shape[:2], -1)
        found = np.zeros((self.unknowns.full, wide.shape[2]))
        for some in self._blocks(MANY):
            self._add_transposed(some, wide[:, some], found)
        return found.reshape(-1, *rows.shape[2:])

    def pulled(self, some: slice, rows: Array) -> Array:
        """Transposed design of some pieces times rows (c, m, k), shape (full, k)."""
        found = np.zeros((self.unknowns.full, rows.shape[2]))
        self._add_transposed(some, rows, found)
        return found

    def _add_transposed(self, some: slice, rows: Array, found: Array) -> None:
        """Add the transposed rows of some pieces times rows (c, m, k) to found (full, k)."""
        q, pull = self.q[some], np.einsum('cpi,cpk->pki', self.axes[:, some], rows)
        turned = crossed(self.points[some, None, :], pull)
        found[self._pose] -= np.concatenate([pull.sum(axis=0), turned.sum(axis=0)], axis=1).T
        for place, name in zip(self._angles.tolist(), SQUARENESS, strict=True):
            found[place] += np.einsum('pi,pki->k', squareness_influence(name, q), pull)
        if self.unknowns.reversal:
            columns = self._reversal(some)
            found[self._reversals] += np.einsum('pij,pki->jk', columns, pull, optimize=True)
        for part in chain.from_iterable(self._at(some)):
            six = np.concatenate([pull, crossed(part.lever[:, None, :], pull)], axis=2)
            own = part.splines.T @ six.reshape(len(six), -1) / len(self.shifts)
            place = part.starts + np.arange(part.size)[:, None]
            found[place] += np.swapaxes(own.reshape(part.size, -1, 6), 1, 2)


@dataclass(frozen=True)
class _Window:
    """Splines of one axis that the shifts of some pieces reach.

    Attributes
    ----------
    parts : list of AxisPart
        One for every shift.
    first : ndarray of int64, shape (m,)
        First spline that any of them reaches.
    weights : list of ndarray, shape (m, n)
        Shares of it and the following ones in the mean, for every shift.
    """

    parts: list[AxisPart]
    first: Index
    weights: list[Array]


def crossed(one: Array, other: Array) -> Array:
    """Vector products of vectors (..., 3), several times faster than ``numpy.cross``."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = other[..., 0], other[..., 1], other[..., 2]
    first = b * z - c * y
    found = np.empty((*first.shape, 3))
    found[..., 0], found[..., 1], found[..., 2] = first, c * x - a * z, a * y - b * x
    return found


def _window(parts: list[AxisPart]) -> _Window:
    if len(parts) == 1:
        return _Window(parts, parts[0].first, [parts[0].weight])
    first = np.minimum.reduce([part.first for part in parts])
    width = max(int(np.max(p.first - first, initial=0)) + p.weight.shape[1] for p in parts)
    first = np.minimum(first, parts[0].size - width)
    row, weights = np.arange(len(first))[:, None], []
    for part in parts:
        weight = np.zeros((len(first), width))
        place = (part.first - first)[:, None] + np.arange(part.weight.shape[1])
        weight[row, place] = part.weight / len(parts)
        weights.append(weight)
    return _Window(parts, first, weights)


def _six(direction: Array, arm: Array) -> Array:
    """Rows (p, 6, 1 or n) of three translations and three rotations along directions (p, 3)."""
    if arm.ndim == 2:
        return np.concatenate([direction, crossed(arm, direction)], axis=1)[:, :, None]
    turned = np.swapaxes(crossed(arm, direction[:, None, :]), 1, 2)
    moved = np.broadcast_to(direction[:, :, None], turned.shape)
    return np.concatenate([moved, turned], axis=1)
