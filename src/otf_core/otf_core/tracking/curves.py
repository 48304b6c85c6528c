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

With linear axes the path is the chords as they are published. An arc of curvature k leaves a chord
of length L by at most the sagitta k L^2 / 8: 1 um for chords of 1 mm and a radius of 125 mm. Where
a rotary axis turns, chords stand for the curve p(q), q linear from corner to corner: the place on
a chord gives q, and q the nominal point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.axis_path import (
    MIN_MOTION,
    along_legs,
    driven_through,
    position_at,
    travel_of_legs,
)
from otf_core.model.chain import Sight
from otf_core.model.machine import FULL_TURN, Machine
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
NO_PART = -1
STANDS = 1e-9
"""m; a chord counts as so long at least, where axes move and the reflector does not."""
HALF_CHORD, LONGEST_STEP = 2e-3, 5e-3
"""m; half of the chord that gives the direction of travel, and longest step along a curve."""
ROUNDS = 12
SETTLED = 1e-7
"""m; change of places on curves that is small enough."""


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
    q : ndarray, shape (m + 1, k), m and rad, optional
        Axis positions at the corners; the corners themselves without it.
    part : ndarray of int64, shape (m,), optional
        Part of the run of every chord, ``NO_PART`` for moves between parts; one without it.
    place : ndarray, shape (m + 1,), optional
        Legs done in its part at every corner, see ``axis_path.along_legs``.
    sights : tuple of Sight
        How the tracker sees the reflector of every part, of a machine with rotary axes.
    """

    corners: Array
    stretch: Index
    group: Index
    q: Array | None = None
    part: Index | None = None
    place: Array | None = None
    sights: tuple[Sight, ...] = ()

    @property
    def positions(self) -> Array:
        """Axis positions at the corners, shape (m + 1, k), m and rad."""
        return self.corners if self.q is None else self.q

    @property
    def places(self) -> Array:
        """Legs done in its part at every corner, shape (m + 1,)."""
        return np.arange(float(len(self.corners))) if self.place is None else self.place

    @property
    def part_of_corners(self) -> Index:
        """Part of every corner, shape (m + 1,)."""
        if self.part is None:
            return np.zeros(len(self.corners), dtype=np.int64)
        part = np.append(self.part, self.part[-1])
        ends = np.flatnonzero(part == NO_PART)
        part[ends] = part[ends - 1]
        return part

    @cached_property
    def travel(self) -> Array:
        """Travel of all axes over every chord, shape (m,), m; see ``axis_path.travel_of_legs``."""
        if not self.sights:
            return Legs(self.corners).length
        return travel_of_legs(self.sights[0].machine, self.positions)

    @cached_property
    def periods(self) -> tuple[float, ...]:
        """After how much travel the tables of every axis repeat, rad; 0 for those that do not."""
        if not self.sights:
            return tuple(0.0 for _ in self.positions[0])
        machine = self.sights[0].machine
        endless = [machine.axes[a].endless for a in machine.axis_names]
        return tuple(FULL_TURN if one else 0.0 for one in endless)

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
        Travel from the start of the stretch to the start of the chord; path length where no
        rotary axis turns.
    total : ndarray, shape (m,), m
        Travel of the stretch.
    """

    shape: PathShape
    start: Array
    total: Array

    @classmethod
    def of(cls, shape: PathShape) -> Lines:
        """Measure the chords of a shape."""
        length, curved = shape.travel, shape.curved
        reach = np.append(0.0, np.cumsum(length))
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

    @cached_property
    def run(self) -> Array:
        """Path length at every corner, shape (m + 1,), m; grows a little where nothing moves."""
        return np.append(0.0, np.maximum(self.length, STANDS).cumsum())

    def chord_at(self, run: Array) -> tuple[Index, Array]:
        """Chords (n,) at path lengths, and how far along them, m."""
        last = len(self.length) - 1
        chord = np.clip(np.searchsorted(self.run, run, side='right') - 1, 0, last)
        return chord, run - self.run[chord]

    @cached_property
    def travel_per_length(self) -> Array:
        """Travel of the axes per length of every chord, shape (m,); 1 without rotary axes."""
        return np.asarray(self.shape.travel / np.maximum(self.length, STANDS))

    def interpolated(self, values: Array, chord: Index, along: Array) -> Array:
        """Values (m + 1, k) of the corners at places on chords, shape (n, k)."""
        share = (along / np.maximum(self.length[chord], STANDS))[:, None]
        return np.asarray((1.0 - share) * values[chord] + share * values[chord + 1])

    def closest(
        self, points: Array, chord: Index, along: Array
    ) -> tuple[Index, Array, Array, Array]:
        """Closest places of curves to points, from near ones.

        The direction of travel is that of a chord of some length about a place: chains of corners
        that stand for a smooth curve have ripples, of which noise makes the closest point
        ambiguous.

        Parameters
        ----------
        points : ndarray, shape (n, 3), m
        chord : ndarray of int64, shape (n,)
        along : ndarray, shape (n,), m
            From the start of the chord.

        Returns
        -------
        chord, along
            The same of the closest places.
        tangent : ndarray, shape (n, 3)
            Unit direction of travel.
        share : ndarray, shape (n,)
            Length of the chord about the place over that of its arc.
        """
        reach, stretch = self.run, self.shape.stretch
        low = reach[stretch[chord]]
        high = reach[np.searchsorted(stretch, stretch[chord], side='right')]
        at = np.clip(reach[chord] + along, low, high)
        moving = np.arange(len(at))
        for _ in range(ROUNDS):
            tangent, _ = self._tangents(reach, at[moving], low[moving], high[moving])
            off = points[moving] - _at(self.corners, reach, at[moving])
            step = np.einsum('ni,ni->n', off, tangent)
            own = at[moving] + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
            at[moving] = np.clip(own, low[moving], high[moving])
            moving = moving[np.abs(step) >= SETTLED]
            if not len(moving):
                break
        tangent, share = self._tangents(reach, at, low, high)
        return *self.chord_at(at), tangent, share

    def _tangents(self, reach: Array, at: Array, low: Array, high: Array) -> tuple[Array, Array]:
        """Directions of symmetric chords about places on stretches, and how straight they are."""
        half = np.maximum(np.minimum(HALF_CHORD, np.minimum(at - low, high - at)), 1e-5)
        step = _at(self.corners, reach, at + half) - _at(self.corners, reach, at - half)
        size = np.linalg.norm(step, axis=1)
        return step / np.maximum(size, 1e-12)[:, None], size / (2.0 * half)

    def _square(self, points: Array, chord: Index) -> Array:
        """Squared distance of points from their chords, ends counted."""
        along = np.clip(self.along(points, chord), 0.0, self.length[chord])
        off = points - self.at(along, chord)
        return np.asarray(np.einsum('ij,ij->i', off, off))


