# SPDX-License-Identifier: Apache-2.0
"""The measured track as straight legs, found from its shape alone.

Samples are thinned to hops of fixed length, so standstill and pauses vanish; the track is broken
where the beam was lost; each part is reduced to its corner points (Ramer 1972, Douglas and
Peucker 1973). Nothing here knows the nominal path or the tracker's place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.blocks import blocks
from otf_core.errors import InputError
from otf_core.model.observation import Samples

HOP = 1e-3
"""m; distance between the points that describe the track."""
HOPS_OF_DIRECTION = 4
"""hops; distance over which a direction is taken."""
GAP_TIME = 0.05
"""s; at least this long without samples, and a hop of movement, is a gap."""
STRIDE_TIME = 0.005
"""s; interval at which samples are evaluated."""
POINTS_AHEAD = 16
"""Points within which the next hop lies where the machine drives."""


@dataclass(frozen=True)
class Track:
    """Straight legs of the measured track, in order of time.

    Attributes
    ----------
    hops : ndarray of int64, shape (h,)
        Sample index of the points that describe the track, about one per mm.
    points : ndarray, shape (h, 3), m
        Those points, single spikes removed.
    start, stop : ndarray of int64, shape (k,)
        First and last hop of every leg.
    joined : ndarray of bool, shape (k,)
        True if the leg begins at the corner where the one before it ended (no gap between).
    """

    hops: Index
    points: Array
    start: Index
    stop: Index
    joined: NDArray[np.bool_]

    @property
    def starts(self) -> Array:
        """Start points of the legs, shape (k, 3), m."""
        return self.points[self.start]

    @property
    def ends(self) -> Array:
        """End points of the legs, shape (k, 3), m."""
        return self.points[self.stop]

    @property
    def lengths(self) -> Array:
        """Lengths of the legs, shape (k,), m."""
        return np.asarray(np.linalg.norm(self.ends - self.starts, axis=1))

    def same_as(self, other: Track) -> bool:
        """Return whether another track is the same in every bit."""
        names = ('hops', 'points', 'start', 'stop', 'joined')
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    @cached_property
    def tree(self) -> Any:
        """The points as a k-d tree."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def lines(self) -> tuple[Array, Array]:
        """Centre (m) and unit direction of the middle half of every leg, each of shape (k, 3)."""
        count = self.stop - self.start + 1
        low = self.start + count // 4
        high = self.start + np.maximum(count // 4 + 2, 3 * count // 4)
        origin = self.points.mean(axis=0)  # small numbers: their squares are subtracted
        x, y, z = columns = np.ascontiguousarray((self.points - origin).T)
        spans = np.stack([low, high], axis=1).ravel()

        def mean(values: Array) -> Array:
            sums = np.add.reduceat(np.append(values, 0.0), spans)[::2]
            return np.asarray(sums / (high - low))

        centre = np.stack([mean(c) for c in columns], axis=1)
        square = np.empty((len(count), 3, 3))
        for i, row in enumerate((x, y, z)):
            for j in range(i + 1):
                square[:, i, j] = mean(row * columns[j]) - centre[:, i] * centre[:, j]
        unit = np.linalg.eigh(square)[1][:, :, -1]  # of the lower triangles
        ahead = np.einsum('ij,ij->i', unit, self.ends - self.starts)
        return centre + origin, unit * np.sign(ahead)[:, None]

    def cut_at(self, hops: Index) -> Track:
        """Cut legs at hops; those at the ends of a leg are left out."""
        leg = np.searchsorted(self.start, hops, side='right') - 1
        inside = (leg >= 0) & (hops > self.start[leg]) & (hops < self.stop[leg])
        cuts, leg = hops[inside], leg[inside]
        start = np.sort(np.concatenate([self.start, cuts]))
        stop = np.sort(np.concatenate([self.stop, cuts]))
        joined = np.isin(start, cuts) | np.isin(start, self.start[self.joined])
        return Track(self.hops, self.points, start, stop, joined)


def find_breaks(samples: Samples) -> NDArray[np.bool_]:
    """True where the stream pauses between a sample and the next one, shape (n - 1,)."""
    pause = max(1e9 * GAP_TIME, 5.0 * samples.step_ns)
    return np.asarray(np.diff(samples.stamp_ns) > pause)


def _hop_selection(points: Array) -> Index:
    """Keep a point whenever it is one hop away from the last one kept."""
    keep, at = bytearray(len(points)), 0
    for part in blocks(len(points)):
        ahead = _hops_ahead(
            points[part.start : part.stop + POINTS_AHEAD], part.stop - part.start
        ).tolist()
        while at < part.stop:
            keep[at] = 1
            at += ahead[at - part.start] or _standstill(points, at)
    return np.flatnonzero(np.frombuffer(keep, dtype=np.bool_))


def _hops_ahead(points: Array, count: int) -> NDArray[np.int8]:
    """Points to the next hop, for the first ``count`` points; 0 beyond ``POINTS_AHEAD``."""
    columns = np.ascontiguousarray(points.T)
    ahead, away = np.ones(count, dtype=np.int8), np.zeros(count, dtype=bool)
    for step in range(1, min(POINTS_AHEAD + 1, len(points))):
        x, y, z = columns[:, step : step + count] - columns[:, : min(count, len(points) - step)]
        away[: len(x)] |= x * x + y * y + z * z >= HOP * HOP
        if away.all():
            break
        ahead += ~away
    return np.where(away, ahead, np.int8(0))


def _standstill(points: Array, at: int) -> int:
    """How many points ahead the next hop is, looked for further and further; or the end."""
    first, size = at + POINTS_AHEAD + 1, 4 * POINTS_AHEAD
    while first < len(points):
        x, y, z = (points[first : first + size] - points[at]).T
        gone = np.flatnonzero(x * x + y * y + z * z >= HOP * HOP)
        if len(gone):
            return first + int(gone[0]) - at
        first, size = first + size, 2 * size
    return len(points) - at


def _middle_of_three(points: Array) -> Array:
    """Medians of three successive points (n, 3), component by component, shape (n - 2, 3)."""
    before, at, after = points[:-2], points[1:-1], points[2:]
    middle = np.minimum(np.maximum(before, at), after)
    return np.asarray(np.maximum(middle, np.minimum(before, at), out=middle))


def _farthest(points: Array, i: int, j: int) -> tuple[int, float]:
    """Index and distance of the point between i and j farthest from their segment."""
    inner = points[i + 1 : j] - points[i]
    chord = points[j] - points[i]
    square = float(chord @ chord)
    along = np.clip(inner @ chord / square, 0.0, 1.0) if square > 0 else np.zeros(len(inner))
    offset = inner - along[:, None] * chord
    distance = np.einsum('ij,ij->i', offset, offset)
    k = int(np.argmax(distance))
    return i + 1 + k, math.sqrt(float(distance[k]))


def reversals(points: Array) -> Index:
    """Points where the track turns by more than a right angle, shape (k,).

    A line driven to and fro lies on its own chord, so distance alone does not show its ends.
    """
    if len(points) <= 2 * HOPS_OF_DIRECTION:
        return np.zeros(0, dtype=np.int64)
    step = points[HOPS_OF_DIRECTION:] - points[:-HOPS_OF_DIRECTION]
    turn = np.einsum('ij,ij->i', step[HOPS_OF_DIRECTION:], step[:-HOPS_OF_DIRECTION])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], turn < 0, [False]])))
    places = [
        int(low + np.argmin(turn[low:high])) + HOPS_OF_DIRECTION
        for low, high in zip(edges[::2], edges[1::2], strict=True)
    ]
    return np.array(places, dtype=np.int64)


