# SPDX-License-Identifier: Apache-2.0
"""The unknowns of a calibration and their gauge.

Unknowns are a pose correction per run (3 translations, 3 rotations), 3 squareness errors, the
node values of 18 error motions and, if asked for, reversal coefficients of these motions. The
gauge (docs/formulation.md): positioning and rotations are zero at the axis' zero position, else
at its minimum; straightness is zero at both ends. Gauge conditions are met exactly, by leaving
nodes out: ``full = gauge @ free``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from otf_core.machine import AXES, Axis, Machine
from otf_core.tables import MOTIONS, SQUARENESS, is_straightness, unit_of

Array = NDArray[np.float64]

POSE = 6
SAME_PLACE = 1e-6
"""m; positions that differ by less are one."""


@dataclass(frozen=True)
class Unknowns:
    """Layout of the unknowns.

    Attributes
    ----------
    nodes : mapping of axis to ndarray, m
        Table nodes of each axis.
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
        Axes that stand stay on the side of their last travel, see ``effects.backlash``.
    """

    nodes: dict[str, Array]
    blocks: dict[str, slice]
    gauge: sparse.csr_array
    free_blocks: dict[str, slice]
    reversal: int = 0
    held: bool = False

    @property
    def full(self) -> int:
        """Number of values in the full vector."""
        return int(self.gauge.shape[0])

    @property
    def free(self) -> int:
        """Number of values left by the gauge."""
        return int(self.gauge.shape[1])


def axis_nodes(axis: Axis) -> Array:
    """Nodes of the whole axis: from the minimum in steps of ``table_pitch``, and the maximum.

    Returns
    -------
    ndarray, shape (k,), m
        The last interval is shorter where the range is no multiple of the pitch.
    """
    steps = int(np.ceil((axis.max - axis.min) / axis.table_pitch - 1e-9))
    regular = axis.min + np.arange(steps) * axis.table_pitch
    return np.asarray(np.append(regular, axis.max))


def table_nodes(machine: Machine, low: Array, high: Array) -> dict[str, Array]:
    """Nodes over the part of each axis range that the data cover.

    Parameters
    ----------
    machine : Machine
    low, high : ndarray, shape (3,), m
        Covered part of the axis ranges.

    Returns
    -------
    mapping of axis to ndarray, m
        The ends of the covered part and the regular nodes between; a regular node closer than a
        quarter of the spacing to an end that is not the axis' own gives way to it.
    """
    nodes = {}
    for k, axis in enumerate(AXES):
        spec = machine.axes[axis]
        grid = axis_nodes(spec)
        own = np.abs(np.array([low[k] - spec.min, high[k] - spec.max])) < SAME_PLACE
        margin = np.where(own, SAME_PLACE, 0.25 * spec.table_pitch)
        inner = grid[(grid > low[k] + margin[0]) & (grid < high[k] - margin[1])]
        if high[k] - low[k] < SAME_PLACE:
            nodes[axis] = np.array([low[k]])
        else:
            nodes[axis] = np.concatenate([[low[k]], inner, [high[k]]])
    return nodes


def reference_weights(nodes: Array) -> tuple[int, float]:
    """Interval and fraction of the reference position: zero, else the minimum of the nodes."""
    if not nodes[0] <= 0.0 <= nodes[-1]:
        return 0, 0.0
    index, fraction = interval(nodes, np.zeros(1))
    return int(index[0]), float(fraction[0])


def interval(nodes: Array, q: Array) -> tuple[NDArray[np.int64], Array]:
    """Interval of each position and the fraction within it, clamped to the nodes.

    Parameters
    ----------
    nodes : ndarray, shape (k,), m
    q : ndarray, shape (n,), m

    Returns
    -------
    index : ndarray of int64, shape (n,)
    fraction : ndarray, shape (n,)
        Between 0 and 1; the table is (1 - f) * value[index] + f * value[index + 1].
    """
    if len(nodes) == 1:
        return np.zeros(len(q), dtype=np.int64), np.zeros(len(q))
    index = np.clip(np.searchsorted(nodes, q, side='right') - 1, 0, len(nodes) - 2)
    fraction = (q - nodes[index]) / (nodes[index + 1] - nodes[index])
    return index, np.clip(fraction, 0.0, 1.0)


def _motion_gauge(motion: str, nodes: Array) -> Array:
    """Columns that span the node values allowed by the gauge, shape (nodes, free)."""
    count = len(nodes)
    basis = np.eye(count)
    if count == 1:
        return np.zeros((1, 0))
    if is_straightness(motion):
        return basis[:, 1:-1]
    index, fraction = reference_weights(nodes)
    if fraction <= 0.5:
        dropped, other, ratio = index, index + 1, -fraction / (1.0 - fraction)
    else:
        dropped, other, ratio = index + 1, index, -(1.0 - fraction) / fraction
    basis[dropped, other] = ratio
    return np.delete(basis, dropped, axis=1)


def pose_block(run: int) -> str:
    """Name of the block of the pose correction of one run."""
    return f'pose {run}'


def reversal_block(motion: str, order: int) -> str:
    """Name of the block of one reversal coefficient of a motion: as in the effects, EYX_1."""
    return f'{motion}_{order}'


def is_reversal(block: str) -> bool:
    """Tell whether a block is a reversal coefficient; its first letters are the motion."""
    return block[3:4] == '_' and block[:3] in MOTIONS


def reversal_order(block: str) -> int:
    """Order of the polynomial of a reversal coefficient; -1 for all other blocks."""
    return int(block[4:]) if is_reversal(block) else -1


def layout(
    nodes: dict[str, Array], runs: int = 1, reversal: int = 0, *, held: bool = False
) -> Unknowns:
    """Lay out the unknowns.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m
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
    parts += [(name, _motion_gauge(name, nodes[name[2]])) for name in order]
    parts += [(reversal_block(m, k), np.eye(1)) for k in range(reversal) for m in order]
    blocks, free_blocks = {}, {}
    full = free = 0
    for name, basis in parts:
        blocks[name] = slice(full, full + basis.shape[0])
        free_blocks[name] = slice(free, free + basis.shape[1])
        full, free = full + basis.shape[0], free + basis.shape[1]
    gauge = sparse.block_diag([basis for _, basis in parts], format='csr')
    return Unknowns(nodes, blocks, sparse.csr_array(gauge), free_blocks, reversal, held)
