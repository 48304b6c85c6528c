# SPDX-License-Identifier: Apache-2.0
"""Nominal path: corner points in driving order, straight legs between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import InputError, ShapeError
from otf_core.model.frames import RigidTransform

FURTHEST = 1e6
"""m; nothing is measured there, and squares of lengths stay finite."""
MIN_LEG = 1e-6
"""m; shorter legs are repeated corner points, not motion."""
MOVING = 1e-6
"""Component of a unit direction below which an axis stands."""
TRAVELS = 0.05
"""The same where what is measured has to show the travel of the axis."""


@dataclass(frozen=True)
class NominalPath:
    """A polyline in the machine frame.

    Attributes
    ----------
    points : array_like, shape (n, 3), m
        Corner points in driving order; repeated points (dwells) are allowed.

    Raises
    ------
    ShapeError
        If points is not (n, 3).
    InputError
        If there are fewer than two different points or a coordinate is not finite.

    Examples
    --------
    >>> path = otf_core.NominalPath([[0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0]])
    >>> round(path.length, 9), path.leg_lengths.tolist()
    (0.7, [0.3, 0.4])
    """

    points: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check shape and content."""
        object.__setattr__(self, 'points', np.asarray(self.points, dtype=float))
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ShapeError(f'a path needs points of shape (n, 3), got {self.points.shape}')
        if not np.all(np.isfinite(self.points)):
            first = int(np.flatnonzero(~np.isfinite(self.points).all(axis=1))[0])
            raise InputError(f'path: point {first} is not finite')
        far = np.abs(self.points).max(axis=1, initial=0.0) > FURTHEST
        if far.any():
            first = int(np.argmax(far))
            raise InputError(
                f'path: point {first} is more than {FURTHEST:g} m away; the unit is m'
            )
        if len(self.points) < 2 or self.leg_lengths.max() <= MIN_LEG:
            raise InputError(
                f'path: {len(self.points)} points without any motion between them; '
                f'a path needs at least two different corner points'
            )

    @cached_property
    def leg_lengths(self) -> NDArray[np.float64]:
        """Length of every leg, shape (n - 1,), m."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=0), axis=1))

    @property
    def part_lengths(self) -> list[float]:
        """Length of every part, m: one target in view from one end to the other is one."""
        return [self.length]

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Unit travel direction of every leg, shape (n - 1, 3); zero for a repeated point."""
        lengths = np.where(self.leg_lengths > MIN_LEG, self.leg_lengths, np.inf)
        return np.asarray(np.diff(self.points, axis=0) / lengths[:, None])

    @property
    def length(self) -> float:
        """Total length, m."""
        return float(self.leg_lengths.sum())

    def corners(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Merge repeated points and straight-through points.

        Returns
        -------
        points : ndarray, shape (k, 3), m
            Where the travel direction really changes, with start and end.
        index : ndarray of int64, shape (k,)
            Their indices in ``points`` of the path.
        """
        keep = [0]
        for i in range(1, len(self.points)):
            if np.linalg.norm(self.points[i] - self.points[keep[-1]]) > MIN_LEG:
                keep.append(i)
        used = np.array(keep)
        step = np.diff(self.points[used], axis=0)
        unit = step / np.linalg.norm(step, axis=1)[:, None]
        turn = np.linalg.norm(np.diff(unit, axis=0), axis=1) > 1e-6
        index = used[np.concatenate([[True], turn, [True]])]
        return self.points[index], index


@dataclass(frozen=True)
class Legs:
    """Straight legs between successive points.

    Attributes
    ----------
    corners : ndarray, shape (m + 1, 3), m
        Leg j runs from corner j to corner j + 1; repeated in plans alone, where the machine waits.
    """

    corners: Array

    @cached_property
    def step(self) -> Array:
        """From start to end of every leg, shape (m, 3), m."""
        return np.asarray(np.diff(self.corners, axis=0))

    @cached_property
    def length(self) -> Array:
        """Length of every leg, shape (m,), m."""
        return np.asarray(np.linalg.norm(self.step, axis=1))

    @cached_property
    def unit(self) -> Array:
        """Direction of every leg, shape (m, 3); zero for a repeated point."""
        return np.asarray(self.step / np.where(self.length > 0.0, self.length, np.inf)[:, None])

    @cached_property
    def reach(self) -> Array:
        """Path length from the first corner to every corner, shape (m + 1,), m."""
        return np.concatenate([[0.0], np.cumsum(self.length)])

    def seen_from(self, T_machine_tracker: RigidTransform) -> Legs:
        """Return the same legs in the frame of a tracker: there samples are as they are."""
        pose = T_machine_tracker
        return Legs((self.corners - pose.translation) @ pose.rotation)

    def along(self, points: Array, leg: NDArray[np.int64]) -> Array:
        """Position of points (n, 3) on their legs (n,), m from the start, not clipped."""
        away = points - self.corners.take(leg, axis=0)
        return np.asarray(np.einsum('ij,ij->i', away, self.unit.take(leg, axis=0)))

    def at(self, along: Array, leg: NDArray[np.int64]) -> Array:
        """Points on legs (n,) at positions (n,), m from their start, shape (n, 3), m."""
        positions = self.corners.take(leg, axis=0)
        for k in range(3):
            positions[:, k] += along * self.unit[:, k].take(leg)
        return np.asarray(positions)


def leg_bounds(leg: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First place and one past the last of every run of the same leg, in driving order."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(leg)) + 1, [len(leg)]])
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def sides_of_travel(unit: Array) -> Array:
    """Side on which each axis ends up on every leg.

    Parameters
    ----------
    unit : ndarray, shape (m, 3)
        Unit directions of the legs in driving order.

    Returns
    -------
    ndarray, shape (m, 3)
        Sign of the travel of each axis; where it stands, that of its last travel; 0 before its
        first.
    """
    moving = np.abs(unit) > MOVING
    last = np.maximum.accumulate(np.where(moving, np.arange(len(unit))[:, None], 0), axis=0)
    sign = np.where(moving, np.sign(unit), 0.0)
    return np.asarray(np.take_along_axis(sign, last, axis=0))
