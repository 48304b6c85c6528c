# SPDX-License-Identifier: Apache-2.0
"""Predicted errors on a grid with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ShapeError
from otf_core.model.evaluation import mean_length, without_rigid_motion


@dataclass(frozen=True)
class VolumeErrors:
    """Predicted errors on a grid.

    Attributes
    ----------
    points : ndarray, shape (n, 3), m
        Nominal positions of the target: without rotary axes the programmed positions.
    errors, u : ndarray, shape (n, 3), m
        Error in the gauge of the tables, and its standard uncertainty (k = 1).
    provisional : bool
        From a part of the run.
    axes : tuple of str
        Letters of the axes of a machine with rotary axes.
    positions : ndarray, shape (n, k), m and rad
        Their programmed positions at the points.

    Raises
    ------
    ShapeError
        If the arrays differ in shape.
    """

    points: Array
    errors: Array
    u: Array
    provisional: bool = False
    axes: tuple[str, ...] = ()
    positions: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        """Check the shapes."""
        shapes = [field.shape for field in (self.points, self.errors, self.u)]
        if len(set(shapes)) > 1 or shapes[0][1:] != (3,):
            raise ShapeError(f'points, errors and u need one shape (n, 3), got {shapes}')

    @property
    def mean(self) -> float:
        """Mean length of the errors without a rigid motion of the whole (m), as in reports."""
        if not len(self.points):
            return 0.0
        return mean_length(without_rigid_motion(self.errors, self.points))
