# SPDX-License-Identifier: Apache-2.0
"""Order in which the legs of the path were driven, given the tracker pose; the path as driven.

Dynamic programming (Viterbi) over the legs of the path. They advance one by one; anything else has
its price: legs passed over, measured legs that lie off the path, a jump to any other leg (parts
driven again, a restart from an earlier corner), a change of the sense in which the path is driven.

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
from otf_core.tracking.curves import NO_PART, Lines, PathShape, shape_of
from otf_core.tracking.measured_track import Track

Bool = NDArray[np.bool_]

OFF_PATH = -1
FORWARD, BACKWARD = 1, -1
OFF_COST = 6.0
SKIP_COST, EDGE_COST = 1.0, 0.3
JUMP_COST = 13.0
"""More than two measured legs off the path: a leg met by chance is not worth going there and
back."""
BLOCK = 20_000
"""Pairs of measured and nominal legs that are compared at a time: most poses are soon given up."""


@dataclass(frozen=True)
class Match:
    """Assignment of measured legs to nominal legs.

    Attributes
    ----------
    pose : RigidTransform
        Tracker to machine.
    leg : ndarray of int64, shape (k,)
        Nominal leg of every measured leg, ``OFF_PATH`` if it belongs to none.
    cost : float
        Lower is better.
    track : Track
        The k measured legs.
    sense : ndarray of int64, shape (k,)
        ``FORWARD`` or ``BACKWARD``, the way in which the leg was driven.
    free : bool
        True if jumps and the other sense were allowed.
    """

    pose: RigidTransform
    leg: Index
    cost: float
    track: Track
    sense: Index
    free: bool

    @property
    def explained(self) -> float:
        """Share of the measured length that lies on the path."""
        lengths = self.track.lengths
        return float(lengths[self.leg != OFF_PATH].sum() / lengths.sum())


@dataclass(frozen=True)
class _Lines:
    """Lines of the path, each once however many legs drive it, ready to compare points with.

    ``of`` (legs,) is the line of every leg.
    """

    corners: Array
    length: Array
    unit: Array
    origin: Array
    of: Index

    @classmethod
    def of_path(cls, corners: Array) -> _Lines:
        legs, ends = Legs(corners), np.hstack([corners[:-1], corners[1:]])
        _, first, of = np.unique(ends, axis=0, return_index=True, return_inverse=True)
        return cls(
            corners[:-1][first],
            legs.length[first],
            legs.unit[first],
            corners.mean(axis=0),
            of.reshape(-1),
        )

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Squared distance of points from every line and position along it, both (k, n)."""
        # small numbers: their squares are subtracted
        points, corners = points - self.origin, self.corners - self.origin
        along = points @ self.unit.T - np.einsum('ij,ij->i', corners, self.unit)
        square = np.einsum('ij,ij->i', points, points)[:, None] - 2.0 * points @ corners.T
        square += np.einsum('ij,ij->i', corners, corners)
        beyond = along - np.clip(along, 0.0, self.length)
        square += beyond**2 - along**2
        return np.maximum(square, 0.0, out=square), along


@dataclass(frozen=True)
class _Emission:
    """Legs that a measured leg may be driving in one sense, ascending, and what each costs.

    ``anew`` is the cost of going on with the leg that the one before was on: it must begin where
    that one ended, or the leg is driven anew.
    """

    leg: Index
    cost: Array
    anew: Array

    def reversed(self, legs: int) -> _Emission:
        """As counted from the end of the path."""
        return _Emission(legs - 1 - self.leg[::-1], self.cost[::-1], self.anew[::-1])


def _possible(possible: Bool, cost: Array, anew: Array, of: Index) -> list[_Emission]:
    """Emission of some measured legs (rows), from what holds for every line (columns)."""
    row, leg = np.nonzero(possible[:, of])
    cost_of, anew_of = cost[row, of[leg]], anew[row, of[leg]]
    ends = np.searchsorted(row, np.arange(len(cost) + 1)).tolist()
    parts = (slice(low, high) for low, high in pairwise(ends))
    return [_Emission(leg[own], cost_of[own], anew_of[own]) for own in parts]


