# SPDX-License-Identifier: Apache-2.0
"""The path as it was driven: parts repeated, left out, or driven backward.

A run that drove the published path as planned keeps it, with whatever it left out. Any other run
gets a path of its own: the legs in the order and the sense in which they were driven, with
connecting moves between them that carry no samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.frames import RigidTransform
from otf_core.model.path import MIN_LEG, Legs
from otf_core.tracking.curves import Lines, PathShape, shape_of
from otf_core.tracking.driving_order import FORWARD, OFF_PATH, Match


@dataclass(frozen=True)
class Visit:
    """One passage of one leg.

    Attributes
    ----------
    leg : int
        Of the vertices of the published path.
    sense : int
    first, last : int
        Measured legs, first and last.
    """

    leg: int
    sense: int
    first: int
    last: int


@dataclass(frozen=True)
class Driven:
    """The driven path.

    Attributes
    ----------
    shape : PathShape
    chord : ndarray of int64, shape (k,)
        Chord on which each measured leg begins, ``OFF_PATH`` for none.
    last : ndarray of int64, shape (k,)
        The last chord that it may reach.
    published : ndarray of int64, shape (m,)
        Chord of the published path of every chord, ``OFF_PATH`` for a connecting move.
    """

    shape: PathShape
    chord: Index
    last: Index
    published: Index


def visits(match: Match, vertices: Array, slack: float) -> list[Visit]:
    """Passages of legs in order of time.

    Parameters
    ----------
    match : Match
    vertices : ndarray, shape (v, 3), m
    slack : float
        m; a leg that begins anew by more is driven anew.
    """
    found: list[Visit] = []
    unit = Legs(vertices).unit
    starts, ends = match.pose.apply(match.track.starts), match.pose.apply(match.track.ends)
    reached = 0.0
    for k in np.flatnonzero(match.leg != OFF_PATH).tolist():
        leg, sense = int(match.leg[k]), int(match.sense[k])
        begin = sense * float((starts[k] - vertices[leg]) @ unit[leg])
        end = sense * float((ends[k] - vertices[leg]) @ unit[leg])
        same = bool(found) and (leg, sense) == (found[-1].leg, found[-1].sense)
        if same and begin > reached - slack:
            found[-1] = Visit(leg, sense, found[-1].first, k)
            reached = max(reached, end)
        else:
            found.append(Visit(leg, sense, k, k))
            reached = end
    return found


def as_planned(found: list[Visit]) -> bool:
    """Tell whether legs were only driven forward and in order."""
    return all(v.sense == FORWARD for v in found) and all(
        a.leg < b.leg for a, b in pairwise(found)
    )


class _Route:
    """Corner points of the driven path as they come."""

    def __init__(self) -> None:
        self.corners: list[Array] = []
        self.published: list[int] = []

    def leg(self, path: Array, number: Index) -> tuple[int, int]:
        """Drive corners ``number`` of the published path; the first and the last chord."""
        self.link(path[number[:1]])
        begin = len(self.published)
        self.corners.extend(path[number[1:]])
        self.published.extend(np.minimum(number[:-1], number[1:]).tolist())
        return begin, len(self.published) - 1

    def link(self, points: Array) -> None:
        """Move to points by lines that carry no samples."""
        for point in points:
            if self.corners and np.linalg.norm(point - self.corners[-1]) <= MIN_LEG:
                continue
            if self.corners:
                self.published.append(OFF_PATH)
            self.corners.append(point)


def _numbers(vertex: Index, leg: int, sense: int) -> Index:
    """Corners of the published path along one leg, as driven."""
    number = np.arange(vertex[leg], vertex[leg + 1] + 1)
    return number if sense == FORWARD else number[::-1]


def _passed(before: Visit, after: Visit, match: Match, vertices: Array, slack: float) -> range:
    """Legs between two visits that were driven without being seen: a gap, or hardly any length."""
    step = after.sense
    between = range(before.leg + step, after.leg, step)
    if before.sense != after.sense or (after.leg - before.leg) * step <= 0:
        return range(0)
    low, high = sorted((before.leg + (step > 0), after.leg + (step < 0)))
    skipped = Legs(vertices[low : high + 1]).length.sum()
    seen = match.track.joined[before.last + 1 : after.first + 1]
    return range(0) if seen.all() and skipped > slack else between


def _link(before: Visit, after: Visit, match: Match, ends: Array, slack: float) -> Array:
    """Corner points of the measured track between two visits, those near their ends left out."""
    between = slice(before.last + 1, max(before.last + 1, after.first - 1))
    points = match.pose.apply(match.track.ends[between])
    off = np.linalg.norm(points[:, None] - ends[None], axis=2).min(axis=1) > slack
    return np.asarray(points[off])


def driven_path(match: Match, shape: PathShape, vertex: Index, slack: float) -> Driven:
    """Path as driven, and the chords of every measured leg.

    Parameters
    ----------
    match : Match
        Legs are those between successive vertices.
    shape : PathShape
        Of the published path.
    vertex : ndarray of int64, shape (v,)
        Corner points by which it was matched.
    slack : float
        m.
    """
    path, vertices = shape.corners, shape.corners[vertex]
    found = visits(match, vertices, slack)
    chord = np.full(len(match.leg), OFF_PATH)
    last = chord.copy()
    on = match.leg != OFF_PATH
    if as_planned(found):
        chord[on], last[on] = vertex[match.leg[on]], vertex[match.leg[on] + 1] - 1
        return Driven(shape, chord, last, np.arange(len(shape.stretch)))
    route, low, high = _Route(), path.min(axis=0), path.max(axis=0)
    for k, visit in enumerate(found):
        number = _numbers(vertex, visit.leg, visit.sense)
        if k:
            before = found[k - 1]
            passed = _passed(before, visit, match, vertices, 2 * slack)
            for leg in passed:
                route.leg(path, _numbers(vertex, leg, visit.sense))
            if not len(passed):
                ends = np.stack([route.corners[-1], path[number[0]]])
                route.link(np.clip(_link(before, visit, match, ends, slack), low, high))
        begin, end = route.leg(path, number)
        own = np.arange(visit.first, visit.last + 1)
        own = own[on[own]]
        chord[own], last[own] = begin, end
    return Driven(
        shape_of(np.array(route.corners)), chord, last, np.array(route.published, dtype=np.int64)
    )


def sample_chords(
    match: Match, driven: Driven, T_machine_tracker: RigidTransform, xyz: Array,
    exclusion: float, slack: float,
) -> NDArray[np.int32]:  # fmt: skip
    """Chord of every sample, ``OFF_PATH`` where there is none.

    Where the machine came to a leg from elsewhere, or left it, between its ends, ``exclusion`` is
    left out there as it is at corners.

    Parameters
    ----------
    match : Match
    driven : Driven
    T_machine_tracker : RigidTransform
    xyz : ndarray, shape (n, 3), m
        Samples in the tracker frame.
    exclusion, slack : float
        m.
    """
    track, lines = match.track, Lines.of(driven.shape)
    chord = np.full(len(xyz), OFF_PATH, dtype=np.int32)
    for k in np.flatnonzero(driven.chord != OFF_PATH).tolist():
        first, last = int(driven.chord[k]), int(driven.last[k])
        part = slice(int(track.hops[track.start[k]]), int(track.hops[track.stop[k]]) + 1)
        chord[part] = first
        if last > first:
            way = driven.shape.corners[last + 1] - driven.shape.corners[first]
            points = T_machine_tracker.apply(xyz[part])
            share = (points - driven.shape.corners[first]) @ way / float(way @ way)
            chord[part] += np.clip(share * (last + 1 - first), 0, last - first).astype(np.int32)
    if not lines.shape.straight:
        on = np.flatnonzero(chord != OFF_PATH)
        near = chord[on].astype(np.int64)
        chord[on] = lines.settled(T_machine_tracker.apply(xyz[on]), near)
    for at, beyond in _entries(match, driven, lines, slack):
        points = T_machine_tracker.apply(xyz[beyond[0] : beyond[1] + 1])
        near = np.flatnonzero(np.linalg.norm(points - at, axis=1) < exclusion)
        chord[beyond[0] + near] = OFF_PATH
    return chord


def _entries(
    match: Match, driven: Driven, lines: Lines, slack: float
) -> Iterator[tuple[Array, tuple[int, int]]]:
    """Places within legs where the track came from elsewhere or left, with their samples."""
    track = match.track
    starts, ends = match.pose.apply(track.starts), match.pose.apply(track.ends)
    for k in np.flatnonzero(driven.chord != OFF_PATH).tolist():
        span = (int(track.hops[track.start[k]]), int(track.hops[track.stop[k]]))
        for other, joined, at, corner in (
            (k - 1, k, starts[k], int(driven.chord[k])),
            (k + 1, k + 1, ends[k], int(driven.last[k]) + 1),
        ):
            if not 0 <= other < len(driven.chord) or not track.joined[joined]:
                continue
            elsewhere = (
                driven.chord[other] == OFF_PATH
                or abs(int(driven.chord[other]) - int(driven.chord[k]))
                > int(driven.last[k] - driven.chord[k]) + 1
            )
            if elsewhere and np.linalg.norm(at - lines.shape.corners[corner]) > slack:
                yield at, span
