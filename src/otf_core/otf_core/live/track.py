# SPDX-License-Identifier: Apache-2.0
"""The measured track of a run: thinned to a few hundred points, and its distance from the path."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.model.frames import RigidTransform
from otf_core.model.path import MIN_LEG, NominalPath

TRACK_POINTS = 400
"""So many points a run is thinned to; there are at most twice as many at any moment."""
OFF_PATH_DISTANCE = 5e-3
"""m; farther away a target is not on the path: it is brought there, or the pose is another's."""
NO_POINTS = np.empty((0, 3))


class PathDistance:
    """Nearest places on a polyline, each leg asked; for single points and short lists.

    Parameters
    ----------
    path : NominalPath
    """

    def __init__(self, path: NominalPath) -> None:
        moving = path.leg_lengths > MIN_LEG
        self._start = path.points[:-1][moving]
        self._unit = path.directions[moving]
        self._length = path.leg_lengths[moving]

    def deviation(self, points: Array) -> Array:
        """Deviation of points from the path.

        Parameters
        ----------
        points : ndarray, shape (n, 3), m
            In the machine frame.

        Returns
        -------
        ndarray, shape (n, 3), m
            Point minus the nearest place on the path.
        """
        return np.array([self._of_one(point) for point in points]).reshape(-1, 3)

    def _of_one(self, point: Array) -> Array:
        away = point - self._start
        along = np.clip(np.einsum('ij,ij->i', away, self._unit), 0.0, self._length)
        away = away - along[:, None] * self._unit
        return np.asarray(away[np.argmin(np.einsum('ij,ij->i', away, away))])


class Track:
    """Points of the target far enough apart, with their deviations once a pose is known.

    Attributes
    ----------
    target : ndarray, shape (3,), m, or None
        Latest point in the tracker frame.
    """

    def __init__(self) -> None:
        self._distance: PathDistance | None = None
        self._pose: RigidTransform | None = None
        self._length = 0.0
        self.clear()

    def clear(self) -> None:
        """Forget the points."""
        self.target: Array | None = None
        self._points: list[Array] = []
        self._deviations: list[Array] = []
        self._spacing = self._length / TRACK_POINTS

    def set_path(self, path: NominalPath) -> None:
        """Take another path."""
        self._distance, self._length = PathDistance(path), path.length
        self._spacing = self._length / TRACK_POINTS
        self._again()

    def set_pose(self, pose: RigidTransform | None) -> None:
        """Take the place of the tracker, or that it is not known."""
        self._pose = pose
        self._again()

    def add(self, x: float, y: float, z: float) -> None:
        """Take the latest point in the tracker frame, m; it is kept if the last is far enough."""
        self.target = np.array([x, y, z])
        if self._points and np.linalg.norm(self.target - self._points[-1]) < self._spacing:
            return
        if len(self._points) >= 2 * TRACK_POINTS:
            self._points, self._deviations = self._points[::2], self._deviations[::2]
            self._spacing *= 2.0
        self._points.append(self.target)
        self._deviations.extend(self._deviation(self.target[None]))

    @property
    def position(self) -> Array | None:
        """Latest point in the machine frame, shape (3,), m; None without a pose."""
        if self.target is None or self._pose is None:
            return None
        return self._pose.apply(self.target)

    @property
    def distance(self) -> float:
        """Distance of the latest point from the path, m; NaN without a pose or off the path."""
        if self.target is None:
            return float('nan')
        return float(np.linalg.norm(self._deviation(self.target[None])[0]))

    def deviations(self) -> tuple[Array, Array]:
        """Return the places of the kept points that lie on the path, and their deviations.

        Returns
        -------
        places, deviations : ndarray, shape (n, 3), m
            In the machine frame; nothing as long as the place of the tracker is not known.
        """
        if self._pose is None or not self._points:
            return NO_POINTS, NO_POINTS
        away = np.array(self._deviations)
        near = np.isfinite(away).all(axis=1)
        return self._pose.apply(np.array(self._points)[near]) - away[near], away[near]

    def _deviation(self, points: Array) -> Array:
        if self._pose is None or self._distance is None:
            return np.full_like(points, np.nan)
        away = self._distance.deviation(self._pose.apply(points))
        return np.where(np.linalg.norm(away, axis=1)[:, None] > OFF_PATH_DISTANCE, np.nan, away)

    def _again(self) -> None:
        if self._points:
            self._deviations = list(self._deviation(np.array(self._points)))
