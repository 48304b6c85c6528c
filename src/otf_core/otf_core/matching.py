# SPDX-License-Identifier: Apache-2.0
"""Rough alignment: which leg of the nominal path is each measured leg, and where is the tracker.

The paper (1.2.3) uses start point, end point and centroid, which fails where the recording holds
more or less than the path. Here short runs of measured corner points are compared with runs of
nominal ones by their mutual distances; each agreement proposes a pose, and the pose under which
the whole track follows the path in driving order (Viterbi) wins.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.frames import RigidTransform, rigid_fit
from otf_core.track import Track

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OFF_PATH = -1
_MAX_WINDOWS = 60
_MAX_HYPOTHESES = 4000
_MAX_FULL = 24
_OFF_COST, _SKIP_COST, _EDGE_COST = 6.0, 1.0, 0.3


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
    """

    pose: RigidTransform
    leg: Index
    cost: float


def _pair_distances(windows: Array) -> Array:
    """Mutual distances of the points of each window (m, w, 3) -> (m, pairs)."""
    pairs = list(combinations(range(windows.shape[1]), 2))
    return np.stack(
        [np.linalg.norm(windows[:, i] - windows[:, j], axis=1) for i, j in pairs], axis=1
    )


def _sliding(points: Array, width: int) -> Array:
    return np.stack([points[i : len(points) - width + 1 + i] for i in range(width)], axis=1)


def _measured_windows(track: Track, width: int) -> Array:
    """Runs of corner points of the track without a gap inside, those of largest extent first."""
    windows = []
    bounds = np.concatenate([np.flatnonzero(~track.joined), [len(track.joined)]])
    for low, high in pairwise(bounds):
        corners = np.concatenate([track.starts[low:high], track.ends[high - 1 : high]])
        if len(corners) >= width:
            windows.append(_sliding(corners, width))
    if not windows:
        return np.empty((0, width, 3))
    found = np.concatenate(windows)
    spread = np.linalg.svd(found - found.mean(axis=1, keepdims=True), compute_uv=False)
    order = np.argsort(-(spread[:, 1] + spread[:, 2]), kind='stable')
    return found[order[:_MAX_WINDOWS]]


def _hypotheses(track: Track, corners: Array, tolerance: float) -> list[RigidTransform]:
    poses: list[RigidTransform] = []
    for width in (4, 3):
        if len(corners) < width:
            continue
        nominal = _sliding(corners, width)
        distances = _pair_distances(nominal)
        for window in _measured_windows(track, width):
            difference = np.abs(distances - _pair_distances(window[None]))
            for k in np.flatnonzero(difference.max(axis=1) < 3 * tolerance):
                pose = rigid_fit(window, nominal[k])
                off = np.linalg.norm(pose.apply(window) - nominal[k], axis=1).max()
                if off < 3 * tolerance:
                    poses.append(pose)
            if len(poses) > _MAX_HYPOTHESES:
                break
        if poses:
            break
    return poses


def _quick_score(pose: RigidTransform, track: Track, tree: object, tolerance: float) -> float:
    ends = pose.apply(np.concatenate([track.starts, track.ends]))
    distance, _ = tree.query(ends, distance_upper_bound=5 * tolerance)  # type: ignore[attr-defined]
    return float(np.sum(np.isfinite(distance)))


