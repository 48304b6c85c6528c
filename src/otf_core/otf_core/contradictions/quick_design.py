# SPDX-License-Identifier: Apache-2.0
"""Columns of the quick model, and its normal matrix from what is known of their form.

A row of the tables holds, for every axis, the influences of its six motions times the two hat
functions that are not zero there. So the products of two axes are 6 x 6 numbers of a piece, the
same for all pairs of nodes but for a factor, and need no multiplication of sparse matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.contradictions.quick_rows import Rows, levers, turning
from otf_core.model.machine import Chain

MAX_NODES = 80
"""Nodes per axis at most."""


@dataclass(frozen=True)
class AxisTables:
    """Tables of the six motions of one axis.

    Attributes
    ----------
    nodes : int
    first : ndarray of int64, shape (p,)
        First node at every piece whose hat function is not zero.
    hat : ndarray, shape (w, p)
        Values of that and of the next one; of the only one where the axis stands.
    influence : ndarray, shape (c, 6, p), 1 and m/rad
        Rows per unit of the motions.
    """

    nodes: int
    first: Index
    hat: Array
    influence: Array

    @classmethod
    def of(cls, rows: Rows, chain: Chain, offset: Array, axis: int) -> AxisTables:
        """Tables at half the pitch, for a chain and target offsets (p, 3), m."""
        q = rows.q[:, axis]
        pitch = 0.5 * rows.machine.axes[rows.machine.axis_names[axis]].table_pitch
        low, size = float(q.min()), float(np.ptp(q))
        count = int(np.clip(np.ceil(size / pitch), 1, MAX_NODES))
        turned = turning(rows, levers(rows, chain, offset, axis))
        influence = np.concatenate([rows.axes, turned], axis=2)
        columns = np.ascontiguousarray(np.swapaxes(influence, 1, 2))
        if size <= 1e-6:
            return cls(1, np.zeros(len(q), dtype=np.int64), np.ones((1, len(q))), columns)
        place = (q - low) * (count / size)
        first = np.minimum(place.astype(np.int64), count - 1)
        return cls(count + 1, first, np.stack([first + 1 - place, place - first]), columns)

    @property
    def columns(self) -> Index:
        """Columns that are not zero at every piece, shape (6, w, p)."""
        motion, hat = np.arange(6)[:, None, None], np.arange(len(self.hat))[:, None]
        return np.asarray(motion * self.nodes + self.first + hat)

    def products(self, other: AxisTables, weight: Array) -> Array:
        """Weighted products of its columns with those of another axis, shape (6 n, 6 n').

        Parameters
        ----------
        other : AxisTables
        weight : ndarray, shape (c, p)
        """
        left, right = self.influence * weight[:, None], other.influence
        pairs = sum(a[:, None] * b for a, b in zip(left, right, strict=True))
        hats = (self.hat[:, None] * other.hat).reshape(-1, len(self.first))
        steps = np.arange(len(self.hat))[:, None] * other.nodes + np.arange(len(other.hat))
        places = steps.reshape(-1, 1) + self.first * other.nodes + other.first
        of_nodes = _of_rows(places, hats, self.nodes * other.nodes)
        sums = (of_nodes.T @ np.ascontiguousarray(pairs.reshape(36, -1).T)).reshape(
            self.nodes, other.nodes, 6, 6
        )
        return np.asarray(sums.transpose(2, 0, 3, 1).reshape(6 * self.nodes, 6 * other.nodes))


def _of_rows(columns: Index, values: Array, count: int) -> sparse.csr_array:
    """Sparse matrix (n, count) of as many values (k, n) in every row, columns ascending."""
    size, rows = columns.shape
    entries = (values.T.ravel(), columns.T.ravel(), np.arange(0, size * rows + 1, size))
    return sparse.csr_array(entries, shape=(rows, count))


@dataclass(frozen=True)
class Design:
    """Columns of a model: some for all rows, then those of the tables.

    Attributes
    ----------
    usual : ndarray, shape (r, k)
    axes : tuple of AxisTables
    """

    usual: Array
    axes: tuple[AxisTables, ...]

    @classmethod
    def of(cls, rows: Rows, usual: Array, chain: Chain | None = None, offset: Array | None = None
           ) -> Design:  # fmt: skip
        """Set up tables for another chain or other target offsets (p, 3), m, than stated."""
        chain = chain or rows.machine.chain
        offset = rows.offset if offset is None else offset
        return cls(usual, tuple(AxisTables.of(rows, chain, offset, a) for a in range(3)))

    @cached_property
    def tables(self) -> sparse.csr_array:
        """Columns of the tables, shape (r, n)."""
        across, _, pieces = self.axes[0].influence.shape
        size = sum(6 * len(a.hat) for a in self.axes)
        values, places = np.empty((across, pieces, size)), np.empty((pieces, size), dtype=np.int32)
        start = at = 0
        for axis in self.axes:
            own = slice(at, at := at + 6 * len(axis.hat))
            hats = (axis.influence[:, :, None] * axis.hat).reshape(across, -1, pieces)
            values[:, :, own] = np.swapaxes(hats, 1, 2)
            places[:, own] = (start + axis.columns).reshape(-1, pieces).T
            start += 6 * axis.nodes
        rows = np.arange(0, values.size + 1, size)
        entries = values.ravel(), np.tile(places, (across, 1)).ravel(), rows
        return sparse.csr_array(entries, shape=(across * pieces, start))

    def times(self, value: Array) -> Array:
        """Rows of what the columns give, shape (r,), for values (k + n,)."""
        width = self.usual.shape[1]
        return np.asarray(self.usual @ value[:width] + self.tables @ value[width:])

    def products(self, columns: Array) -> Array:
        """Products with further columns (r, j), shape (k + n, j)."""
        return np.concatenate([self.usual.T @ columns, self.tables.T @ columns])

    def sums(self, of_rows: sparse.csr_array) -> Array:
        """Sums of rows, weighted as sparse rows (j, r) say, shape (j, k + n)."""
        return np.hstack([of_rows @ self.usual, (of_rows @ self.tables).toarray()])

    def normal(self, weight: Array) -> Array:
        """Weighted products of all columns, shape (k + n, k + n); the lower triangle of them."""
        width = self.usual.shape[1]
        starts = width + np.cumsum([0, *(6 * a.nodes for a in self.axes)])
        found = np.zeros((starts[-1], starts[-1]))
        found[:, :width] = self.products(self.usual * weight[:, None])
        of_pieces = weight.reshape(self.axes[0].influence.shape[0], -1)
        for i, a in enumerate(self.axes):
            for j, b in enumerate(self.axes[: i + 1]):
                own, other = (slice(starts[k], starts[k + 1]) for k in (i, j))
                found[own, other] = a.products(b, of_pieces)
        return found
