# SPDX-License-Identifier: Apache-2.0
"""Order of driving: which leg of the path each measured leg is, given where the tracker stands.

Dynamic programming (Viterbi) over the legs of the path. They advance one by one; anything else has
its price: legs passed over, measured legs that lie off the path, a jump to any other leg (parts
driven again, a restart from an earlier corner), a change of the sense in which the path is driven.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.model.frames import RigidTransform
from otf_core.model.path import Legs
from otf_core.tracking.track import Track

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


def follow(
    pose: RigidTransform, track: Track, corners: Array, tolerance: float, free: bool = True
) -> Match:
    """Assign measured legs to nominal legs in driving order by dynamic programming (Viterbi).

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine.
    track : Track
    corners : ndarray, shape (n, 3), m
        Nominal corner points.
    tolerance : float
        m.
    free : bool
        Allow jumps and the other sense; without, legs only advance, which takes half the time.
    """
    found = _follow(pose, track, corners, tolerance, free, np.inf)
    assert found is not None, 'given up for nothing'
    return found


def follow_within(
    most: float, pose: RigidTransform, track: Track, corners: Array, tolerance: float
) -> Match | None:
    """Follow as planned, see ``follow``; None once that is sure to cost more than ``most``."""
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
    left = np.minimum(EDGE_COST * (legs - 1 - number), cap)
    final = np.concatenate([[np.inf], ahead.score + left, back.score + left])
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
