# SPDX-License-Identifier: Apache-2.0
"""The volume that was driven: the convex hull of the path pieces that the tables come from.

``driven`` in error_tables.json: ``corners`` of the hull (m, machine frame), its ``planes``
(outward unit normal and offset in m: n . p + d <= 0 in the hull; made of the corners where a file
holds none) and ``margin`` (m): pieces end before the corners of the path, so the hull is taken
that much larger. Beside it counts, axis by axis, the range of the tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.documents import Document, stated
from otf_core.errors import InputError
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.tables import ErrorTables

FLAT = 1e-4
"""m; a hull that is thinner in some direction is taken as flat there."""
EDGE = 1e-6
"""m; points this close to the end of a table count as inside."""


@dataclass(frozen=True)
class DrivenVolume(Document):
    """Convex hull of what was driven."""

    corners: Array = stated('corners of the hull', 'm', shape=('n', 3))
    margin: float = stated('points this close count as inside', 'm', least=0.0, default=0.0)
    planes: Array = stated(
        'outward unit normal and offset of what bounds the hull; two for a direction in which it '
        'is flat', '1 and m', shape=('k', 4), default=None,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Make the planes where a file holds none; InputError without a corner or a plane."""
        if not len(self.corners) or (self.planes is not None and not len(self.planes)):
            raise InputError('needs a corner and a plane at least')
        if self.planes is None:
            object.__setattr__(self, 'planes', _hull(self.corners)[1])

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Tell for points (n, 3), m, whether they lie in the hull, the margin included."""
        out = np.max(q @ self.planes[:, :3].T + self.planes[:, 3], axis=1)
        return np.asarray(out <= self.margin)


def _frame(points: Array) -> tuple[Array, Array, int]:
    """Centre, principal directions (rows), and in how many of them the points extend."""
    centre = points.mean(axis=0)
    axes = np.linalg.svd(np.linalg.qr(points - centre, mode='r'))[2]
    extent = np.ptp((points - centre) @ axes.T, axis=0)
    return centre, axes, int(np.sum(extent > FLAT))


def _hull(points: Array) -> tuple[Array, Array]:
    """Which points are the corners of their hull, ascending, and its planes, shape (k, 4)."""
    from scipy.spatial import ConvexHull  # loaded on use: predicting needs none

    centre, axes, size = _frame(points)
    local = (points - centre) @ axes.T
    flat = [np.r_[sign * axes[k], 0.0] for k in range(size, 3) for sign in (1.0, -1.0)]
    if size > 1:
        hull = ConvexHull(local[:, :size])
        vertices = np.sort(hull.vertices)
        faces = np.unique(hull.equations, axis=0)  # qhull cuts a face into triangles
        planes = np.column_stack([faces[:, :-1] @ axes[:size], faces[:, -1]])
    elif size == 1:
        ends = np.array([local[:, 0].argmax(), local[:, 0].argmin()])
        vertices = np.sort(ends)
        planes = np.array(
            [[*s * axes[0], -s * local[k, 0]] for s, k in zip((1, -1), ends, strict=True)]
        )
    else:
        vertices, planes = np.zeros(1, dtype=int), np.empty((0, 4))
    planes = np.concatenate([planes, np.reshape(flat, (-1, 4))])
    planes[:, 3] -= planes[:, :3] @ centre
    return vertices, planes


def driven_volume(points: Array, margin: float) -> DrivenVolume:
    """Volume of points (n, 3), m: only the corners of their hull are kept."""
    corners = points[_hull(points)[0]]
    return DrivenVolume(corners, margin, _hull(corners)[1])


def table_ranges(tables: ErrorTables) -> tuple[Array, Array]:
    """Range of every axis that the tables hold.

    Where motions differ, it is the part that all identifiable motions with more than one node
    share; where an axis has none of these, what any of its tables reaches.

    Returns
    -------
    low, high : ndarray, shape (k,), m and rad
    """
    machine = tables.machine
    low, high = np.zeros((2, len(machine.axis_names)))
    for k, axis in enumerate(machine.axis_names):
        own = [tables.motions[m] for m in machine.motions if m.axis == axis]
        seen = [t for t in own if t.identifiable and len(t.position) > 1]
        if seen:
            low[k] = max(t.position[0] for t in seen)
            high[k] = min(t.position[-1] for t in seen)
        if not seen or low[k] > high[k]:
            low[k] = min(t.position[0] for t in own)
            high[k] = max(t.position[-1] for t in own)
    return low, high


def linear_positions(machine: Machine, q: Array) -> Array:
    """Positions (n, 3), m, of X, Y and Z at axis positions (n, k), zero along what is no axis."""
    linear = np.zeros((len(q), 3))
    for k, axis in enumerate(AXES):
        if axis in machine.axis_names:
            linear[:, k] = q[:, machine.column(axis)]
    return linear


def inside(tables: ErrorTables, driven: DrivenVolume | None, q: Array) -> NDArray[np.bool_]:
    """Determine which positions (n, k), m and rad, lie in the tables and in what was driven.

    The hull of what was driven is that of the linear axes, zero along what is none.
    """
    machine, (low, high) = tables.machine, table_ranges(tables)
    at = machine.wrapped(q)
    within = np.all((at >= low - EDGE) & (at <= high + EDGE), axis=1)
    if driven is None:
        return np.asarray(within)
    return np.asarray(within & driven.holds(linear_positions(machine, q)))
