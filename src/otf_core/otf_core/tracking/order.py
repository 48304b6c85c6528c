# SPDX-License-Identifier: Apache-2.0
"""Order of driving: which leg of the path each measured leg is, given where the tracker stands.

Dynamic programming (Viterbi) over the legs of the path. They advance one by one; anything else has
its price: legs passed over, measured legs that lie off the path, a jump to any other leg (parts
driven again, a restart from an earlier corner), a change of the sense in which the path is driven.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.model.frames import RigidTransform
from otf_core.model.path import Legs
from otf_core.tracking.track import Track

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OFF_PATH = -1
FORWARD, BACKWARD = 1, -1
OFF_COST = 6.0
SKIP_COST, EDGE_COST = 1.0, 0.3
JUMP_COST = 13.0
"""More than two measured legs off the path: a leg met by chance is not worth going there and
back."""
BLOCK = 1_000_000
"""Pairs of measured and nominal legs that are compared at a time."""


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
class _Legs:
    """Legs of the path, ready to compare many points with."""

    corners: Array
    length: Array
    unit: Array

    @classmethod
    def of(cls, corners: Array) -> _Legs:
        legs = Legs(corners)
        return cls(corners[:-1], legs.length, legs.unit)

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Squared distance of points from every leg and position along it, both (k, n)."""
        origin = self.corners.mean(axis=0)  # small numbers: their squares are subtracted
        points, corners = points - origin, self.corners - origin
        along = points @ self.unit.T - np.einsum('ij,ij->i', corners, self.unit)
        square = np.einsum('ij,ij->i', points, points)[:, None] - 2.0 * points @ corners.T
        square += np.einsum('ij,ij->i', corners, corners)
        beyond = along - np.clip(along, 0.0, self.length)
        square += beyond**2 - along**2
        return np.maximum(square, 0.0, out=square), along


@dataclass(frozen=True)
class _Emission:
    """Cost of measured legs (rows) on every nominal leg (columns); inf if impossible.

    ``anew`` is the cost of going on with the leg that the one before was on: it must begin where
    that one ended, or the leg is driven anew.
    """

    forward: Array
    backward: Array
    anew: Array
    anew_back: Array


def _emission(
    starts: Array, ends: Array, lengths: Array, legs: _Legs, tolerance: float, first: int
) -> _Emission:
    """Emission of some measured legs; ``first`` is 1 if one before them comes along, else 0."""
    square, from_along = legs.nearest(starts)
    square_end, to_along = legs.nearest(ends)
    advance = to_along - from_along
    cost = (square + square_end) / (2 * tolerance**2)
    near = np.maximum(square, square_end) < (4 * tolerance) ** 2
    least = np.maximum(0.9 * lengths[:, None] - 4 * tolerance, 0.0)
    anew, anew_back = np.zeros_like(cost), np.zeros_like(cost)
    slack = 4 * tolerance
    anew[1:] = np.where(from_along[1:] < to_along[:-1] - slack, OFF_COST, 0.0)
    anew_back[1:] = np.where(from_along[1:] > to_along[:-1] + slack, OFF_COST, 0.0)
    return _Emission(
        np.where(near & (advance > least), cost, np.inf)[first:],
        np.where(near & (-advance > least), cost, np.inf)[first:],
        anew[first:],
        anew_back[first:],
    )


