# SPDX-License-Identifier: Apache-2.0
"""Design matrix: derivatives of the rows of all pieces by the unknowns, never all at once.

A row is a . J(q) for the direction a of the row: motions of one axis share the splines of its
position, and a rotation acts as r . (L x a) for its lever arm L. So products with a vector need
the error vector of every piece only, and dense rows are formed for a few legs at a time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, cycle

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.model.kinematics import lever, squareness_influence
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.solving.reversal import reversal_weights
from otf_core.solving.unknowns import Unknowns, pose_block, reversal_block


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

    def columns(self, motions: Index) -> Index:
        """Places of the splines of some blocks at every place, full vector, shape (p, k, n)."""
        splines = self.first[:, None] + np.arange(self.weight.shape[1])
        return np.asarray(splines[:, None, :] + self.starts[motions][:, None])

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

    def columns(self, motions: Index) -> Index:
        """Places of the coefficients of some motions, full vector, shape (1, k, n)."""
        return self.places.T[None, motions]

    def at(self, place: Index | slice) -> ReversalPart:
        """Return the part at some of the places."""
        return replace(self, weight=self.weight[place], lever=self.lever[place])


def cross_product(one: Array, other: Array) -> Array:
    """Vector products of vectors (..., 3), several times faster than ``numpy.cross``."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = other[..., 0], other[..., 1], other[..., 2]
    first = b * z - c * y
    product = np.empty((*first.shape, 3))
    product[..., 0], product[..., 1], product[..., 2] = first, c * x - a * z, a * y - b * x
    return product


def cross_with_each(arms: Array, forces: Array) -> Array:
    """Vector products of arms (p, 3) with k forces each, shape (p, 3, k)."""
    x, y, z = (arms[:, i, None] for i in range(3))
    product = np.empty_like(forces)
    np.subtract(y * forces[:, 2], z * forces[:, 1], out=product[:, 0])
    np.subtract(z * forces[:, 0], x * forces[:, 2], out=product[:, 1])
    np.subtract(x * forces[:, 1], y * forces[:, 0], out=product[:, 2])
    return product


def group_by_support(parts: Sequence[AxisPart]) -> list[AxisPart]:
    """Parts of one axis at all shifts, each with all the splines that any of them reaches."""
    first = np.minimum.reduce([part.first for part in parts])
    width = max(int(np.max(p.first - first, initial=0)) + p.weight.shape[1] for p in parts)
    first, row, alike = (
        np.minimum(first, parts[0].size - width),
        np.arange(len(first))[:, None],
        [],
    )
    for part in parts:
        weight = np.zeros((len(first), width))
        weight[row, (part.first - first)[:, None] + np.arange(part.weight.shape[1])] = part.weight
        alike.append(replace(part, first=first, weight=weight))
    return alike


def six_motions(direction: Array, arm: Array) -> Array:
    """Rows (p, 6, 1 or n) of three translations and three rotations along directions (p, 3)."""
    if arm.ndim == 2:
        return np.concatenate([direction, cross_product(arm, direction)], axis=1)[:, :, None]
    turned = np.swapaxes(cross_product(arm, direction[:, None, :]), 1, 2)
    moved = np.broadcast_to(direction[:, :, None], turned.shape)
    return np.concatenate([moved, turned], axis=1)


Parts = Sequence[AxisPart | ReversalPart]
"""Motions of one axis, or their reversal, at every shift."""

PIECES_PER_BLOCK = 8192
"""Pieces whose products are made together."""
MAX_PIECES_IN_MEMORY = 150_000
"""Pieces whose splines are held; those of a longer run are made anew whenever they are used."""