def _at(corners: Array, reach: Array, at: Array) -> Array:
    """Points of a polyline at lengths (n,), shape (n, 3), m."""
    return np.stack([np.interp(at, reach, own) for own in corners.T], axis=1)


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


ROUNDING = 0.01
"""Share of a part by which parts may be longer: planned paths are whole numbers of parts, which
rounding would cut now so, now so."""


def _groups(stretch: Index, length: Array, turn: Array) -> Index:
    """Cut stretches into equal parts; ``turn`` is the angle at the start of each chord, rad."""
    begins = stretch == np.arange(len(stretch))
    share = np.maximum(length / GROUP_LENGTH, np.where(begins, 0.0, turn) / GROUP_TURN)
    before = np.cumsum(share) - share
    whole = np.maximum(np.bincount(stretch, share)[stretch], 1e-12)
    parts = np.maximum(np.ceil(whole - ROUNDING), 1.0)
    number = np.floor((before - before[stretch]) / whole * parts + ROUNDING)
    first = begins | np.append(True, np.diff(number) != 0.0)
    return np.asarray(np.maximum.accumulate(np.where(first, np.arange(len(stretch)), 0)))


MAX_TURN = 0.1
"""rad; a piece turns no more, so that its deviation is true to 0.1 %."""
MAX_PARTS_OF_LEG = 200
"""Equal parts of one leg: long legs are those of large machines, whose functions are as long."""