def _emissions(
    pose: RigidTransform, track: Track, corners: Array, tolerance: float, free: bool
) -> Iterator[tuple[_Emission, _Emission | None]]:
    """Emission of every measured leg, forward and, if the other sense is allowed, backward."""
    lines, starts, ends = _Lines.of_path(corners), pose.apply(track.starts), pose.apply(track.ends)
    least = np.maximum(0.9 * track.lengths[:, None] - 4 * tolerance, 0.0)
    size, slack = max(1, BLOCK // len(lines.of)), 4 * tolerance
    ended = None
    for part in (slice(low, low + size) for low in range(0, len(starts), size)):
        square, begin = lines.nearest(starts[part])
        square_end, end = lines.nearest(ends[part])
        cost = (square + square_end) / (2 * tolerance**2)
        near = np.maximum(square, square_end) < (4 * tolerance) ** 2
        advance = end - begin
        before = np.concatenate([begin[:1] if ended is None else ended, end[:-1]])
        ended = end[-1:]
        forward = _possible(
            near & (advance > least[part]),
            cost,
            np.where(begin < before - slack, OFF_COST, 0.0),
            lines.of,
        )
        if not free:
            yield from ((emission, None) for emission in forward)
            continue
        backward = _possible(
            near & (-advance > least[part]),
            cost,
            np.where(begin > before + slack, OFF_COST, 0.0),
            lines.of,
        )
        yield from zip(forward, backward, strict=True)


class _Chain:
    """Scores of the legs in one sense, and how those that were reached were reached.

    Legs count in the order in which this sense drives them. All that a measured leg cannot be on
    stay as they are but for the price of being off the path, so that only the few others are
    looked at, and kept.
    """

    def __init__(self, legs: int, offset: int) -> None:
        self.score = np.full(legs, np.inf)
        self.reached: list[tuple[Index, Index]] = []
        """For every measured leg the legs that it may be on, ascending, and the states before."""
        self._skipped = SKIP_COST * np.arange(legs)
        self._offset = offset  # of the first leg among all states

    def step(self, emission: _Emission, off: float, entry: Array, jump: float, at: int) -> None:
        """Take the next measured leg: advance, go on, enter from before the path, or jump."""
        leg, before = emission.leg, np.maximum(emission.leg - 1, 0)
        ahead = self.score - self._skipped
        running = np.minimum.accumulate(ahead)
        options = np.empty((4, len(leg)))
        options[0] = np.where(leg > 0, running[before] + self._skipped[before], np.inf)
        options[1] = self.score[leg] + emission.anew
        options[2], options[3] = entry[leg], jump
        pick = options.argmin(axis=0)
        reach = options.min(axis=0) + emission.cost
        self.score += off
        better = reach < self.score[leg]
        leg, before, pick = leg[better], before[better], pick[better]
        lowest = np.flatnonzero(ahead <= running)
        origin = lowest[np.searchsorted(lowest, before, side='right') - 1]
        source = np.choose(pick, [origin + self._offset, leg + self._offset, 0, at])
        self.score[leg] = reach[better]
        self.reached.append((leg, source))


def assign_legs(
    pose: RigidTransform, track: Track, corners: Array, tolerance: float, free: bool = True
) -> Match:
    """Assign measured legs to nominal legs in driving order by dynamic programming (Viterbi).

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine.
    corners : ndarray, shape (n, 3), m
        Nominal corner points.
    tolerance : float
        m.
    free : bool
        Allow jumps and the other sense; without, legs only advance, which takes half the time.
    """
    match = _follow(pose, track, corners, tolerance, free, np.inf)
    assert match is not None, 'given up for nothing'
    return match


def assign_legs_within(
    most: float, pose: RigidTransform, track: Track, corners: Array, tolerance: float
) -> Match | None:
    """Assign legs as planned; None once that is sure to cost more than ``most``."""
    return _follow(pose, track, corners, tolerance, False, most)


def _follow(
    pose: RigidTransform,
    track: Track,
    corners: Array,
    tolerance: float,
    free: bool,
    most: float,
) -> Match | None:
    legs = len(corners) - 1
    number = np.arange(legs)
    # states: 0 before the path, then the legs driven forward, then those driven backward
    ahead, back = _Chain(legs, 1), _Chain(legs, legs + 1)
    cap = JUMP_COST if free else np.inf
    entry = np.minimum(EDGE_COST * number, cap)
    off_cost = OFF_COST * np.minimum(1.0, track.lengths / (20 * tolerance))
    start = 0.0
    emissions = _emissions(pose, track, corners, tolerance, free)
    for off, (forward, backward) in zip(off_cost.tolist(), emissions, strict=True):
        jump, at = np.inf, 0
        if free:
            best = (start, ahead.score.min(), back.score.min())
            choice = int(np.argmin(best))
            at = (0, 1 + int(ahead.score.argmin()), 1 + legs + int(back.score.argmin()))[choice]
            jump = float(best[choice]) + JUMP_COST
        elif min(start, ahead.score.min()) > most:
            return None  # costs only grow
        ahead.step(forward, off, start + entry, jump, at)
        if backward is not None:
            back.step(backward.reversed(legs), off, start + JUMP_COST + entry, jump, at)
        start += off
    to_the_end = np.minimum(EDGE_COST * (legs - 1 - number), cap)
    final = np.concatenate([[np.inf], ahead.score + to_the_end, back.score + to_the_end])
    state = int(np.argmin(final))
    cost = float(final[state])
    leg, sense = _traced(state, ahead, back)
    return Match(pose, leg, cost, track, sense, free)


def _traced(state: int, ahead: _Chain, back: _Chain) -> tuple[Index, Index]:
    """Leg and sense of every measured leg, from the last state back to the first."""
    count, legs = len(ahead.reached), len(ahead.score)
    leg, sense = np.full(count, OFF_PATH, dtype=np.int64), np.ones(count, dtype=np.int64)
    for k in range(count - 1, -1, -1):
        if not state:
            break
        chain, j = (ahead, state - 1) if state <= legs else (back, state - 1 - legs)
        reached, source = chain.reached[k]
        at = int(np.searchsorted(reached, j))
        if at < len(reached) and reached[at] == j:
            leg[k] = j if chain is ahead else legs - 1 - j
            sense[k] = FORWARD if chain is ahead else BACKWARD
            state = int(source[at])
    return leg, sense


@dataclass(frozen=True)
class Visit:
    """One passage of one leg.

    Attributes
    ----------
    leg : int
        Of the vertices of the published path.
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
    vertices : ndarray, shape (v, 3), m
    slack : float
        m; a leg that begins anew by more is driven anew.
    """
    visited: list[Visit] = []
    unit = Legs(vertices).unit
    starts, ends = match.pose.apply(match.track.starts), match.pose.apply(match.track.ends)
    reached = 0.0
    for k in np.flatnonzero(match.leg != OFF_PATH).tolist():
        leg, sense = int(match.leg[k]), int(match.sense[k])
        begin = sense * float((starts[k] - vertices[leg]) @ unit[leg])
        end = sense * float((ends[k] - vertices[leg]) @ unit[leg])
        same = bool(visited) and (leg, sense) == (visited[-1].leg, visited[-1].sense)
        if same and begin > reached - slack:
            visited[-1] = Visit(leg, sense, visited[-1].first, k)
            reached = max(reached, end)
        else:
            visited.append(Visit(leg, sense, k, k))
            reached = end
    return visited


def is_as_planned(driven: list[Visit]) -> bool:
    """Return whether legs were only driven forward and in order."""
    return all(v.sense == FORWARD for v in driven) and all(
        a.leg < b.leg for a, b in pairwise(driven)
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
    driven = visits(match, vertices, slack)
    chord = np.full(len(match.leg), OFF_PATH)
    last = chord.copy()
    on = match.leg != OFF_PATH
    if is_as_planned(driven):
        chord[on], last[on] = vertex[match.leg[on]], vertex[match.leg[on] + 1] - 1
        return Driven(shape, chord, last, np.arange(len(shape.stretch)))
    route, low, high = _Route(), path.min(axis=0), path.max(axis=0)
    for k, visit in enumerate(driven):
        number = _numbers(vertex, visit.leg, visit.sense)
        if k:
            before = driven[k - 1]
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


@dataclass(frozen=True)
class Passage:
    """What was driven of a part of the path without leaving it.

    Attributes
    ----------
    part : int
    places : ndarray, shape (n,)
        Of the part, in legs, in the order in which they were driven: its corners, and both ends.
    first, last : int
        First sample, and one past the last.
    knots : ndarray, shape (k, 2)
        Samples and the places, counted along ``places``, where they are about.
    """

    part: int
    places: Array
    first: int
    last: int
    knots: Array


def passages(match: Match, shape: PathShape, vertex: Index, slack: float) -> list[Passage]:
    """Parts of a path as driven, in order of time; see ``driven_path``.

    A new one begins where a leg was not driven on from the end of the one before.
    """
    place = shape.places
    assert shape.part is not None
    vertices, track = shape.corners[vertex], match.track
    starts, ends = match.pose.apply(track.starts), match.pose.apply(track.ends)
    legs, before = Legs(vertices), None
    found: list[_Gathered] = []
    for visit in visits(match, vertices, slack):
        number = int(shape.part[vertex[visit.leg]])
        if number == NO_PART:
            continue
        passed: list[int] = []
        if before is not None and found[-1].part == number:
            passed = list(_passed(before, visit, match, vertices, 2 * slack))
        ways = [_ends_of(place[vertex], leg, visit.sense) for leg in (*passed, visit.leg)]
        corner = legs.corners[visit.leg + (visit.sense == BACKWARD)]
        joined = (
            before is not None
            and found[-1].part == number
            and found[-1].places[-1] == ways[0][0]
            and (passed or np.linalg.norm(starts[visit.first] - corner) < 2 * slack)
        )
        if not joined:
            found.append(_Gathered(number, [ways[0][0]], [], []))
        own = found[-1]
        own.places.extend(end for _, end in ways)
        for k in range(visit.first, visit.last + 1):
            if match.leg[k] != visit.leg:
                continue
            own.measured.append(k)
            for hop, point in ((track.start[k], starts[k]), (track.stop[k], ends[k])):
                share = (point - legs.corners[visit.leg]) @ legs.unit[visit.leg]
                share = np.clip(share / max(legs.length[visit.leg], 1e-12), 0.0, 1.0)
                share = share if visit.sense == FORWARD else 1.0 - share
                own.knots.append((int(track.hops[hop]), len(own.places) - 2 + float(share)))
        before = visit
    return [one.thinned(track) for one in found]


def _ends_of(place: Array, leg: int, sense: int) -> tuple[float, float]:
    """Places where a leg begins and ends as driven."""
    begin, end = float(place[leg]), float(place[leg + 1])
    return (begin, end) if sense == FORWARD else (end, begin)


@dataclass(frozen=True)
class _Gathered:
    """A passage as its legs come; see ``Passage``, places still at all vertices."""

    part: int
    places: list[float]
    measured: list[int]
    knots: list[tuple[int, float]]

    def thinned(self, track: Track) -> Passage:
        """Leave out places on the way from corner to corner."""
        at, knots = np.array(self.places), np.array(self.knots)
        turned = np.diff(np.sign(np.diff(at))) != 0.0
        keep = np.concatenate([[True], (at[1:-1] % 1.0 == 0.0) | turned, [True]])
        kept = np.flatnonzero(keep)
        # between two that are kept the place is linear in legs of the part
        number = np.zeros(len(at))
        for low, (a, b) in enumerate(pairwise(kept.tolist())):
            number[a : b + 1] = low + (at[a : b + 1] - at[a]) / ((at[b] - at[a]) or 1.0)
        knots[:, 1] = np.interp(knots[:, 1], np.arange(len(at)), number)
        first = int(track.hops[track.start[self.measured[0]]])
        last = int(track.hops[track.stop[self.measured[-1]]]) + 1
        return Passage(self.part, at[keep], first, last, knots)


def sample_chords(
    match: Match, driven: Driven, T_machine_tracker: RigidTransform, xyz: Array,
    exclusion: float, slack: float,
) -> NDArray[np.int32]:  # fmt: skip
    """Chord of every sample, ``OFF_PATH`` where there is none.

    Where the machine came to a leg from elsewhere, or left it, between its ends, ``exclusion`` is
    left out there as it is at corners.

    Parameters
    ----------
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
