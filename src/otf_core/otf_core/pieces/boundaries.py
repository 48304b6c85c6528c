# SPDX-License-Identifier: Apache-2.0
"""Where the pieces of a path begin and end: at table nodes, and in equal parts between them."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.tracking.curves import Lines, curve_boundaries

MOST = 200
"""Equal parts of one leg: long legs are those of large machines, whose functions are as long."""


def piece_boundaries(corners: Array, leg: int, nodes: tuple[Array, ...], size: float) -> Array:
    """Piece boundaries along one leg, m from its start: node crossings, then equal parts.

    Parts are ``size`` long, on legs of more than ``MOST`` of them longer.
    """
    step = corners[leg + 1] - corners[leg]
    length = float(np.linalg.norm(step))
    size = max(size, length / MOST)
    cuts = [np.array([0.0, length])]
    for axis in range(3):
        if abs(step[axis]) > 1e-9:
            cuts.append((nodes[axis] - corners[leg, axis]) / step[axis] * length)
    marks = np.unique(np.concatenate(cuts))
    marks = marks[(marks >= 0) & (marks <= length)]
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-6])]
    span = np.diff(marks)
    parts = np.maximum(np.ceil(span / size), 1.0).astype(np.int64)
    place = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = place * np.repeat(span / parts, parts) + np.repeat(marks[:-1], parts)
    return np.append(inner, length)


def all_boundaries(
    lines: Lines, first: Index, nodes: tuple[Array, ...], size: float
) -> list[Array]:
    """Piece boundaries of every leg or part of a curve, m from its start.

    Parameters
    ----------
    lines : Lines
    first : ndarray of int64, shape (k,)
        First leg of each.
    nodes : three ndarrays, m
        Table nodes of the axes.
    size : float
        m.
    """
    corners, ends = lines.shape.corners, np.append(first[1:], len(lines.length))
    known: dict[bytes, Array] = {}  # laps drive the same lines

    def boundaries(a: int, b: int) -> Array:
        driven = corners[a : b + 1]
        key = driven.tobytes()
        if key not in known:
            known[key] = (
                piece_boundaries(driven, 0, nodes, size)
                if b == a + 1
                else curve_boundaries(driven, nodes, size)
            )
        return known[key]

    return [boundaries(a, b) for a, b in zip(first.tolist(), ends.tolist(), strict=True)]
