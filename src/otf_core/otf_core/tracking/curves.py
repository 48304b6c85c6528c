# SPDX-License-Identifier: Apache-2.0
"""Curves in a path of straight lines: arcs, circles and helices published as short chords.

A run of short chords that turn gently from one to the next is one *stretch*: the machine does not
stop at its joints, so nothing is left out there, and its pieces may span them. A stretch is cut
into *groups* that turn little enough to share one direction of the tracker's noise. A chord that
is long, or that meets its neighbours at an angle, is a stretch and a group of its own: a leg.

A piece of a curve has one direction, the mean of its samples', and one origin, the mean of their
feet on the chords. Deviations across the path of samples at small angles f to that direction sum
up to the deviation of the mean but for a share <f^2> of it, at most MAX_TURN^2 / 12: no sagitta
enters.

The path is the chords as they are published. An arc of curvature k leaves a chord of length L by
at most the sagitta k L^2 / 8: 1 um for chords of 1 mm and a radius of 125 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.path import MOVING, Legs
from otf_core.tracking.measured_track import simplify

MAX_CHORD = 0.02
"""m; longer lines are legs of their own, never chords of a curve."""
MAX_TURN_BETWEEN_CHORDS = np.radians(30.0)
"""A sharper turn is a corner."""
MIN_CHORDS = 3
"""Chords that make a curve; fewer are legs."""
SHORT_CURVE = 4.0
"""A curve shorter than this many corner exclusions is left out: it is a rounded corner."""
GROUP_TURN, GROUP_LENGTH = 1.0, 0.5
"""rad and m; groups turn no more and are no longer."""


@dataclass(frozen=True)
class PathShape:
    """A path of corner points with its curves.

    Attributes
    ----------
    corners : ndarray, shape (m + 1, 3), m
        Chord j runs from corner j to corner j + 1.
    stretch : ndarray of int64, shape (m,)
        First chord of the curve that each chord belongs to; its own number if to none.
    group : ndarray of int64, shape (m,)
        First chord of the part of that curve.
    """

    corners: Array
    stretch: Index
    group: Index

    @property
    def straight(self) -> bool:
        """True if every chord is a leg of its own."""
        return bool(np.all(self.stretch == np.arange(len(self.stretch))))

    @property
    def curved(self) -> NDArray[np.bool_]:
        """True for every chord that belongs to a curve, shape (m,)."""
        number = np.arange(len(self.stretch))
        return np.asarray(np.bincount(self.stretch, minlength=len(number))[self.stretch] > 1)

    def vertices(self, tolerance: float) -> Index:
        """Corner points that are matched: curves thinned to within ``tolerance``, m."""
        bounds = [*np.unique(self.stretch).tolist(), len(self.stretch)]
        parts = [
            a + simplify(self.corners[a : b + 1], tolerance)[:-1] if b - a > 1 else [a]
            for a, b in pairwise(bounds)
        ]
        return np.concatenate([*parts, [len(self.stretch)]]).astype(np.int64)


@dataclass(frozen=True)
class Lines(Legs):
    """Chords of a shape as lines, and where they lie on their curves.

    Attributes
    ----------
    start : ndarray, shape (m,), m
        Path length from the start of the stretch to the start of the chord.
    total : ndarray, shape (m,), m
        Length of the stretch.
    """

    shape: PathShape
    start: Array
    total: Array

    @classmethod
    def of(cls, shape: PathShape) -> Lines:
        """Measure the chords of a shape."""
        legs, curved = Legs(shape.corners), shape.curved
        length, reach = legs.length, legs.reach
        start = np.where(curved, reach[:-1] - reach[shape.stretch], 0.0)
        total = np.bincount(shape.stretch, length, minlength=len(length))[shape.stretch]
        return cls(shape.corners, shape, start, np.where(curved, total, length))

    def settled(self, points: Array, chord: Index) -> Index:
        """Nearest chord of the same stretch, found by stepping from a chord near by.

        Parameters
        ----------
        points : ndarray, shape (n, 3), m
        chord : ndarray of int64, shape (n,)
            Where to begin.
        """
        if self.shape.straight:
            return chord
        chord, moving = chord.copy(), np.flatnonzero(self.shape.curved[chord])
        best = self._square(points[moving], chord[moving])
        last = len(self.length) - 1
        while len(moving):
            moved = np.zeros(len(moving), dtype=bool)
            for side in (-1, 1):
                other = np.clip(chord[moving] + side, 0, last)
                square = self._square(points[moving], other)
                same = self.shape.stretch[other] == self.shape.stretch[chord[moving]]
                better = same & (square < best * (1 - 1e-12) - 1e-24)
                chord[moving[better]] = other[better]
                best[better] = square[better]
                moved |= better
            moving, best = moving[moved], best[moved]
        return chord

    def _square(self, points: Array, chord: Index) -> Array:
        """Squared distance of points from their chords, ends counted."""
        along = np.clip(self.along(points, chord), 0.0, self.length[chord])
        off = points - self.at(along, chord)
        return np.asarray(np.einsum('ij,ij->i', off, off))


def turns(unit: Array) -> Array:
    """Angles between successive directions (m, 3), shape (m - 1,), rad."""
    cross = np.linalg.norm(np.cross(unit[:-1], unit[1:]), axis=1)
    return np.asarray(np.arctan2(cross, np.einsum('ij,ij->i', unit[:-1], unit[1:])))


def straight_shape(corners: Array) -> PathShape:
    """Take every chord as a leg of its own."""
    number = np.arange(len(corners) - 1)
    return PathShape(corners, number, number)


def shape_of(corners: Array) -> PathShape:
    """Find the curves of a path.

    Parameters
    ----------
    corners : ndarray, shape (m + 1, 3), m
        No point repeated.
    """
    legs = Legs(corners)
    length, number = legs.length, np.arange(len(corners) - 1)
    if len(length) < MIN_CHORDS or np.count_nonzero(length <= MAX_CHORD) < MIN_CHORDS:
        return straight_shape(corners)
    turn = turns(legs.unit)
    gentle = (
        (turn <= MAX_TURN_BETWEEN_CHORDS) & (length[:-1] <= MAX_CHORD) & (length[1:] <= MAX_CHORD)
    )
    first = np.concatenate([[True], ~gentle])
    stretch = number[first][np.cumsum(first) - 1]
    few = np.bincount(stretch, minlength=len(number))[stretch] < MIN_CHORDS
    stretch = np.where(few, number, stretch)
    return PathShape(corners, stretch, _groups(stretch, length, np.concatenate([[0.0], turn])))


def _groups(stretch: Index, length: Array, turn: Array) -> Index:
    """Cut stretches into parts; ``turn`` is the angle at the start of each chord, rad."""
    group = stretch.copy()
    bent = travelled = 0.0
    for j, (own, size, angle) in enumerate(
        zip(stretch.tolist(), length.tolist(), turn.tolist(), strict=True)
    ):
        bent, travelled = bent + angle, travelled + size
        if j == own or bent > GROUP_TURN or travelled > GROUP_LENGTH:
            group[j], bent, travelled = j, 0.0, size
        else:
            group[j] = group[j - 1]
    return group


MAX_TURN = 0.1
"""rad; a piece turns no more, so that its deviation is true to 0.1 %."""


def curve_boundaries(corners: Array, nodes: tuple[Array, ...], size: float) -> Array:
    """Piece boundaries along chords, m from the start of the first.

    They lie at node crossings and where an axis turns round, and between them in equal parts no
    longer than ``size`` that turn by no more than ``MAX_TURN``.

    Parameters
    ----------
    corners : ndarray, shape (k + 1, 3), m
    nodes : three ndarrays, m
    size : float
        m.
    """
    legs = Legs(corners)
    step, length, reach, unit = legs.step, legs.length, legs.reach, legs.unit
    cuts = [reach[[0, -1]]]
    for axis in range(3):
        moving = np.flatnonzero(np.abs(step[:, axis]) > 1e-9)
        place = (nodes[axis] - corners[moving, axis, None]) / step[moving, axis, None]
        chord, node = np.nonzero((place >= 0) & (place <= 1))
        cuts.append(reach[moving[chord]] + place[chord, node] * length[moving[chord]])
        sense = np.where(np.abs(unit[:, axis]) > MOVING, np.sign(unit[:, axis]), 0.0)
        cuts.append(reach[1:-1][np.diff(sense) != 0])
    marks = np.unique(np.concatenate(cuts))
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-6])]
    # the direction between the middles of chords, as if the curve turned evenly
    turned = np.concatenate([[0.0], np.cumsum(turns(unit))])
    angle = np.interp(marks, 0.5 * (reach[1:] + reach[:-1]), turned)
    counts = np.maximum(np.diff(marks) / size, np.diff(angle) / MAX_TURN)
    parts = [
        np.linspace(a, b, max(1, int(np.ceil(count))), endpoint=False)
        for (a, b), count in zip(pairwise(marks), counts, strict=True)
    ]
    return np.concatenate([*parts, [reach[-1]]])


def largest_sagitta(lines: Lines) -> float:
    """Largest distance of the arcs through the joints of curves from their chords, m."""
    inner = lines.shape.stretch[1:] == lines.shape.stretch[:-1]
    if not inner.any():
        return 0.0
    length = lines.length
    # turn over mean length is the curvature to first order of the turn
    bend = 2.0 * turns(lines.unit) / (length[1:] + length[:-1])
    return float((bend * np.maximum(length[1:], length[:-1]) ** 2)[inner].max()) / 8.0
