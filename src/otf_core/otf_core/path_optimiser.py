# SPDX-License-Identifier: Apache-2.0
"""The path that makes the grid best known in a given time.

Any leg between lattice points is a measured line, connections included. A walk is built leg by
leg, each time the leg that takes most off the mean grid variance per second, judged as if the
rest of the time were shared out ideally (``line_allocation``); then corner points are exchanged,
added and taken out while that lowers variance times time. Reverse passes drive the same walk
backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.candidate_lines import CandidateLines
from otf_core.line_allocation import Judgement, allocate, judge, total, variance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_TRIED = 6
"""Exchanges that are judged exactly before the search gives up."""


@dataclass(frozen=True)
class Walk:
    """A sequence of lattice points.

    Attributes
    ----------
    corners : tuple of int
        Lattice points in driving order.
    feeds : tuple of int
        Index of the feed of every leg.
    """

    corners: tuple[int, ...]
    feeds: tuple[int, ...]


class WalkSearch:
    """Search for the best walk.

    Parameters
    ----------
    lines : CandidateLines
    passes : int
        How often the walk is driven, every second time backwards.
    """

    def __init__(self, lines: CandidateLines, passes: int) -> None:
        self._lines, self._passes = lines, passes
        count = len(lines.points)
        self._line = np.full((count, count), -1, dtype=np.int64)
        self._line[lines.ends[:, 0], lines.ends[:, 1]] = np.arange(len(lines.ends))
        self._line = np.maximum(self._line, self._line.T)

    def _legs(self, walk: Walk) -> tuple[Index, Index]:
        corners = np.array(walk.corners)
        return self._line[corners[:-1], corners[1:]], np.array(walk.feeds, dtype=np.int64)

    def time(self, walk: Walk) -> float:
        """Driving time of all passes, s, with a dwell per leg."""
        line, feed = self._legs(walk)
        return self._passes * float(self._lines.cost[line, feed].sum())

    def matrix(self, walk: Walk) -> Array:
        """Sum of the normal matrices of all passes."""
        line, feed = self._legs(walk)
        weight = np.zeros(self._lines.cost.shape)
        np.add.at(weight, (line, feed), float(self._passes))
        return total(self._lines, weight)

    def _table(self, value: Array) -> Array:
        """Values of lines as a matrix over pairs of points; -inf where there is no line."""
        return np.where(self._line >= 0, value[self._line], -np.inf)

    def build(self, time: float) -> Walk:
        """Build a walk that uses up the time, s."""
        lines, passes = self._lines, self._passes
        ideal = total(lines, allocate(lines, time))
        matrix, left, feeds = np.zeros_like(ideal), time, []
        corners = [int(np.argmin(lines.points.sum(axis=1)))]
        while True:
            worth = judge(lines, matrix + max(left, 0.0) / time * ideal).gain / lines.cost
            worth = np.where(passes * lines.cost <= left, worth, -np.inf)
            here = self._table(worth.max(axis=1))[corners[-1]]
            nearest = int(np.argmax(here))
            if not np.isfinite(here[nearest]):
                return Walk(tuple(corners), tuple(feeds))
            line = int(self._line[corners[-1], nearest])
            feed = int(np.argmax(worth[line]))
            corners.append(nearest)
            feeds.append(feed)
            matrix += passes * lines.information[line * len(lines.feeds) + feed]
            left -= passes * float(lines.cost[line, feed])

    def _exchanges(self, walk: Walk, judged: Judgement) -> list[tuple[float, Walk]]:
        """Neighbouring walks by their first-order worth, best first."""
        cost = self._lines.cost
        line, feed = self._legs(walk)
        price = float(judged.gain[line, feed].sum() / cost[line, feed].sum())
        net = judged.gain - price * cost
        best = net.argmax(axis=1)
        table = self._table(net.max(axis=1))
        now = net[line, feed]
        corners = np.array(walk.corners)
        before, after = corners[:-2], corners[2:]
        swap = table[before] + table[after] - (now[:-1] + now[1:])[:, None]
        swap[np.arange(len(before)), corners[1:-1]] = -np.inf
        add = table[corners[:-1]] + table[corners[1:]] - now[:, None]
        drop = table[before, after] - now[:-1] - now[1:]
        found = [
            (float(swap[i, q]), (*walk.corners[: i + 1], int(q), *walk.corners[i + 2 :]), i, 2, 2)
            for i, q in _largest(swap)
        ]
        found += [
            (float(add[i, q]), (*walk.corners[: i + 1], int(q), *walk.corners[i + 1 :]), i, 1, 2)
            for i, q in _largest(add)
        ]
        found += [
            (float(drop[i]), (*walk.corners[: i + 1], *walk.corners[i + 2 :]), int(i), 2, 1)
            for (i,) in _largest(drop)
        ]
        found.sort(key=lambda f: -f[0])
        walks = []
        for worth, points, start, old, new in found[: 2 * _TRIED]:
            fresh = [int(best[self._line[points[k], points[k + 1]]]) for k in
                     range(start, start + new)]  # fmt: skip
            feeds = (*walk.feeds[:start], *fresh, *walk.feeds[start + old :])
            walks.append((worth, Walk(points, feeds)))
        return walks

    def improve(self, walk: Walk, time: float, steps: int) -> Walk:
        """Exchange corner points while variance times time falls and the time suffices."""
        matrix, spent = self.matrix(walk), self.time(walk)
        for _ in range(steps):
            judged = judge(self._lines, matrix)
            merit = judged.variance * spent
            for worth, other in self._exchanges(walk, judged):
                other_time = self.time(other)
                if worth <= 0 or other_time > time:
                    continue
                other_matrix = self.matrix(other)
                if variance(self._lines, other_matrix) * other_time < merit * (1 - 1e-5):
                    walk, matrix, spent = other, other_matrix, other_time
                    break
            else:
                break
        return walk


def _largest(values: Array) -> list[tuple[int, ...]]:
    """Indices of the largest finite values, at most ``2 * _TRIED``."""
    order = np.argsort(-values, axis=None)[: 2 * _TRIED]
    places = zip(*np.unravel_index(order, values.shape), strict=True)
    return [tuple(int(k) for k in p) for p in places if np.isfinite(values[p])]