def piece_boundaries(
    q: Array,
    nodes: Sequence[Array],
    size: float,
    travel: Array | None = None,
    unit: Array | None = None,
    periods: Sequence[float] = (),
) -> Array:
    """Piece boundaries along a line or the chords of a curve, m of travel from its start.

    They lie at node crossings and where an axis turns round, and between them in equal parts no
    longer than ``size``, on lines of more than ``MAX_PARTS_OF_LEG`` of them longer; on curves such
    that they turn by no more than ``MAX_TURN``.

    Parameters
    ----------
    q : ndarray, shape (c + 1, k), m and rad
        Axis positions at the ends of the chords.
    nodes : sequence of k ndarrays, m and rad
        Of the tables of the axes.
    size : float
        m.
    travel : ndarray, shape (c,), m, optional
        Of every chord; its length without it.
    unit : ndarray, shape (c, 3), optional
        Directions of the chords; those in the axes without it.
    periods : sequence of k floats, rad, optional
        See ``PathShape.periods``.
    """
    step = np.diff(q, axis=0)
    length = np.linalg.norm(step, axis=1) if travel is None else travel
    reach = np.append(0.0, np.cumsum(length))
    cuts = [reach[[0, -1]]]
    for axis, own in enumerate(nodes):
        moving = np.flatnonzero(np.abs(step[:, axis]) > 1e-9)
        if not len(moving):
            continue
        if periods and periods[axis]:
            turn = np.floor((q[:, axis] - own[0]) / periods[axis])
            turned = np.arange(turn.min(), turn.max() + 1.0) * periods[axis]
            own = (own + turned[:, None]).ravel()
        place = (own - q[moving, axis, None]) / step[moving, axis, None]
        chord, node = np.nonzero((place >= 0) & (place <= 1))
        cuts.append(reach[moving[chord]] + place[chord, node] * length[moving[chord]])
        ahead = step[:, axis] / np.maximum(length, 1e-12)
        sense = np.where(np.abs(ahead) > MOVING, np.sign(ahead), 0.0)
        cuts.append(reach[1:-1][np.diff(sense) != 0])
    marks = np.unique(np.concatenate(cuts))
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-6])]
    span = np.diff(marks)
    if len(length) == 1:
        counts = span / max(size, reach[-1] / MAX_PARTS_OF_LEG)
    else:
        # the direction between the middles of chords, as if the curve turned evenly
        turned = np.append(0.0, np.cumsum(turns(step / length[:, None] if unit is None else unit)))
        angle = np.interp(marks, 0.5 * (reach[1:] + reach[:-1]), turned)
        counts = np.maximum(span / size, np.diff(angle) / MAX_TURN)
    parts = np.maximum(np.ceil(counts - ROUNDING), 1.0).astype(np.int64)
    place = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = place * np.repeat(span / parts, parts) + np.repeat(marks[:-1], parts)
    return np.append(inner, reach[-1])


FINE_STEP, FINE_TURN = 2e-3, 0.01
"""m and rad between the corners of chords that stand for a curve."""


def shape_of_parts(
    sights: Sequence[Sight],
    positions: Sequence[Array],
    *,
    corners_alone: bool = False,
    grouped: bool = True,
) -> PathShape:
    """Tracks of the reflectors of all parts of a run: lines, and chords where an axis turns.

    Parameters
    ----------
    sights : sequence of Sight
    positions : sequence of ndarray, shape (n, k), m and rad
        Corners of every part.
    corners_alone : bool
        One line from corner to corner, whatever turns: for stops there.
    grouped : bool
        Cut curves into groups; without, each is one.
    """
    machine, corners, qs, part, first, places = sights[0].machine, [], [], [], [], []
    for number, (sight, own) in enumerate(zip(sights, positions, strict=True)):
        place = (
            np.arange(len(own), dtype=float) if corners_alone else places_of_chords(machine, own)
        )
        q = position_at(own, place)
        corners.append(sight.nominal(q))
        qs.append(q)
        places.append(place)
        begins = np.append(True, ~driven_through(machine, own))[place[:-1].astype(np.int64)]
        first.append(np.append(begins & (place[:-1] % 1.0 == 0.0), True))
        part.append(np.append(np.full(len(place) - 1, number), NO_PART))
    shape = straight_shape(np.concatenate(corners))
    of_chord = np.concatenate(part)[:-1]
    shape = replace(
        shape,
        q=np.concatenate(qs),
        part=of_chord,
        place=np.concatenate(places),
        sights=tuple(sights),
    )
    starts = np.concatenate(first)[:-1]
    starts[1:] |= np.diff(of_chord) != 0  # after a move between parts
    stretch = np.flatnonzero(starts)[np.cumsum(starts) - 1]
    if not grouped:
        return replace(shape, stretch=stretch, group=stretch)
    turn = np.append(0.0, turns(Legs(shape.corners).unit))
    return replace(shape, stretch=stretch, group=_groups(stretch, shape.travel, turn))


def lines_of_part(sight: Sight, positions: Array) -> Lines:
    """Track of the reflector of one part."""
    return Lines.of(shape_of_parts([sight], [positions], grouped=False))


def places_of_chords(machine: Machine, positions: Array) -> Array:
    """Places on the legs of a part, see ``axis_path.along_legs``: chords where an axis turns."""
    rotary = [machine.column(a) for a in machine.rotary_names]
    turning = np.abs(np.diff(positions[:, rotary], axis=0)).max(axis=1, initial=0.0) > MIN_MOTION
    return along_legs(
        machine.axis_names, positions, np.where(turning, FINE_STEP, np.inf), FINE_TURN
    )


def largest_sagitta(lines: Lines) -> float:
    """Largest distance of the arcs through the joints of curves from their chords, m."""
    inner = lines.shape.stretch[1:] == lines.shape.stretch[:-1]
    if not inner.any():
        return 0.0
    length = lines.length
    # turn over mean length is the curvature to first order of the turn
    bend = 2.0 * turns(lines.unit) / (length[1:] + length[:-1])
    return float((bend * np.maximum(length[1:], length[:-1]) ** 2)[inner].max()) / 8.0
