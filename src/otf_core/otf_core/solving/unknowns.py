# SPDX-License-Identifier: Apache-2.0
"""Unknowns of a calibration and their gauge.

Unknowns are a pose correction for every place of the tracker (3 translations, 3 rotations), a
correction of the place of every target that is not known, squareness and location errors, the
spline coefficients of the error motions of all axes and, where they are modelled, reversal
coefficients of these motions and lags of the axes. The gauge (docs/formulation.md): straightness
of linear axes is zero at both ends; all else is zero at the axis' zero position, else at its
minimum. What the line of a rotary axis does is left to the location errors, which are put into the
gauge of the tables afterwards (``tabulate``). Gauge conditions are met exactly, by leaving
coefficients out: ``full = gauge @ free``.

Functions of one axis position are B-splines, f(q) = sum_k c_k B_k(q), cubic and smooth or linear
between nodes. Knots at both ends are repeated, so the first and the last coefficient are the
values there; outside the knots f is constant. Degree 1 gives the hat functions of tables: c_k is
the value at knot k. Those of an endless axis repeat after a turn.

References
----------
de Boor, A Practical Guide to Splines, Springer 2001, chapter IX. Piegl and Tiller, The NURBS
Book, Springer 1997, algorithm A2.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from otf_core.arrays import Array, Index
from otf_core.model.machine import Machine
from otf_core.model.motions import (
    DIRECTIONS,
    ROTARY,
    ErrorMotion,
    is_motion,
    location_names,
)

CUBIC, LINEAR = 3, 1
INTERVALS = 20
"""Parts of an axis range: cubic splines then follow eight waves to 1 % of their size."""


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
            The first of them; the others follow, after the last one the first.
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
            dense[np.arange(len(q)), (first + step) % self.size] += weight[:, step]
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

    def places(self, q: Array) -> tuple[Index, Array]:
        """Functions that differ from zero at positions q (n,), rad; see ``Basis.places``."""
        inside = self.knots[0] + np.mod(q - self.knots[0], self.period)
        cell = np.clip(np.searchsorted(self.knots, inside, 'right') - 1, 0, self.size - 1)
        x = (inside - self.knots[cell]) / np.diff(self.knots)[cell]
        if self.degree == LINEAR:
            return cell, np.stack([1.0 - x, x], axis=1)
        four = [(1 - x) ** 3, 3 * x**3 - 6 * x**2 + 4, -3 * x**3 + 3 * x**2 + 3 * x + 1, x**3]
        return (cell - 1) % self.size, np.stack(four, axis=1) / 6.0

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


def over_turn(low: float, intervals: int) -> PeriodicBasis:
    """Periodic cubic splines over a turn from a position on, in equal intervals."""
    return PeriodicBasis(np.linspace(low, low + 2.0 * np.pi, intervals + 1), CUBIC)


Bases = dict[str, Basis]


def smooth_bases(machine: Machine, nodes: Mapping[str, Array], parts: int = INTERVALS) -> Bases:
    """Cubic splines over equal parts of the range of every axis, or of a turn."""
    bases: Bases = {}
    for axis, at in nodes.items():
        whole = machine.axes[axis].endless and at[-1] - at[0] > 2.0 * np.pi - 1e-2
        bases[axis] = over_turn(float(at[0]), parts) if whole else cubic(at, parts)
    return bases


def linear_bases(machine: Machine, nodes: Mapping[str, Array]) -> Bases:
    """Functions that are linear between the nodes of every axis, on a turn if smooth ones are."""
    smooth = smooth_bases(machine, nodes)
    return {axis: basis.linear_between(nodes[axis]) for axis, basis in smooth.items()}


POSE, PLACE = 6, 3
SQUARENESS_OF = {'C0Y': 'XY', 'B0Z': 'XZ', 'A0Z': 'YZ'}
"""Axes that a squareness error is between."""


@dataclass(frozen=True)
class Unknowns:
    """Layout of the unknowns.

    Attributes
    ----------
    bases : mapping of axis to Basis
        Functions that the motions of each axis are made of.
    blocks : mapping of block name to slice
        Place of every block in the full vector; a dependent one gives way to those before it:
        poses, places of targets, squareness and location errors, translations, rotations, then
        reversal polynomial by polynomial, and lags.
    gauge : sparse array, shape (full, free)
    free_blocks : mapping of block name to slice
        The same blocks in the free vector.
    held : bool
        Axes that stand stay on the side of their last travel, see ``effects.catalogue.backlash``.
    """

    bases: Bases
    blocks: dict[str, slice]
    gauge: sparse.csr_array
    free_blocks: dict[str, slice]
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


def is_step(block: str) -> bool:
    """Return whether a block is a correction of a pose or of a place."""
    return block.startswith(('pose ', 'place '))


def is_reversal(block: str) -> bool:
    """Return whether a block is a reversal coefficient; its first letters are the motion."""
    return block[3:4] == '_' and is_motion(block[:3])


def reversal_order(block: str) -> int:
    """Order of the polynomial of a reversal coefficient; -1 for all other blocks."""
    return int(block[4:]) if is_reversal(block) else -1


def reversal_names(motions: Sequence[ErrorMotion], count: int) -> list[str]:
    """Blocks of so many reversal coefficients of motions, order by order."""
    order = sorted(motions, key=lambda motion: not motion.is_translation)
    return [reversal_block(motion, k) for k in range(count) for motion in order]


def reversal_blocks(unknowns: Unknowns, motion: str) -> list[str]:
    """Blocks of the reversal coefficients of a motion, by their order."""
    return [n for n in unknowns.blocks if is_reversal(n) and n[:3] == motion]


def place_block(target: str) -> str:
    """Name of the block of the place of a target."""
    return f'place {target}'


def lag_block(axis: str) -> str:
    """Name of the block of the time, s, by which an axis is late."""
    return f'lag {axis}'


def layout(
    bases: Mapping[str, Basis],
    stations: int = 1,
    reversal: Sequence[str] = (),
    *,
    targets: Sequence[str] = (),
    lags: Sequence[str] = (),
    held: bool = False,
) -> Unknowns:
    """Lay out the unknowns.

    Parameters
    ----------
    bases : mapping of axis to Basis
        Of all axes of the machine.
    stations : int
        Places of the tracker, each with a pose of its own.
    reversal : sequence of str
        Blocks of reversal coefficients, see ``reversal_block``.
    targets : sequence of str
        Those whose places are not known.
    lags : sequence of str
        Axes that are late by a constant time.
    held : bool
        See ``Unknowns``.
    """
    motions = [ErrorMotion(d, axis) for axis in bases for d in DIRECTIONS]
    motions.sort(key=lambda motion: not motion.is_translation)
    scalars = [name for name, axes in SQUARENESS_OF.items() if set(axes) <= bases.keys()]
    scalars += [n for axis in bases if axis in ROTARY for n in location_names(axis)]
    parts: list[tuple[str, Array]] = [(pose_block(k), np.eye(POSE)) for k in range(stations)]
    parts += [(place_block(name), np.eye(PLACE)) for name in targets]
    parts += [(name, np.eye(1)) for name in scalars]
    parts += [(motion, motion_gauge(motion, bases[motion.axis])) for motion in motions]
    parts += [(name, np.eye(1)) for name in reversal]
    parts += [(lag_block(axis), np.eye(1)) for axis in lags]
    return Unknowns(dict(bases), *lay_out_blocks(parts), held)


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