def simplify(points: Array, tolerance: float) -> Index:
    """Corner points of a polyline (Ramer, Douglas, Peucker), between its reversals.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
    tolerance : float
        m; no point lies further from the simplified polyline.

    Returns
    -------
    ndarray of int64, shape (k,)
        Indices of the corner points, first and last included.
    """
    ends = sorted({0, *reversals(points).tolist(), len(points) - 1})
    keep = set(ends)
    stack = list(pairwise(ends))
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k, distance = _farthest(points, i, j)
        if distance > tolerance:
            keep.add(k)
            stack += [(i, k), (k, j)]
    return np.array(sorted(keep), dtype=np.int64)


def measured_track(samples: Samples, tolerance: float) -> Track:
    """Reduce samples to straight legs.

    Parameters
    ----------
    tolerance : float
        m; deviation from a straight line that makes a corner.

    Raises
    ------
    InputError
        If the target hardly moved.
    """
    stride = max(1, round(STRIDE_TIME / max(samples.step, 1e-9))) if len(samples) > 2 else 1
    index, points = np.arange(0, len(samples), stride), samples.xyz[::stride].copy()
    if len(points) > 2:
        points[1:-1] = _middle_of_three(points)
    selected = _hop_selection(points) if len(points) else index
    if len(selected) < 10:
        raise InputError(
            f'the target hardly moved in {len(samples)} samples; record while the machine drives '
            f'the path'
        )
    hops, points = index[selected], points[selected]
    quiet = np.diff(samples.stamp_ns[hops])  # a pause is no gap: look at the sample before
    before = samples.stamp_ns[hops[1:]] - samples.stamp_ns[np.maximum(hops[1:] - stride, 0)]
    gap = np.minimum(quiet, before) > max(GAP_TIME * 1e9, 5 * stride * samples.step_ns)
    bounds = np.concatenate([[0], np.flatnonzero(gap) + 1, [len(hops)]])
    starts, stops, joined = [], [], []
    for low, high in pairwise(bounds):
        if high - low < 3:
            continue
        corner = low + simplify(points[low:high], tolerance)
        starts.append(corner[:-1])
        stops.append(corner[1:])
        joined.append(np.arange(len(corner) - 1) > 0)
    if not starts:
        raise InputError('the recording has so many gaps that no straight line remains')
    return Track(
        hops, points, np.concatenate(starts), np.concatenate(stops), np.concatenate(joined)
    )