def _emissions(
    pose: RigidTransform, track: Track, corners: Array, tolerance: float
) -> Iterator[tuple[int, _Emission]]:
    """Emission of all measured legs by blocks, with the number of the first of each."""
    legs, starts, ends = _Legs.of(corners), pose.apply(track.starts), pose.apply(track.ends)
    size = max(1, BLOCK // len(legs.length))
    for low in range(0, len(starts), size):
        before = min(low, 1)
        part = slice(low - before, low + size)
        yield (
            low,
            _emission(starts[part], ends[part], track.lengths[part], legs, tolerance, before),
        )


class _Chain:
    """Scores of the legs in one sense, and how each was reached.

    Legs count in the order in which this sense drives them.
    """

    def __init__(self, count: int, legs: int, offset: int) -> None:
        self.number = np.arange(legs)
        self.score = np.full(legs, np.inf)
        self.came = np.zeros((count, legs), dtype=np.int32)
        self.on_path = np.zeros((count, legs), dtype=bool)
        self._offset = offset  # of the first leg among all states

    def step(
        self, k: int, emission: Array, anew: Array, off: float, entry: Array, jump: float, at: int
    ) -> None:
        """Take measured leg ``k``: advance, go on, enter from before the path, or jump."""
        ahead = self.score - SKIP_COST * self.number
        running = np.minimum.accumulate(ahead)
        origin = np.maximum.accumulate(np.where(ahead <= running, self.number, 0))
        skip = np.concatenate([[np.inf], running[:-1]]) + SKIP_COST * (self.number - 1)
        before = np.concatenate([[0], origin[:-1]]) + self._offset
        same = self.number + self._offset
        options = np.stack([skip, self.score + anew, entry, np.full(len(same), jump)])
        pick = np.argmin(options, axis=0)
        reach = options[pick, self.number] + emission
        source = np.choose(pick, [before, same, 0 * same, np.full(len(same), at)])
        stay = self.score + off
        better = reach < stay
        self.came[k] = np.where(better, source, same)
        self.on_path[k] = better
        self.score = np.where(better, reach, stay)


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
    count, legs = len(track.start), len(corners) - 1
    number = np.arange(legs)
    # states: 0 before the path, then the legs driven forward, then those driven backward
    ahead, back = _Chain(count, legs, 1), _Chain(count, legs, legs + 1)
    cap = JUMP_COST if free else np.inf
    entry = np.minimum(EDGE_COST * number, cap)
    off_cost = OFF_COST * np.minimum(1.0, track.lengths / (20 * tolerance))
    start = 0.0
    for low, emission in _emissions(pose, track, corners, tolerance):
        for row in range(len(emission.forward)):
            off, jump, at = float(off_cost[low + row]), np.inf, 0
            if free:
                best = (start, ahead.score.min(), back.score.min())
                choice = int(np.argmin(best))
                at = (0, 1 + int(ahead.score.argmin()), 1 + legs + int(back.score.argmin()))[
                    choice
                ]
                jump = float(best[choice]) + JUMP_COST
            elif min(start, ahead.score.min()) > most:
                return None  # costs only grow
            here = (emission.forward[row], emission.anew[row])
            ahead.step(low + row, *here, off, start + entry, jump, at)
            if free:
                here = (emission.backward[row, ::-1], emission.anew_back[row, ::-1])
                back.step(low + row, *here, off, start + JUMP_COST + entry, jump, at)
            start += off
    left = np.minimum(EDGE_COST * (legs - 1 - number), cap)
    final = np.concatenate([[np.inf], ahead.score + left, back.score + left])
    state = int(np.argmin(final))
    cost = float(final[state])
    leg, sense = _traced(state, ahead, back)
    return Match(pose, leg, cost, track, sense, free)


def _traced(state: int, ahead: _Chain, back: _Chain) -> tuple[Index, Index]:
    """Leg and sense of every measured leg, from the last state back to the first."""
    count, legs = ahead.came.shape
    leg, sense = np.full(count, OFF_PATH, dtype=np.int64), np.ones(count, dtype=np.int64)
    for k in range(count - 1, -1, -1):
        if not state:
            break
        chain, j = (ahead, state - 1) if state <= legs else (back, state - 1 - legs)
        if chain.on_path[k, j]:
            leg[k] = j if chain is ahead else legs - 1 - j
            sense[k] = FORWARD if chain is ahead else BACKWARD
        state = int(chain.came[k, j])
    return leg, sense
