# SPDX-License-Identifier: Apache-2.0
"""Unknowns of a calibration and their gauge.

Unknowns are a pose correction per run (3 translations, 3 rotations), 3 squareness errors, the
spline coefficients of 18 error motions and, where it is modelled, reversal coefficients of these
motions. The gauge (docs/formulation.md): positioning and rotations are zero at the axis' zero
position, else at its minimum; straightness is zero at both ends. Gauge conditions are met exactly,
by leaving coefficients out: ``full = gauge @ free``.

Functions of one axis position are B-splines, f(q) = sum_k c_k B_k(q), cubic and smooth or linear
between nodes. Knots at both ends are repeated, so the first and the last coefficient are the
values there; outside the knots f is constant. Degree 1 gives the hat functions of tables: c_k is
the value at knot k.

References
----------
de Boor, A Practical Guide to Splines, Springer 2001, chapter IX. Piegl and Tiller, The NURBS
Book, Springer 1997, algorithm A2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion, is_motion, unit_of

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
    def periodic(self) -> bool:
        """Return whether the functions repeat."""
        return False

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

    def linear_between(self, nodes: Array) -> Basis:
        """Functions of the same range that are linear between nodes (n,)."""
        return Basis(nodes, LINEAR)

    def at_nodes(self, nodes: Array, values: Array) -> Array:
        """Values at the nodes (n,) of linear functions from their coefficients (size, ...)."""
        return values

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


POSE = 6


@dataclass(frozen=True)
class Unknowns:
    """Layout of the unknowns.

    Attributes
    ----------
    bases : mapping of axis to Basis
        Functions that the motions of each axis are made of.
    blocks : mapping of block name to slice
        Place of the poses, the squareness names, the motions and the reversal coefficients in
        the full vector; a dependent one gives way to those before it: pose, squareness,
        translations, rotations, then reversal polynomial by polynomial.
    gauge : sparse array, shape (full, free)
    free_blocks : mapping of block name to slice
        The same blocks in the free vector.
    reversal : int
        Reversal polynomials per motion.
    held : bool
        Axes that stand stay on the side of their last travel, see ``effects.catalogue.backlash``.
    """

    bases: dict[str, Basis]
    blocks: dict[str, slice]
    gauge: sparse.csr_array
    free_blocks: dict[str, slice]
    reversal: int = 0
    held: bool = False

    @property
    def knots(self) -> dict[str, Array]:
        """Knots of each axis, m."""
        return {axis: basis.knots for axis, basis in self.bases.items()}

    @property
    def full(self) -> int:
        """Number of values in the full vector."""
        return int(self.gauge.shape[0])

    @cached_property
    def kept(self) -> Index:
        """Places of the free unknowns in the full vector, shape (free,)."""
        dense = self.gauge.toarray()
        alone = (np.count_nonzero(dense, axis=1) == 1) & (dense.max(axis=1, initial=0.0) == 1.0)
        return np.flatnonzero(alone)

    @cached_property
    def _tied(self) -> tuple[Index, Array]:
        """Places (t,) of those that follow the free ones, and how, (t, free); others are zero."""
        rest = np.setdiff1d(np.arange(self.full), self.kept)
        rows = self.gauge[rest].toarray()
        acts = rows.any(axis=1)
        return rest[acts], rows[acts]

    def lowered(self, matrix: Array) -> Array:
        """Matrix (full, full), symmetric, for the free unknowns: G^T M G for the gauge G."""
        tied, rows = self._tied
        lowered_matrix = matrix[np.ix_(self.kept, self.kept)]
        if len(tied):
            half = (
                matrix[np.ix_(self.kept, tied)] + 0.5 * rows.T @ matrix[np.ix_(tied, tied)]
            ) @ rows
            lowered_matrix += half + half.T
        return lowered_matrix

    def lifted(self, matrix: Array) -> Array:
        """Matrix (free, free), symmetric, for all unknowns: G M G^T for the gauge G."""
        tied, rows = self._tied
        lifted_matrix = np.zeros((self.full, self.full))
        lifted_matrix[np.ix_(self.kept, self.kept)] = matrix
        if len(tied):
            cross = rows @ matrix
            lifted_matrix[np.ix_(tied, self.kept)] = cross
            lifted_matrix[np.ix_(self.kept, tied)] = cross.T
            lifted_matrix[np.ix_(tied, tied)] = cross @ rows.T
        return lifted_matrix

    @property
    def free(self) -> int:
        """Number of values left by the gauge."""
        return int(self.gauge.shape[1])


def reference_position(low: float, high: float) -> float:
    """Where positioning and rotations are zero: at zero, else at the minimum, m."""
    return 0.0 if low <= 0.0 <= high else low


def motion_gauge(motion: ErrorMotion, basis: Basis) -> Array:
    """Columns that span the coefficients allowed by the gauge, shape (size, free)."""
    columns = np.eye(basis.size)
    if basis.size == 1:
        return np.zeros((1, 0))
    if motion.is_straightness:
        return columns[:, 1:-1]
    reference = reference_position(basis.knots[0], basis.knots[-1])
    at = basis.matrix(np.array([reference]))[0]
    dropped = int(np.argmax(at))
    columns[dropped] = -at / at[dropped]
    return np.delete(columns, dropped, axis=1)


def pose_block(run: int) -> str:
    """Name of the block of the pose correction of one run."""
    return f'pose {run}'


def reversal_block(motion: str, order: int) -> str:
    """Name of the block of one reversal coefficient of a motion: as in the effects, EYX_1."""
    return f'{motion}_{order}'


def is_reversal(block: str) -> bool:
    """Return whether a block is a reversal coefficient; its first letters are the motion."""
    return block[3:4] == '_' and is_motion(block[:3])


def reversal_order(block: str) -> int:
    """Order of the polynomial of a reversal coefficient; -1 for all other blocks."""
    return int(block[4:]) if is_reversal(block) else -1


def reversal_blocks(unknowns: Unknowns, motion: str) -> list[str]:
    """Blocks of the reversal coefficients of a motion, by their order."""
    return [n for n in unknowns.blocks if is_reversal(n) and n[:3] == motion]


def layout(
    bases: dict[str, Basis], runs: int = 1, reversal: int = 0, *, held: bool = False
) -> Unknowns:
    """Lay out the unknowns.

    Parameters
    ----------
    bases : mapping of axis to Basis
    runs : int
        Each has its own pose.
    reversal : int
        Reversal polynomials per motion.
    held : bool
        See ``Unknowns``.
    """
    order = [m for m in MOTIONS if unit_of(m) == 'm'] + [m for m in MOTIONS if unit_of(m) == 'rad']
    parts: list[tuple[str, Array]] = [(pose_block(run), np.eye(POSE)) for run in range(runs)]
    parts += [(name, np.eye(1)) for name in SQUARENESS]
    parts += [(name, motion_gauge(name, bases[name.axis])) for name in order]
    parts += [(reversal_block(m, k), np.eye(1)) for k in range(reversal) for m in order]
    return Unknowns(bases, *lay_out_blocks(parts), reversal, held)


def free_values(unknowns: Unknowns, full: Array) -> Array:
    """Free unknowns of full ones (full, ...) that obey the gauge: those that it keeps."""
    return np.asarray(full[unknowns.kept])


def lay_out_blocks(
    parts: Sequence[tuple[str, Array]],
) -> tuple[dict[str, slice], sparse.csr_array, dict[str, slice]]:
    """Lay out blocks of unknowns one after another.

    Parameters
    ----------
    parts : sequence of (str, ndarray)
        Name of each block and the basis (full, free) of what the gauge leaves of it.

    Returns
    -------
    blocks, gauge, free_blocks
        As in ``Unknowns``.
    """
    blocks, free_blocks = {}, {}
    full = free = 0
    for name, basis in parts:
        blocks[name] = slice(full, full + basis.shape[0])
        free_blocks[name] = slice(free, free + basis.shape[1])
        full, free = full + basis.shape[0], free + basis.shape[1]
    gauge = sparse.block_diag([basis for _, basis in parts], format='csr')
    return blocks, sparse.csr_array(gauge), free_blocks
