# SPDX-License-Identifier: Apache-2.0
"""One step of a rigid motion towards lines: least squares of the distances across them.

A motion u + w x l moves a point l along its line d by [d, l x d] . [u, w], which costs nothing;
all else counts. Points of one line differ in l alone, so a line needs no more of them than their
moments up to the second.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.errors import InputError


def line_step(
    points: Array, origin: Array, direction: Array, weight: Array, line: Index
) -> tuple[Array, Array]:
    """One least-squares step of a rigid motion towards lines.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Measured points in the machine frame.
    origin, direction : ndarray, shape (m, 3)
        A point (m) and the unit direction of each line.
    weight : ndarray, shape (n,)
    line : ndarray of int64, shape (n,)
        Line of each point.

    Returns
    -------
    translation : ndarray, shape (3,), m
    rotation_vector : ndarray, shape (3,), rad
        About the origin of the machine frame.

    Raises
    ------
    InputError
        If the lines leave a motion free, such as turning about a single line.
    """
    centre = np.ones(len(points)) @ points / len(points)
    local = np.subtract(points.T, centre[:, None], order='C')
    size = float(np.sqrt(np.vdot(local, local) / len(points))) or 1.0
    local /= size
    away, unit = np.ascontiguousarray((centre - origin).T), np.ascontiguousarray(direction.T)
    moments = _moments(local, weight / weight.sum(), line, len(origin))
    normal, right = _line_sums(*moments, away, unit, size)
    if np.linalg.eigvalsh(normal)[0] < 1e-7:
        raise InputError(
            'the driven lines do not fix the place of the tracker (all parallel or too few); '
            'record the whole path'
        )
    motion = np.linalg.solve(normal, right)
    rotation_vector = motion[3:] / size
    return np.asarray(motion[:3] - np.cross(rotation_vector, centre)), np.asarray(rotation_vector)


def _moments(local: Array, share: Array, line: Index, lines: int) -> tuple[Array, Array, Array]:
    """Sums over the points (3, n) of every line of 1, l and l l^T: (m,), (3, m), (3, 3, m)."""
    passages = np.flatnonzero(np.diff(line, prepend=-1))  # points in a row on the same line
    passed = line[passages]

    def of_lines(values: Array) -> Array:
        sums = np.bincount(passed, np.add.reduceat(values, passages), lines)
        return sums.astype(np.float64, copy=False)

    square = np.empty((3, 3, lines))
    weighted = local * share
    for i in range(3):
        for j in range(i + 1):
            square[i, j] = square[j, i] = of_lines(weighted[i] * local[j])
    return of_lines(share), np.stack([of_lines(row) for row in weighted]), square


def _line_sums(
    total: Array, mean: Array, square: Array, away: Array, unit: Array, size: float
) -> tuple[Array, Array]:
    """Normal matrix (6, 6) and right side (6,) of ``line_step`` from the moments of lines.

    ``away`` (3, m) leads from a point of each line to the centre of all points, m.
    """
    off, turned = size * mean + away * total, _cross(square, unit)
    along = np.stack([unit * total, _cross(mean, unit)]).reshape(6, -1) @ unit.T
    normal = np.zeros((6, 6))
    normal[:3, :3] = total.sum() * np.eye(3) - along[:3]
    normal[3:, :3] = -along[3:] - np.cross(mean.sum(axis=1), np.eye(3))
    normal[:3, 3:] = normal[3:, :3].T
    whole = square.sum(axis=2)
    normal[3:, 3:] = np.trace(whole) * np.eye(3) - whole
    normal[3:, 3:] -= _cross(np.swapaxes(turned, 0, 1), unit).sum(axis=2)
    across = away - unit * np.sum(unit * away, axis=0)
    turn = _cross(mean, across) - size * np.einsum('ikm,km->im', turned, unit)
    shift = off - unit * np.sum(unit * off, axis=0)
    return normal, -np.concatenate([shift.sum(axis=1), turn.sum(axis=1)])


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (3, ..., m) with vectors (3, m)."""
    rest = ((1, 2), (2, 0), (0, 1))
    return np.stack([a[i] * b[j] - a[j] * b[i] for i, j in rest])
