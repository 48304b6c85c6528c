# SPDX-License-Identifier: Apache-2.0
"""The volume that was driven: the convex hull of the path pieces that the tables come from.

``driven`` in error_tables.json: ``corners`` of the hull (m, machine frame) and ``margin`` (m):
pieces end before the corners of the path, so the hull is taken that much larger. Beside it
counts, axis by axis, the range of the tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.model.machine import AXES
from otf_core.model.motions import MOTIONS
from otf_core.model.tables import ErrorTables

Array = NDArray[np.float64]

FLAT = 1e-4
"""m; a hull that is thinner in some direction is taken as flat there."""
EDGE = 1e-6
"""m; points this close to the end of a table count as inside."""


@dataclass(frozen=True)
class DrivenVolume:
    """Convex hull of what was driven.

    Attributes
    ----------
    corners : ndarray, shape (n, 3), m
    margin : float
        m; points this close to the hull count as inside.
    """

    corners: Array
    margin: float

    def _frame(self) -> tuple[Array, Array, int]:
        """Centre, principal directions (rows), and in how many of them the hull extends."""
        centre = self.corners.mean(axis=0)
        axes = np.linalg.svd(np.linalg.qr(self.corners - centre, mode='r'))[2]
        extent = np.ptp((self.corners - centre) @ axes.T, axis=0)
        return centre, axes, int(np.sum(extent > FLAT))

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Tell for points (n, 3), m, whether they lie in the hull, the margin included."""
        from scipy.spatial import ConvexHull

        centre, axes, size = self._frame()
        points, corners = ((p - centre) @ axes.T for p in (q, self.corners))
        near = np.all(np.abs(points[:, size:]) <= self.margin, axis=1)
        if size == 0:
            return np.asarray(near)
        if size == 1:
            low, high = corners[:, 0].min(), corners[:, 0].max()
            out = np.maximum(low - points[:, 0], points[:, 0] - high)
        else:
            planes = ConvexHull(corners[:, :size]).equations
            out = np.max(points[:, :size] @ planes[:, :-1].T + planes[:, -1], axis=1)
        return np.asarray(near & (out <= self.margin))

    def to_dict(self) -> dict[str, Any]:
        """Return the volume as plain data, as in error_tables.json."""
        return {'corners': self.corners.tolist(), 'margin': self.margin}


def driven_volume(points: Array, margin: float) -> DrivenVolume:
    """Volume of points (n, 3), m: only the corners of their hull are kept."""
    from scipy.spatial import ConvexHull

    whole = DrivenVolume(points, margin)
    centre, axes, size = whole._frame()
    flat = ((points - centre) @ axes.T)[:, :size]
    if size > 1:
        kept = ConvexHull(flat).vertices
    elif size == 1:
        kept = np.array([flat[:, 0].argmin(), flat[:, 0].argmax()])
    else:
        kept = np.zeros(1, dtype=int)
    return DrivenVolume(points[np.sort(kept)], margin)


def driven_from_dict(data: Any, where: str) -> DrivenVolume | None:
    """Read ``driven`` of an error_tables.json; None if the file holds none.

    Raises
    ------
    ConfigError
        If it is there and is no such volume.
    """
    if data is None:
        return None
    wrong = ConfigError(f'{where}: driven: expected corners (lists of x, y, z in m) and margin')
    if not isinstance(data, Mapping):
        raise wrong
    try:
        corners = np.asarray(data['corners'], dtype=float)
        margin = float(data.get('margin', 0.0))
    except (KeyError, TypeError, ValueError):
        raise wrong from None
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.all(np.isfinite(corners)):
        raise wrong
    if not (np.isfinite(margin) and margin >= 0):
        raise wrong
    return DrivenVolume(corners, margin)


def table_ranges(tables: ErrorTables) -> tuple[Array, Array]:
    """Range of every axis that the tables hold.

    Where motions differ, it is the part that all identifiable motions with more than one node
    share; where an axis has none of these, what any of its tables reaches.

    Returns
    -------
    low, high : ndarray, shape (3,), m
    """
    low, high = np.zeros(3), np.zeros(3)
    for k, axis in enumerate(AXES):
        own = [tables.motions[m] for m in MOTIONS if m.axis == axis]
        seen = [t for t in own if t.identifiable and len(t.position) > 1]
        if seen:
            low[k] = max(t.position[0] for t in seen)
            high[k] = min(t.position[-1] for t in seen)
        if not seen or low[k] > high[k]:
            low[k] = min(t.position[0] for t in own)
            high[k] = max(t.position[-1] for t in own)
    return low, high


def inside(tables: ErrorTables, driven: DrivenVolume | None, q: Array) -> NDArray[np.bool_]:
    """Tell which points (n, 3), m, lie in the range of the tables and in what was driven."""
    low, high = table_ranges(tables)
    within = np.all((q >= low - EDGE) & (q <= high + EDGE), axis=1)
    return np.asarray(within if driven is None else within & driven.holds(q))
