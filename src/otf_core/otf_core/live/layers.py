# SPDX-License-Identifier: Apache-2.0
"""Picture of a run: its track, distance from the path, layers in the machine frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.model.path import MIN_LEG, NominalPath

# The measured track of a run: thinned to a few hundred points, and its distance from the path.

TRACK_POINTS = 400
"""So many points a run is thinned to; there are at most twice as many at any moment."""
OFF_PATH_DISTANCE = 5e-3
"""m; farther away a target is not on the path: it is brought there, or the pose is another's."""
NO_POINTS = np.empty((0, 3))


class PathDistance:
    """Nearest places on a polyline, each leg asked; for single points and short lists."""

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


# What a picture of a run consists of: layers in the machine frame, enlargement of errors.

ENLARGEMENT_STEPS = (1.0, 2.0, 5.0, 10.0)
ARROW_SHARE = 0.08
"""Largest share of the size of the scene that the longest arrow takes."""
Colour = tuple[float, float, float, float]
STRIP, LINES, POINTS, TEXT = KINDS = ('strip', 'lines', 'points', 'text')
"""Connected points; a line from every first to every second point; dots; words at a point."""
GREY: Colour = (0.5, 0.5, 0.5, 0.7)
BLUE: Colour = (0.0, 0.447, 0.698, 1.0)
VERMILION: Colour = (0.835, 0.369, 0.0, 1.0)
GREEN: Colour = (0.0, 0.62, 0.451, 1.0)
PURPLE: Colour = (0.8, 0.475, 0.655, 1.0)
"""Distinguishable for colour-blind readers (Okabe and Ito 2008), on light and on dark ground."""
DRAWN_POINTS = 5000
"""Points of a path that are drawn; of longer ones every second, third ... is."""
LINE = 0.002
"""Width of a line as a share of the size of the scene."""


def enlargement(vectors: NDArray[np.float64], size: float) -> float:
    """Factor 1, 2 or 5 times a power of ten that makes errors visible.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3), m
        Errors; the longest but for five in a hundred counts.
    size : float
        m; of the scene.

    Returns
    -------
    float
        1 if there is nothing to enlarge.
    """
    lengths = np.linalg.norm(vectors, axis=1) if len(vectors) else np.zeros(1)
    longest = float(np.quantile(lengths, 0.95))
    if not longest > 0.0 or not size > 0.0:
        return 1.0
    wanted = ARROW_SHARE * size / longest
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(
        step * decade for step in ENLARGEMENT_STEPS if step * decade <= wanted * (1.0 + 1e-9)
    )


@dataclass(frozen=True)
class Layer:
    """A layer of a picture.

    Attributes
    ----------
    kind : str
        One of KINDS.
    points : ndarray, shape (n, 3), m
        In the machine frame.
    colour : tuple
        Red, green, blue, opacity, 0 to 1.
    width : float
        m; of lines and dots, height of words.
    """

    name: str
    kind: str
    points: Array
    colour: Colour
    width: float
    text: str = ''


def size_of(path: NominalPath) -> float:
    """Diagonal of the box around a path, m."""
    return float(np.linalg.norm(np.ptp(path.points, axis=0)))


def driven_part(path: NominalPath, travelled: float) -> Array:
    """Corner points of the path up to a travelled length, shape (n, 3), m."""
    reach = np.concatenate([[0.0], np.cumsum(path.leg_lengths)])
    last = int(np.searchsorted(reach, travelled, side='right'))
    if last > len(path.leg_lengths):
        return path.points
    end = path.points[last - 1] + (travelled - reach[last - 1]) * path.directions[last - 1]
    return np.vstack([path.points[:last], end])


def thin(points: Array, most: int = DRAWN_POINTS) -> Array:
    """Leave out points evenly so that about ``most`` are left, the last among them."""
    step = -(-len(points) // most)
    return points if step == 1 else np.vstack([points[::step], points[-1]])


def scene(path: NominalPath, volume: VolumeErrors | None) -> list[Layer]:
    """Layers that stay: the path, and the errors that tables predict."""
    size = size_of(path)
    layers = [Layer('path', STRIP, thin(path.points), GREY, LINE * size)]
    if volume is None or not len(volume.points):
        return layers
    factor = enlargement(volume.errors, size)
    tips = volume.points + factor * volume.errors
    arrows = np.stack([volume.points, tips], axis=1).reshape(-1, 3)
    place = np.vstack([volume.points, path.points]).max(axis=0) + 0.1 * size
    words = f'errors{" so far" if volume.provisional else ""} {_times(factor)}\n'
    words += 'blue: standard uncertainty, about what compensation leaves'
    return [
        *layers,
        Layer('errors', LINES, arrows, VERMILION, LINE * size),
        Layer('error_tips', POINTS, tips, VERMILION, 4 * LINE * size),
        Layer('uncertainty', LINES, _crosses(tips, factor * volume.u), BLUE, LINE * size),
        Layer('error_legend', TEXT, place[None], VERMILION, 12 * LINE * size, words),
    ]


def moving(
    path: NominalPath, travelled: float, track: Track, pose: RigidTransform | None, scale: float
) -> list[Layer]:
    """Layers that change as the machine drives.

    Parameters
    ----------
    travelled : float
        m, so far.
    pose : RigidTransform, optional
        Of the tracker in the machine frame, once it is known.
    scale : float
        Deviations are enlarged so many times; 0: so that they are seen.
    """
    size = size_of(path)
    layers = [Layer('driven', STRIP, thin(driven_part(path, travelled)), BLUE, 2 * LINE * size)]
    if pose is None:
        return layers
    tracker = pose.translation
    layers += [
        Layer('tracker', POINTS, tracker[None], PURPLE, 20 * LINE * size),
        Layer('tracker_name', TEXT, tracker[None], PURPLE, 12 * LINE * size, 'tracker'),
    ]
    target = track.position
    if target is not None:
        beam = np.vstack([tracker, target])
        layers += [
            Layer('beam', LINES, beam, PURPLE, LINE * size),
            Layer('target', POINTS, target[None], GREEN, 10 * LINE * size),
        ]
    return [*layers, *_deviations(track, size, scale, path.points.min(axis=0))]


def _deviations(track: Track, size: float, scale: float, corner: Array) -> list[Layer]:
    places, deviations = track.deviations()
    if not len(places):
        return []
    factor = scale or enlargement(deviations, size)
    arrows = np.stack([places, places + factor * deviations], axis=1).reshape(-1, 3)
    words = f'deviation from the path {_times(factor)}'
    return [
        Layer('deviations', LINES, arrows, GREEN, LINE * size),
        Layer('deviation_legend', TEXT, corner[None] - 0.1 * size, GREEN, 12 * LINE * size, words),
    ]


def _times(factor: float) -> str:
    return f'x {factor:,.0f}: 10 mm stand for {1e4 / factor:.3g} um'


def _crosses(centres: Array, half: Array) -> Array:
    """Lines of plus and minus ``half`` (n, 3) along each axis at the centres, shape (6 n, 3)."""
    arms = half[:, :, None] * np.eye(3)
    ends = np.stack([centres[:, None] - arms, centres[:, None] + arms], axis=2)
    return np.asarray(ends.reshape(-1, 3))
