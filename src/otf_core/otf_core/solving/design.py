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

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.model.kinematics import lever, squareness_influence
from otf_core.model.machine import AXES, Machine
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.solving.reversal import reversal_columns
from otf_core.solving.unknowns import Unknowns, pose_block

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

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and unknowns."""
        return self.axes.shape[0] * self.axes.shape[1], self.unknowns.full

    @cached_property
    def _parts(self) -> list[list[AxisPart]]:
        """The three axes at every shift."""
        return [[self._part(k, self.q + shift) for k in range(3)] for shift in self.shifts]

    def _part(self, axis: int, q: Array) -> AxisPart:
        name = AXES[axis]
        basis = self.unknowns.bases[name]
        first, weight = basis.places(q[:, axis])
        arm = lever(self.machine, name, q)
        if self.nodal_lever:
            nodal = np.repeat(q[:, None, :], basis.nonzero, axis=1)
            nodal[:, :, axis] = basis.centres[first[:, None] + np.arange(basis.nonzero)]
            arm = lever(self.machine, name, nodal.reshape(-1, 3)).reshape(nodal.shape)
        starts = np.array([self.unknowns.blocks[m].start for m in MOTIONS if m.axis == name])
        return AxisPart(first, weight, arm, starts, basis.size)

    def _few(self) -> Iterator[tuple[slice, Array]]:
        """Blocks of few columns: squareness and reversal, with displacements (p, 3, k)."""
        blocks = self.unknowns.blocks
        for name in SQUARENESS:
            parts = [squareness_influence(name, self.q + s) for s in self.shifts]
            yield blocks[name], np.mean(parts, axis=0)[:, :, None]
        if self.unknowns.reversal:
            found = [dict(self._reversal(self.q + shift)) for shift in self.shifts]
            for name in found[0]:
                yield blocks[name], np.mean([f[name] for f in found], axis=0)[:, :, None]

    def _reversal(self, q: Array) -> Iterator[tuple[str, Array]]:
        return reversal_columns(self.machine, q, self.travel, self.side, self.unknowns)

    @cached_property
    def _columns(self) -> tuple[Index, Array]:
        """Places (k,) and rows (c, p, k) of pose, squareness and reversal."""
        pose = self.unknowns.blocks[pose_block(self.run)]
        places = [np.arange(pose.start, pose.stop)]
        # a . (dr x p) = dr . (p x a)
        rows = [-self.axes, -np.cross(self.points, self.axes)]
        for block, influence in self._few():
            places.append(np.arange(block.start, block.stop))
            rows.append(np.einsum('cpi,pik->cpk', self.axes, influence))
        return np.concatenate(places), np.concatenate(rows, axis=2)

    def prepare(self) -> None:
        """Make what all rows share; afterwards ``dense`` may be called from several threads."""
        self._parts  # noqa: B018
        self._columns  # noqa: B018

    def dense(self, pieces: Index | slice, width: int = 0) -> Array:
        """Rows of some pieces.

        Parameters
        ----------
        pieces : ndarray of int64 or slice
            m of the pieces.
        width : int
            Further columns of zeros behind the unknowns.

        Returns
        -------
        ndarray, shape (c, m, full + width)
        """
        axes = self.axes[:, pieces]
        size = self.unknowns.full + width
        dense = np.zeros((*axes.shape[:2], size))
        places, rows = self._columns
        dense[:, :, places] = rows[:, pieces]
        flat = dense.reshape(len(axes), -1)
        row = (np.arange(axes.shape[1]) * size)[:, None, None]
        for parts in zip(*self._parts, strict=True):
            here = [part.at(pieces) for part in parts]
            first, weights = _common(here)
            place = row + (first[:, None] + np.arange(weights[0].shape[1]))[:, None, :]
            place = place + here[0].starts[:, None]
            for values, direction in zip(flat, axes, strict=True):
                found = _six(direction, here[0].lever) * weights[0][:, None, :]
                for part, weight in zip(here[1:], weights[1:], strict=True):
                    found += _six(direction, part.lever) * weight[:, None, :]
                values[place] = found
        return dense

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
        total = np.zeros_like(self.q)
        for parts in self._parts:
            for part in parts:
                step = np.arange(part.weight.shape[1])
                own = value[part.starts + (part.first[:, None] + step)[:, :, None]]
                six = np.einsum('pn,pnk->pk', part.weight, own)
                total += six[:, :3] + np.cross(six[:, 3:], part.lever)
        found = np.einsum('cpi,pi->cp', self.axes, total / len(self.shifts))
        places, rows = self._columns
        return np.asarray(found + rows @ value[places])

    def transposed(self, rows: Array) -> Array:
        """Transposed design times rows (c, p) or (c, p, k), shape (full,) or (full, k)."""
        if rows.ndim > 2:
            return np.stack([self.transposed(r) for r in np.moveaxis(rows, 2, 0)], axis=1)
        found = np.zeros(self.unknowns.full)
        pull = np.einsum('cpi,cp->pi', self.axes, rows) / len(self.shifts)
        for parts in self._parts:
            for part in parts:
                six = np.concatenate([pull, np.cross(part.lever, pull)], axis=1)
                step = np.arange(part.weight.shape[1])
                place = part.starts + (part.first[:, None] + step)[:, :, None]
                values = part.weight[:, :, None] * six[:, None, :]
                found += np.bincount(place.ravel(), values.ravel(), len(found))
        places, own = self._columns
        found[places] += np.einsum('cpk,cp->k', own, rows)
        return found


def _common(parts: Sequence[AxisPart]) -> tuple[Index, list[Array]]:
    """First spline (m,) that any of some parts reaches, and their shares from there on."""
    if len(parts) == 1:
        return parts[0].first, [parts[0].weight]
    first = np.minimum.reduce([part.first for part in parts])
    width = max(int(np.max(p.first - first, initial=0)) + p.weight.shape[1] for p in parts)
    first = np.minimum(first, parts[0].size - width)
    row, found = np.arange(len(first))[:, None], []
    for part in parts:
        weight = np.zeros((len(first), width))
        place = (part.first - first)[:, None] + np.arange(part.weight.shape[1])
        weight[row, place] = part.weight / len(parts)
        found.append(weight)
    return first, found


def _six(direction: Array, arm: Array) -> Array:
    """Rows (p, 6, 1 or n) of three translations and three rotations along directions (p, 3)."""
    if arm.ndim == 2:
        return np.concatenate([direction, np.cross(arm, direction)], axis=1)[:, :, None]
    turned = np.swapaxes(np.cross(arm, direction[:, None, :]), 1, 2)
    moved = np.broadcast_to(direction[:, :, None], turned.shape)
    return np.concatenate([moved, turned], axis=1)
