# SPDX-License-Identifier: Apache-2.0
"""Deviation of measured points from the nearest place on the nominal path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.model.path import MIN_LEG, NominalPath

Array = NDArray[np.float64]


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
