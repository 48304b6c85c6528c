# SPDX-License-Identifier: Apache-2.0
"""The published path as it is matched: corners as they are, curves thinned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.model.path import NominalPath
from otf_core.tracking.curves import PathShape, shape_of
from otf_core.tracking.driving_order import Match
from otf_core.tracking.matching import find_match
from otf_core.tracking.track import Track


@dataclass(frozen=True)
class Guide:
    """What is matched.

    Attributes
    ----------
    shape : PathShape
    vertex : ndarray of int64, shape (v,)
        Corner points that are matched: curves are thinned.
    """

    shape: PathShape
    vertex: NDArray[np.int64]

    @classmethod
    def of(cls, path: NominalPath, tolerance: float) -> Guide:
        """Find corners and curves of a path."""
        corners, _ = path.corners()
        if len(corners) < 3:
            raise InputError('path: a single straight line cannot be aligned; it needs corners')
        shape = shape_of(corners)
        return cls(shape, shape.vertices(0.5 * tolerance))

    @property
    def vertices(self) -> Array:
        """Points of ``vertex``, shape (v, 3), m."""
        return self.shape.corners[self.vertex]

    @property
    def curve(self) -> NDArray[np.int64]:
        """Curve, numbered from 0, of the leg between successive vertices, shape (v - 1,)."""
        stretch = self.shape.stretch[self.vertex[:-1]]
        return np.asarray(np.unique(stretch, return_inverse=True)[1], dtype=np.int64)

    @property
    def cuts(self) -> Array:
        """Vertices on curves, shape (c, 3), m."""
        curved = self.shape.curved
        on = np.concatenate([curved[:1], curved]) | np.concatenate([curved, curved[-1:]])
        return np.asarray(self.shape.corners[self.vertex[on[self.vertex]]])

    def find(self, track: Track, tolerance: float, by_length: bool = True) -> Match | None:
        """Match a track without any prior knowledge, see ``find_match``."""
        return find_match(track, self.vertices, tolerance, self.cuts, by_length)