def segment_distance(points: Array, corners: Array) -> tuple[Array, Array]:
    """Distance of points to every leg of a polyline and position along it.

    Parameters
    ----------
    points : ndarray, shape (k, 3), m
    corners : ndarray, shape (n, 3), m

    Returns
    -------
    distance : ndarray, shape (k, n - 1), m
    along : ndarray, shape (k, n - 1), m
        From the start of the leg, not clipped.
    """
    step = np.diff(corners, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / length[:, None]
    along = points @ unit.T - np.einsum('ij,ij->i', corners[:-1], unit)
    foot = corners[:-1] + np.clip(along, 0, length)[:, :, None] * unit
    return np.linalg.norm(points[:, None, :] - foot, axis=2), along


def _emission(
    pose: RigidTransform, track: Track, corners: Array, tolerance: float
) -> tuple[Array, Array]:
    """Cost of every measured leg (rows) on every nominal leg (columns); inf if impossible.

    The second array is the cost of going on with the leg that the one before was on: it must
    begin where that one ended, or the leg is driven anew.
    """
    first, from_along = segment_distance(pose.apply(track.starts), corners)
    last, to_along = segment_distance(pose.apply(track.ends), corners)
    advance = to_along - from_along
    cost = (first**2 + last**2) / (2 * tolerance**2)
    possible = (np.maximum(first, last) < 4 * tolerance) & (
        advance > 0.9 * track.lengths[:, None] - 4 * tolerance
    )
    possible &= advance > 0
    anew = np.zeros_like(cost)
    anew[1:] = np.where(from_along[1:] < to_along[:-1] - 4 * tolerance, _OFF_COST, 0.0)
    return np.where(possible, cost, np.inf), anew


def follow(pose: RigidTransform, track: Track, corners: Array, tolerance: float) -> Match:
    """Assign measured legs to nominal legs in driving order by dynamic programming (Viterbi).

    A leg may be missing (gap, late start), a measured leg may lie off the path (approach,
    retract); both cost. Order never runs backwards.

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine.
    track : Track
    corners : ndarray, shape (n, 3), m
        Nominal corner points.
    tolerance : float
        m.
    """
    emission, anew = _emission(pose, track, corners, tolerance)
    count, legs = emission.shape
    number = np.arange(legs)
    # score[j]: best cost so far with leg j the last one driven; one extra state before the first
    score = np.concatenate([[0.0], np.full(legs, np.inf)])
    came = np.zeros((count, legs + 1), dtype=np.int64)
    on_path = np.zeros((count, legs + 1), dtype=bool)
    weight = np.where(number == 0, 0, number)
    off_cost = _OFF_COST * np.minimum(1.0, track.lengths / (20 * tolerance))
    for k in range(count):
        ahead = score[1:] - _SKIP_COST * weight
        running = np.minimum.accumulate(ahead)
        origin = np.maximum.accumulate(np.where(ahead <= running, number, 0))
        skip = np.concatenate([[np.inf], running[:-1]]) + _SKIP_COST * (weight - 1)
        options = np.stack([skip, score[1:] + anew[k], score[0] + _EDGE_COST * number])
        pick = np.argmin(options, axis=0)
        reach = options[pick, number] + emission[k]
        source = np.choose(pick, [np.concatenate([[0], origin[:-1]]) + 1, number + 1, 0 * number])
        stay = score + off_cost[k]
        better = reach < stay[1:]
        came[k, 1:] = np.where(better, source, number + 1)
        on_path[k, 1:] = better
        score = np.concatenate([stay[:1], np.where(better, reach, stay[1:])])
    final = score + np.concatenate([[np.inf], _EDGE_COST * (legs - 1 - number)])
    state = int(np.argmin(final))
    cost = float(final[state])
    leg = np.full(count, OFF_PATH, dtype=np.int64)
    for k in range(count - 1, -1, -1):
        if state and on_path[k, state]:
            leg[k] = state - 1
        state = int(came[k, state])
    return Match(pose, leg, cost)


def find_match(track: Track, corners: Array, tolerance: float) -> Match | None:
    """Find pose and assignment without any prior knowledge.

    Parameters
    ----------
    track : Track
    corners : ndarray, shape (n, 3), m
        Nominal corner points, straight-through points removed.
    tolerance : float
        m; allowed distance of measured from nominal corners.

    Returns
    -------
    Match or None
        None if no run of measured corners fits any run of nominal ones.
    """
    from scipy.spatial import cKDTree

    poses = _hypotheses(track, corners, tolerance)
    if not poses:
        return None
    tree = cKDTree(corners)
    quick = np.array([_quick_score(p, track, tree, tolerance) for p in poses])
    distinct: list[RigidTransform] = []
    for k in np.argsort(-quick, kind='stable'):
        moved = poses[k].apply(track.points[:: max(1, len(track.points) // 50)])
        new = all(
            np.abs(moved - p.apply(track.points[:: max(1, len(track.points) // 50)])).max()
            > 10 * tolerance
            for p in distinct
        )
        if new:
            distinct.append(poses[k])
        if len(distinct) >= _MAX_FULL:
            break
    matches = [follow(p, track, corners, 2 * tolerance) for p in distinct]
    return min(matches, key=lambda m: m.cost)
