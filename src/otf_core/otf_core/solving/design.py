# SPDX-License-Identifier: Apache-2.0
"""Design matrix: derivatives of the rows of all pieces by the unknowns, never all at once.

A row is a . J(q) for the direction a of the row. The six motions of one axis share the splines of
its position, so products with a vector need the six errors of every piece only, and dense rows are
formed for a few legs at a time, by the few unknowns that these depend on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.effects.catalogue.machine import functions_along
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS
from otf_core.solving.unknowns import Basis, Unknowns, reversal_blocks

PIECES_PER_BLOCK = 8192
"""Pieces whose products are made together."""


@dataclass(frozen=True)
class Influence:
    """What the six motions of one axis do at the pieces, at every one of s shifts.

    Attributes
    ----------
    q : ndarray, shape (s, p), m or rad
        Position of the axis.
    six : ndarray, shape (s, c, p, 6)
        Rows per unit of the motions.
    half : ndarray, shape (p,)
        Half the sense of travel, for its reversal.
    nodal : ndarray, shape (s, c, p, 6, n), optional
        ``six`` for every spline that is reached, see ``system.build_system``.
    """

    q: Array
    six: Array
    half: Array
    nodal: Array | None = None

    def at(self, pieces: Index | slice) -> Influence:
        """Return those at some pieces."""
        nodal = None if self.nodal is None else self.nodal[:, :, pieces]
        return Influence(self.q[:, pieces], self.six[:, :, pieces], self.half[pieces], nodal)


@dataclass(frozen=True)
class _Support:
    """Splines of one axis that the pieces reach.

    Attributes
    ----------
    first : ndarray of int64, shape (p,)
        First spline that is reached at any shift.
    weight : ndarray, shape (s, p, n)
        Values of this and the following ones, over the number of shifts.
    starts : ndarray of int64, shape (6,)
        Places of the blocks of the six motions, full vector.
    """

    basis: Basis
    first: Index
    weight: Array
    starts: Index

    @classmethod
    def of(cls, influence: Influence, basis: Basis, starts: Index) -> _Support:
        size, own = basis.size, [basis.places(q) for q in influence.q]
        first = own[0][0]
        # on a turn the last spline is followed by the first
        off = [(f - first + size // 2) % size - size // 2 for f, _ in own]
        least = np.minimum.reduce(off)
        width = max(int(np.max(o - least, initial=0)) for o in off) + basis.nonzero
        low = first + least
        if not basis.periodic:
            low = np.minimum(low, size - width)
        row, weight = np.arange(len(first))[:, None], np.zeros((len(own), len(first), width))
        for k, (f, values) in enumerate(own):
            column = (f - low) % size if basis.periodic else f - low
            weight[k][row, column[:, None] + np.arange(basis.nonzero)] = values / len(own)
        return cls(basis, low % size, weight, starts)

    def at(self, pieces: Index | slice) -> _Support:
        """Return those of some pieces."""
        return replace(self, first=self.first[pieces], weight=self.weight[:, pieces])

    @property
    def reached(self) -> Index:
        """Numbers (p, n) of the splines."""
        return (self.first[:, None] + np.arange(self.weight.shape[2])) % self.basis.size

    def splines(self, shift: int) -> sparse.csr_array:
        """Values of all splines at one of the shifts, shape (p, size)."""
        weight = self.weight[shift]
        count, width = weight.shape
        small = np.int32 if count * width < np.iinfo(np.int32).max else np.int64
        ends = np.arange(0, count * width + 1, width, dtype=small)
        places = self.reached.ravel().astype(small)
        return sparse.csr_array((weight.ravel(), places, ends), shape=(count, self.basis.size))

    @property
    def places(self) -> Index:
        """Place of every spline of every block, full vector, shape (size, 6)."""
        return self.starts + np.arange(self.basis.size)[:, None]


@dataclass(frozen=True)
class Design:
    """Derivatives of the deviations, means over the samples of every piece.

    Attributes
    ----------
    fixed : mapping of block to ndarray, shape (c, p, k)
        Poses, places, squareness and location errors, lags.
    motions : mapping of axis to Influence
    """

    machine: Machine
    unknowns: Unknowns
    fixed: Mapping[str, Array]
    motions: Mapping[str, Influence]

    @property
    def shape(self) -> tuple[int, int]:
        """Components and pieces."""
        components, pieces = next(iter(self.fixed.values())).shape[:2]
        return components, pieces

    def at(self, pieces: Index) -> Design:
        """Return the derivatives of some pieces, by their places."""
        fixed = {name: own[:, pieces] for name, own in self.fixed.items()}
        motions = {axis: own.at(pieces) for axis, own in self.motions.items()}
        return replace(self, fixed=fixed, motions=motions)

    @cached_property
    def _supports(self) -> dict[str, _Support]:
        blocks, bases = self.unknowns.blocks, self.unknowns.bases
        starts = {a: np.array([blocks[f'E{d}{a}'].start for d in DIRECTIONS]) for a in bases}
        return {a: _Support.of(own, bases[a], starts[a]) for a, own in self.motions.items()}

    @cached_property
    def _reversal(self) -> dict[str, list[tuple[int, int, int]]]:
        """Place, motion and function of every reversal coefficient, by axis."""
        places: dict[str, list[tuple[int, int, int]]] = {}
        for axis in self.motions:
            for d, letter in enumerate(DIRECTIONS):
                names = reversal_blocks(self.unknowns, f'E{letter}{axis}')
                places.setdefault(axis, []).extend(
                    (self.unknowns.blocks[name].start, d, k) for k, name in enumerate(names)
                )
        return {axis: own for axis, own in places.items() if own}

    def released(self) -> Design:
        """Return the same without what products keep to be fast."""
        return replace(self)

    def prepare(self) -> None:
        """Make what all rows share; afterwards rows may be made by several threads."""
        self._supports, self._reversal, self._small  # noqa: B018

    @cached_property
    def _small(self) -> tuple[Index, Array]:
        """Places (k,) and rows (c, p, k) of all that is no function of a position."""
        places = [np.arange(*_ends(self.unknowns.blocks[name])) for name in self.fixed]
        columns = list(self.fixed.values())
        for axis, own in self._reversal.items():
            influence, order = self.motions[axis], max(k for _, _, k in own)
            sides = [
                influence.half * functions_along(self.machine.axes[axis], q, order).T
                for q in influence.q
            ]
            for place, d, k in own:
                pairs = zip(influence.six, sides, strict=True)
                column = sum(six[:, :, d] * side[k] for six, side in pairs) / len(sides)
                places.append(np.array([place]))
                columns.append(np.asarray(column)[:, :, None])
        return np.concatenate(places), np.concatenate(columns, axis=2)

    def dense(self, pieces: Index | slice) -> Array:
        """Rows of some pieces, shape (c, m, full)."""
        full = self.unknowns.full
        return self._filled(pieces, np.arange(full), full, None)

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
        mask = np.zeros(self.unknowns.full, dtype=bool)
        mask[self._small[0]] = True
        for axis, support in self._supports.items():
            reached = np.zeros(support.basis.size, dtype=bool)
            reached[support.at(pieces).reached] = True
            mask[support.places[reached][:, _among(axis, blocks)]] = True
        columns = np.flatnonzero(mask)
        size = len(columns) + width
        return columns, self._filled(pieces, np.cumsum(mask) - 1, size, blocks)

    def _filled(
        self, pieces: Index | slice, place_of: Index, size: int, blocks: Collection[str] | None
    ) -> Array:
        """Rows (c, m, size) of some pieces, every unknown in the column of its own."""
        small, columns = self._small
        rows = columns[:, pieces]
        dense = np.zeros((*rows.shape[:2], size))
        dense[:, :, place_of[small]] = rows
        flat, row = dense.reshape(len(rows), -1), (np.arange(rows.shape[1]) * size)[:, None, None]
        for axis, whole in self._supports.items():
            support, influence = whole.at(pieces), self.motions[axis].at(pieces)
            six = influence.six[..., None] if influence.nodal is None else influence.nodal
            motions = _among(axis, blocks)
            places = row + place_of[support.starts[motions, None] + support.reached[:, None, :]]
            for values, of_shifts in zip(flat, np.swapaxes(six, 0, 1), strict=True):
                values[places] = sum(
                    own[:, motions] * weight[:, None, :]
                    for own, weight in zip(of_shifts, support.weight, strict=True)
                )
        return dense

    @property
    def splines(self) -> Index:
        """First spline of every axis at every piece, shape (p, k)."""
        return np.stack([support.first for support in self._supports.values()], axis=1)

    @cached_property
    def csr(self) -> sparse.csr_array:
        """All rows as a sparse matrix, shape (c p, full): rows of one direction, then the next."""
        components, count = self.shape
        parts = [
            sparse.csr_array(self.dense(slice(low, min(low + 1024, count)))[c])
            for c in range(components)
            for low in range(0, count, 1024)
        ]
        return sparse.csr_array(sparse.vstack(parts))

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
        small, columns = self._small
        total = columns @ value[small]
        for axis, support in self._supports.items():
            coefficients = value[support.places]
            for shift, six in enumerate(self.motions[axis].six):
                errors = support.splines(shift) @ coefficients
                total += np.einsum('cpk,pk->cp', six, errors)
        return np.asarray(total)

    def transposed(self, rows: Array) -> Array:
        """Transposed design times rows (c, p) or (c, p, k), shape (full,) or (full, k)."""
        wide = rows.reshape(*rows.shape[:2], -1)
        product = np.zeros((self.unknowns.full, wide.shape[2]))
        for some in self._blocks():
            product += self.pulled(some, wide[:, some])
        return product.reshape(-1, *rows.shape[2:])

    def _blocks(self) -> Iterator[slice]:
        """Pieces, some at a time."""
        return (slice(k, k + PIECES_PER_BLOCK) for k in range(0, self.shape[1], PIECES_PER_BLOCK))

    def pulled(self, some: slice, rows: Array) -> Array:
        """Transposed design of some pieces times rows (c, m, k), shape (full, k)."""
        small, columns = self._small
        product = np.zeros((self.unknowns.full, rows.shape[2]))
        product[small] = np.einsum('cpj,cpk->jk', columns[:, some], rows, optimize=True)
        for axis, whole in self._supports.items():
            support, influence = whole.at(some), self.motions[axis].six[:, :, some]
            for shift, six in enumerate(influence):
                pull = sum(c[:, :, None] * r[:, None, :] for c, r in zip(six, rows, strict=True))
                own = support.splines(shift).T @ np.asarray(pull).reshape(len(pull), -1)
                product[support.places] += own.reshape(len(own), 6, -1)
        return product


def _ends(block: slice) -> tuple[int, int]:
    return int(block.start), int(block.stop)


def _among(axis: str, blocks: Collection[str] | None) -> Index:
    """Which of the six motions of an axis are among blocks, or all."""
    names = [f'E{d}{axis}' for d in DIRECTIONS]
    return np.array([k for k, n in enumerate(names) if blocks is None or n in blocks], np.int64)