@dataclass(frozen=True)
class Design:
    """Derivatives of the deviations, means over the samples of every piece.

    Attributes
    ----------
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
        See ``reversal.reversal_weights``.
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
    def _parts(self) -> list[Parts]:
        return self._made(slice(None))

    def _made(self, pieces: Index | slice) -> list[Parts]:
        places = self._positions(pieces)
        axes = ([self._part(k, q) for q in places] for k in range(3))
        # splines at all shifts are the same ones in most pieces, so that rows are filled once
        moved = [parts if len(parts) == 1 else group_by_support(parts) for parts in axes]
        return [*moved, *self._reversed(places, pieces)]

    def _positions(self, pieces: Index | slice) -> list[Array]:
        """Positions (m, 3) of some pieces at every shift, m."""
        q = self.q[pieces]
        return [q + (s if s.ndim == 1 else s[pieces]) for s in self.shifts]

    def _at(self, pieces: Index | slice) -> list[Parts]:
        """What motions and reversal of the axes do at every shift, at some pieces."""
        if len(self.q) > MAX_PIECES_IN_MEMORY:
            return self._made(pieces)
        if isinstance(pieces, slice) and len(range(*pieces.indices(len(self.q)))) == len(self.q):
            return self._parts
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
        starts = np.array([self.unknowns.blocks[m].start for m in _motions_of(name)])
        return AxisPart(first, weight, arm, starts, basis.size)

    @property
    def _pose(self) -> Index:
        block = self.unknowns.blocks[pose_block(self.run)]
        return np.arange(block.start, block.stop)

    @property
    def _angles(self) -> Index:
        return np.array([self.unknowns.blocks[name].start for name in SQUARENESS])

    def _reversed(self, places: Sequence[Array], pieces: Index | slice) -> list[Parts]:
        """Reversal of the three axes at places (m, 3) of some pieces at every shift."""
        if not self.unknowns.reversal:
            return []
        parts_reversed: list[Parts] = []
        travel, side = self.travel[pieces], self.side[pieces]
        weights = [reversal_weights(self.machine, q, travel, side, self.unknowns) for q in places]
        for k, name in enumerate(self.machine.axis_names):
            blocks = self._reversal_places(name)
            pairs = zip(weights, places, strict=True)
            parts_reversed.append(
                [ReversalPart(w[:, k], lever(self.machine, name, q), blocks) for w, q in pairs]
            )
        return parts_reversed

    def _reversal_places(self, axis: str) -> Index:
        """Places of the reversal coefficients of an axis, see ``ReversalPart``."""
        blocks, motions = self.unknowns.blocks, _motions_of(axis)
        orders = range(self.unknowns.reversal)
        return np.array([[blocks[reversal_block(m, k)].start for m in motions] for k in orders])

    def _blocks(self, size: int) -> Iterator[slice]:
        """Pieces, some at a time."""
        return (slice(low, low + size) for low in range(0, len(self.q), size))

    def parts_of_motions(self) -> list[AxisPart]:
        """What the motions of every axis do at the centres of the pieces."""
        return [self._part(k, self.q) for k in range(3)]

    def squareness_rows(self, pieces: Index | slice = slice(None)) -> Array:
        """Rows per unit of the squareness errors, linear in a piece, shape (c, m, 3), m/rad."""
        angles = [squareness_influence(name, self.q[pieces]) for name in SQUARENESS]
        turned = np.einsum('cpi,pik->cpk', self.axes[:, pieces], np.stack(angles, axis=2))
        return np.asarray(turned)

    def _few(self, pieces: Index | slice) -> tuple[Index, Array]:
        """Places (k,) and rows (c, m, k) of pose and squareness."""
        axes = self.axes[:, pieces]
        # a . (dr x p) = dr . (p x a)
        rows = [-axes, -cross_product(self.points[pieces], axes), self.squareness_rows(pieces)]
        return np.concatenate([self._pose, self._angles]), np.concatenate(rows, axis=2)

    def released(self) -> Design:
        """Return the same without what products keep to be fast."""
        return replace(self)

    def prepare(self) -> None:
        """Make what all rows share; afterwards rows may be made by several threads."""
        if len(self.q) <= MAX_PIECES_IN_MEMORY:
            self._parts  # noqa: B018

    def dense(self, pieces: Index | slice) -> Array:
        """Rows of some pieces, shape (c, m, full)."""
        full = self.unknowns.full
        return self._filled(
            pieces, self._few(pieces), self._counting(pieces), np.arange(full), full
        )

    def touched(
        self, pieces: Index, width: int = 0, blocks: Collection[str] | None = None
    ) -> tuple[Index, Array]:
        """Rows of some pieces by the unknowns that they depend on.

        Parameters
        ----------
        pieces : ndarray of int64
            m of the pieces.
        width : int
            Further columns of zeros behind the unknowns.
        blocks : collection of str, optional
            Motions that are not among them are left out.

        Returns
        -------
        columns : ndarray of int64, shape (k,)
            Places of these unknowns in the full vector, ascending.
        rows : ndarray, shape (c, m, k + width)
        """
        few, counting = self._few(pieces), self._counting(pieces, blocks)
        mask = np.zeros(self.unknowns.full, dtype=bool)
        mask[few[0]] = True
        for parts, motions in counting:
            mask[parts[0].reached[:, motions]] = True
        columns = np.flatnonzero(mask)
        size = len(columns) + width
        return columns, self._filled(pieces, few, counting, np.cumsum(mask) - 1, size)

    def _counting(
        self, pieces: Index | slice, blocks: Collection[str] | None = None
    ) -> list[tuple[Parts, Index]]:
        """What moves some pieces, and which of its six motions are among the ``blocks``."""
        known, counting = None if blocks is None else {name[:3] for name in blocks}, []
        for parts, axis in zip(self._at(pieces), cycle(self.machine.axis_names), strict=False):
            motions = enumerate(_motions_of(axis))
            numbers = [k for k, motion in motions if known is None or motion in known]
            counting.append((parts, np.array(numbers, dtype=np.int64)))
        return counting

    def _filled(
        self,
        pieces: Index | slice,
        few: tuple[Index, Array],
        counting: Sequence[tuple[Parts, Index]],
        place_of: Index,
        size: int,
    ) -> Array:
        """Rows (c, m, size) of some pieces, every unknown in the column of its own."""
        axes = self.axes[:, pieces]
        dense = np.zeros((*axes.shape[:2], size))
        dense[:, :, place_of[few[0]]] = few[1]
        flat, shares = dense.reshape(len(axes), -1), axes / len(self.shifts)
        row = (np.arange(axes.shape[1]) * size)[:, None, None]
        for parts, motions in counting:
            place = row + place_of[parts[0].columns(motions)]
            for values, share in zip(flat, shares, strict=True):
                values[place] = sum(
                    six_motions(share, part.lever)[:, motions] * part.weight[:, None, :]
                    for part in parts
                )
        return dense

    @property
    def splines(self) -> Index:
        """First spline of every axis at every piece, shape (p, 3)."""
        some = (chain.from_iterable(self._at(own)[:3]) for own in self._blocks(PIECES_PER_BLOCK))
        firsts = [[p.first for p in parts if isinstance(p, AxisPart)] for parts in some]
        shifts = len(self.shifts)
        return np.concatenate([np.stack(first[::shifts], axis=1) for first in firsts])

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
        moved, angles = value[self._pose], value[self._angles]
        total = -moved[:3] - cross_product(moved[3:], self.points)
        for angle, name in zip(angles, SQUARENESS, strict=True):
            total += angle * squareness_influence(name, self.q)
        for some in self._blocks(
            MAX_PIECES_IN_MEMORY if len(self.q) <= MAX_PIECES_IN_MEMORY else PIECES_PER_BLOCK
        ):
            for part in chain.from_iterable(self._at(some)):
                six = part.splines @ (value[part.places] / len(self.shifts))
                total[some] += six[:, :3]
                total[some] += cross_product(six[:, 3:], part.lever)
        return np.asarray(np.einsum('cpi,pi->cp', self.axes, total))

    def transposed(self, rows: Array) -> Array:
        """Transposed design times rows (c, p) or (c, p, k), shape (full,) or (full, k)."""
        wide = rows.reshape(*rows.shape[:2], -1)
        product = np.zeros((self.unknowns.full, wide.shape[2]))
        for some in self._blocks(PIECES_PER_BLOCK):
            self._add_transposed(some, wide[:, some], product)
        return product.reshape(-1, *rows.shape[2:])

    def pulled(self, some: slice, rows: Array) -> Array:
        """Transposed design of some pieces times rows (c, m, k), shape (full, k)."""
        product = np.zeros((self.unknowns.full, rows.shape[2]))
        self._add_transposed(some, rows, product)
        return product

    def _add_transposed(self, some: slice, rows: Array, total: Array) -> None:
        """Add the transposed rows of some pieces times rows (c, m, k) to found (full, k)."""
        wide = rows.shape[2]
        q, pull = self.q[some], np.einsum('cpi,cpk->pik', self.axes[:, some], rows)
        turned = cross_with_each(self.points[some], pull)
        total[self._pose] -= np.concatenate([pull.sum(axis=0), turned.sum(axis=0)])
        for place, name in zip(self._angles.tolist(), SQUARENESS, strict=True):
            total[place] += squareness_influence(name, q).reshape(-1) @ pull.reshape(-1, wide)
        six = np.empty((len(q), 6, wide))
        six[:, :3] = pull
        for part in chain.from_iterable(self._at(some)):
            six[:, 3:] = cross_with_each(part.lever, pull)
            own = part.splines.T @ six.reshape(len(six), -1)
            total[part.places] += own.reshape(len(own), 6, wide) / len(self.shifts)


def _motions_of(axis: str) -> list[str]:
    """Three translations and three rotations of an axis."""
    return [m for m in MOTIONS if m.axis == axis]
