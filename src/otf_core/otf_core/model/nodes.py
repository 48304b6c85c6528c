# SPDX-License-Identifier: Apache-2.0
"""Nodes of tables: where they stand on an axis, and straight lines between them."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.model.machine import Axis, Machine

SAME_PLACE = 1e-6
"""m; positions that differ by less are one."""


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
    low, high : ndarray, shape (3,), m
        Covered part of the axis ranges.

    Returns
    -------
    mapping of axis to ndarray, m
        The ends of the covered part and the regular nodes between; a regular node closer than a
        quarter of the spacing to an end that is not the axis' own gives way to it.
    """
    nodes = {}
    for k, axis in enumerate(machine.axis_names):
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


def hat_matrix(nodes: Array, q: Array) -> Array:
    """Values at positions of a table from those at its nodes: straight lines, constant outside.

    Parameters
    ----------
    nodes : ndarray, shape (k,), m
    q : ndarray, shape (n,), m

    Returns
    -------
    ndarray, shape (n, k)
        Hat functions of the nodes.
    """
    if len(nodes) == 1:
        return np.ones((len(q), 1))
    index = np.clip(np.searchsorted(nodes, q, side='right') - 1, 0, len(nodes) - 2)
    fraction = np.clip((q - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)
    matrix, row = np.zeros((len(q), len(nodes))), np.arange(len(q))
    matrix[row, index], matrix[row, index + 1] = 1.0 - fraction, fraction
    return matrix
