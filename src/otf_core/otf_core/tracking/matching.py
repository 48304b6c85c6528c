# SPDX-License-Identifier: Apache-2.0
"""Rough alignment: which leg of the nominal path is each measured leg, and where is the tracker.

The paper (1.2.3) uses start point, end point and centroid, which fails where the recording holds
more or less than the path. Here short runs of measured corner points are compared with runs of
nominal ones by their mutual distances; each agreement proposes a pose, and the pose under which
the whole track follows the path (``driving_order``) wins.

Circles and smooth curves have no corners, and a path driven backward shares no run of them. There,
points at equal lengths along track and path take their place: they have the same mutual distances,
and the length along the path does not depend on the frame. The published path is matched with its
corners as they are and its curves thinned (``MatchingInput``).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.path import Legs, NominalPath
from otf_core.tracking.curves import NO_PART, PathShape, shape_of
from otf_core.tracking.driving_order import OFF_PATH as OFF_PATH
from otf_core.tracking.driving_order import Match as Match
from otf_core.tracking.driving_order import assign_legs as follow
from otf_core.tracking.driving_order import assign_legs_within, is_as_planned, visits
from otf_core.tracking.measured_track import Track

POINTS_PER_WINDOW = 6
"""Points of a window."""
SPANS = (2.0, 1.0, 0.4)
"""Lengths of windows, in extents of the path."""
MAX_WINDOWS = 20_000
"""Windows of the path at most."""
WINDOWS_PER_LENGTH = 12
"""Windows of the track per length."""


def dense_points(corners: Array, step: float) -> tuple[Array, Array]:
    """Points along a polyline at most ``step`` m apart, and their path lengths, m."""
    reach = Legs(corners).reach
    along = np.linspace(0.0, reach[-1], max(2, int(np.ceil(reach[-1] / step)) + 1))
    return at_length(corners, reach, along), along


def at_length(points: Array, reach: Array, along: Array) -> Array:
    """Points of a polyline at path lengths, shape (n, 3), m."""
    return np.stack([np.interp(along, reach, points[:, k]) for k in range(3)], axis=1)


def _mutual(windows: Array) -> Array:
    first, second = np.triu_indices(windows.shape[1], 1)
    return np.asarray(np.linalg.norm(windows[:, first] - windows[:, second], axis=2))


def _path_windows(corners: Array, span: float, step: float) -> Array:
    points, along = dense_points(corners, step)
    starts = along[along <= along[-1] - span]
    place = starts[:, None] + np.linspace(0.0, span, POINTS_PER_WINDOW)
    return at_length(points, along, place.ravel()).reshape(-1, POINTS_PER_WINDOW, 3)


def _track_windows(track: Track, span: float) -> Array:
    """Windows of the track without a gap inside, those of largest extent first."""
    bounds = np.concatenate([np.flatnonzero(~track.joined), [len(track.joined)]])
    windows = [np.empty((0, POINTS_PER_WINDOW, 3))]
    for low, high in pairwise(bounds):
        points = track.points[track.start[low] : track.stop[high - 1] + 1]
        reach = Legs(points).reach
        starts = (
            np.linspace(0.0, reach[-1] - span, 8 * WINDOWS_PER_LENGTH)
            if reach[-1] > span
            else np.empty(0)
        )
        place = starts[:, None] + np.linspace(0.0, span, POINTS_PER_WINDOW)
        windows.append(at_length(points, reach, place.ravel()).reshape(-1, POINTS_PER_WINDOW, 3))
    points_of = np.concatenate(windows)
    if not len(points_of):
        return points_of
    spread = np.linalg.svd(points_of - points_of.mean(axis=1, keepdims=True), compute_uv=False)
    # the widest of every part of the run: a part that was driven otherwise must not take all
    parts = np.array_split(
        np.argsort(np.arange(len(points_of)), kind='stable'), WINDOWS_PER_LENGTH
    )
    best = [int(p[np.argmax(spread[p, 1] + spread[p, 2])]) for p in parts if len(p)]
    order = np.argsort(-(spread[best, 1] + spread[best, 2]), kind='stable')
    return np.asarray(points_of[np.array(best)[order]])


def _hits(difference: Array, limit: float) -> list[int]:
    """Places where the difference is below the limit and least among its neighbours."""
    low = np.flatnonzero(difference < limit)
    runs = np.split(low, np.flatnonzero(np.diff(low) > 1) + 1) if len(low) else []
    return [int(r[np.argmin(difference[r])]) for r in runs]


def propose(track: Track, corners: Array, tolerance: float) -> list[RigidTransform]:
    """Poses under which some stretch of the track has the shape of some stretch of the path.

    Parameters
    ----------
    corners : ndarray, shape (n, 3), m
    tolerance : float
        m.
    """
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    total = float(Legs(corners).length.sum())
    step = max(tolerance, total / MAX_WINDOWS)
    limit = 3 * tolerance + step
    poses: list[RigidTransform] = []
    for span in (s * extent for s in SPANS):
        windows = _track_windows(track, span)
        if span > total or not len(windows):
            continue
        for path in (corners, corners[::-1]):
            nominal = _path_windows(path, span, step)
            distances = _mutual(nominal)
            for window in windows:
                difference = np.abs(distances - _mutual(window[None])).max(axis=1)
                for k in _hits(difference, limit):
                    pose = rigid_fit(window, nominal[k])
                    if np.abs(pose.apply(window) - nominal[k]).max() < limit:
                        poses.append(pose)
    return poses


_MAX_WINDOWS = 60
_MAX_HYPOTHESES = 4000
_MAX_FULL = 24
_SCORED = 1000
_MAX_ROUGH = 3
_MAX_ARCS, _MAX_FREE, _PROBES = 8, 6, 150
MIN_MATCHED_SHARE = 0.3
"""Share of the measured length that must follow the path."""
MIN_SHARE_UNDOUBTED = 0.5
"""Share of the measured length; if less follows the path, corners may have deceived."""
MIN_SHARE_FINAL = 0.99
"""Share of the measured length; no better tracker pose is searched for on curves."""
MIN_SHARE_AS_PLANNED = 0.97
"""Share of the measured length; if so much follows the path as planned, nothing else is tried."""


def _pair_distances(windows: Array) -> Array:
    """Mutual distances of the points of each window (m, w, 3) -> (m, pairs)."""
    pairs = list(combinations(range(windows.shape[1]), 2))
    return np.stack(
        [np.linalg.norm(windows[:, i] - windows[:, j], axis=1) for i, j in pairs], axis=1
    )


def _sliding(points: Array, width: int) -> Array:
    """All runs of ``width`` successive points, shape (m, width, 3)."""
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
    points_of = np.concatenate(windows)
    spread = np.linalg.svd(points_of - points_of.mean(axis=1, keepdims=True), compute_uv=False)
    order = np.argsort(-(spread[:, 1] + spread[:, 2]), kind='stable')
    return points_of[order[:_MAX_WINDOWS]]


def _hypotheses(track: Track, corners: Array, tolerance: float) -> list[RigidTransform]:
    poses: list[RigidTransform] = []
    for width in (4, 3):
        if len(corners) < width:
            continue
        nominal = _sliding(corners, width)
        _, first = np.unique(nominal.reshape(len(nominal), -1), axis=0, return_index=True)
        nominal = nominal[np.sort(first)]  # laps repeat them
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


def _quick_scores(
    poses: list[RigidTransform], track: Track, corners: Array, tolerance: float
) -> Array:
    """How many ends of measured legs fall on corners under every pose, shape (n,)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.unique(corners, axis=0))  # laps repeat them: a tree of equals is slow
    some = slice(None, None, max(1, len(track.start) // _SCORED))
    hops, count = np.unique([track.start[some], track.stop[some]], return_counts=True)
    ends, reach = track.points[hops], 5 * tolerance
    near = (np.isfinite(tree.query(p.apply(ends), distance_upper_bound=reach)[0]) for p in poses)
    return np.array([float(count[n].sum()) for n in near])


def distinct_poses(
    poses: list[RigidTransform], score: Array, points: Array, apart: float, most: int
) -> list[RigidTransform]:
    """Best poses that differ from each other.

    Parameters
    ----------
    score : ndarray, shape (n,)
        Higher is better.
    points : ndarray, shape (k, 3), m
        Points that two different poses move apart.
    apart : float
        m.
    """
    probe = points[:: max(1, len(points) // 50)]
    distinct: list[RigidTransform] = []
    places: list[Array] = []
    for k in np.argsort(-score, kind='stable'):
        moved = poses[k].apply(probe)
        if all(np.abs(moved - p).max() > apart for p in places):
            distinct.append(poses[k])
            places.append(moved)
        if len(distinct) >= most:
            break
    return distinct


def cut_track(track: Track, pose: RigidTransform, cuts: Array, reach: float) -> Track:
    """Cut measured legs where they pass points of the path: curves have no corners of their own.

    Parameters
    ----------
    pose : RigidTransform
        Tracker to machine.
    cuts : ndarray, shape (c, 3), m
        Points of the path, machine frame.
    reach : float
        m; a hop so near passes the point.
    """
    if not len(cuts):
        return track
    places = set()
    inverse = (cuts - pose.translation) @ pose.rotation
    for point, near in zip(inverse, track.tree.query_ball_point(inverse, reach), strict=True):
        hops = np.sort(np.array(near, dtype=np.int64))
        for passage in np.split(hops, np.flatnonzero(np.diff(hops) > 1) + 1):
            if len(passage):
                distance = np.linalg.norm(track.points[passage] - point, axis=1)
                places.add(int(passage[np.argmin(distance)]))
    return track.cut_at(np.array(sorted(places), dtype=np.int64))


def _until_all(
    poses: list[RigidTransform], track: Track, corners: Array, cuts: Array, tolerance: float
) -> list[Match]:
    """Follow the path as planned under one pose after another until one explains all."""
    planned: list[Match] = []
    for pose in poses:
        whole = cut_track(track, pose, cuts, 2 * tolerance)
        planned.append(follow(pose, whole, corners, tolerance, False))
        if planned[-1].explained > MIN_SHARE_FINAL:
            break
    return planned


def _all_planned(
    poses: list[RigidTransform], track: Track, corners: Array, tolerance: float
) -> list[Match]:
    """Follow the path as planned under all poses; under the best alone if that is enough."""
    best = follow(poses[0], track, corners, tolerance, False)
    matches: list[Match | None] = [best]
    for pose in poses[1:]:
        matches.append(match := assign_legs_within(best.cost, pose, track, corners, tolerance))
        if match is not None and match.cost < best.cost:
            best = match
    if best.explained > MIN_SHARE_AS_PLANNED:
        return [best]
    pairs = zip(matches, poses, strict=True)
    return [m or follow(p, track, corners, tolerance, False) for m, p in pairs]


def best_match(
    poses: list[RigidTransform], track: Track, corners: Array, cuts: Array, tolerance: float
) -> Match | None:
    """Follow the path under every pose; as planned if that explains nearly all, else freely."""
    if not poses:
        return None
    if len(cuts):
        planned = _until_all(poses, track, corners, cuts, tolerance)
    else:
        planned = _all_planned(poses, track, corners, tolerance)
    planned.sort(key=_cost)
    if planned[0].explained > MIN_SHARE_AS_PLANNED:
        return planned[0]
    free: list[Match] = []
    for match in planned[:_MAX_FREE]:
        free.append(follow(match.pose, match.track, corners, tolerance))
        if free[-1].explained > MIN_SHARE_AS_PLANNED:
            break
    return min(free, key=_cost)


def _by_length(track: Track, corners: Array, tolerance: float) -> list[RigidTransform]:
    """Poses proposed by lengths under which enough of the track lies on the path."""
    from scipy.spatial import cKDTree

    poses = propose(track, corners, tolerance)
    tree = cKDTree(dense_points(corners, tolerance)[0])
    probe = track.points[:: max(1, len(track.points) // _PROBES)]
    near = [tree.query(p.apply(probe), distance_upper_bound=5 * tolerance)[0] for p in poses]
    share = np.array([float(np.isfinite(d).mean()) for d in near])
    good = np.flatnonzero(share > MIN_MATCHED_SHARE)
    return distinct_poses(
        [poses[k] for k in good], share[good], track.points, 5 * tolerance, _MAX_ARCS
    )


def _cost(match: Match) -> float:
    return match.cost


def find_match(
    track: Track,
    corners: Array,
    tolerance: float,
    cuts: Array | None = None,
    *,
    rough: bool = False,
) -> Match | None:
    """Find pose and assignment without any prior knowledge.

    Parameters
    ----------
    corners : ndarray, shape (n, 3), m
        Nominal corner points, straight-through points removed.
    tolerance : float
        m; allowed distance of measured from nominal corners.
    cuts : ndarray, shape (c, 3), m, optional
        Those of them that lie on curves, where the track has no corner.
    rough : bool
        The path is only roughly known: places of reflectors and lines of axes are improved later.

    Returns
    -------
    Match or None
        None if no part of the track fits any part of the path.
    """
    cuts = np.empty((0, 3)) if cuts is None else cuts
    poses = _hypotheses(track, corners, tolerance)
    best = None
    if poses:
        quick = _quick_scores(poses, track, corners, tolerance)
        most = _MAX_ROUGH if rough else _MAX_FULL
        distinct = distinct_poses(poses, quick, track.points, 10 * tolerance, most)
        best = best_match(distinct, track, corners, cuts, 2 * tolerance)
    if best is not None and best.explained > (
        MIN_SHARE_AS_PLANNED if len(cuts) and not rough else MIN_SHARE_UNDOUBTED
    ):
        return best
    distinct = _by_length(track, corners, tolerance)
    other = best_match(distinct, track, corners, cuts, 2 * tolerance)
    if best is None or (other is not None and other.explained > best.explained + 0.01):
        return other
    return best


@dataclass(frozen=True)
class MatchingInput:
    """What is matched.

    Attributes
    ----------
    vertex : ndarray of int64, shape (v,)
        Corner points that are matched: curves are thinned.
    """

    shape: PathShape
    vertex: Index

    @classmethod
    def of(cls, path: NominalPath, tolerance: float) -> MatchingInput:
        """Find corners and curves of a path."""
        corners, _ = path.corners()
        if len(corners) < 3:
            raise InputError('path: a single straight line cannot be aligned; it needs corners')
        shape = shape_of(corners)
        return cls(shape, shape.vertices(0.5 * tolerance))

    @property
    def vertices(self) -> Array:
        """Points of ``vertex``, shape (v, 3), m."""
        return self.shape.corners[self.vertex]

    @property
    def on_parts(self) -> NDArray[np.bool_]:
        """Which legs between successive vertices belong to a part, shape (v - 1,)."""
        part = self.shape.part
        if part is None:
            return np.ones(len(self.vertex) - 1, dtype=bool)
        return np.asarray(part[self.vertex[:-1]] != NO_PART)

    @property
    def curve(self) -> Index:
        """Curve, numbered from 0, of the leg between successive vertices, shape (v - 1,)."""
        stretch = self.shape.stretch[self.vertex[:-1]]
        return np.asarray(np.unique(stretch, return_inverse=True)[1], dtype=np.int64)

    @property
    def cuts(self) -> Array:
        """Vertices on curves, shape (c, 3), m."""
        curved = self.shape.curved
        on = np.concatenate([curved[:1], curved]) | np.concatenate([curved, curved[-1:]])
        return np.asarray(self.shape.corners[self.vertex[on[self.vertex]]])

    def find(self, track: Track, tolerance: float) -> Match | None:
        """Match a track without any prior knowledge, see ``find_match``."""
        rough = bool(self.shape.sights)
        return find_match(track, self.vertices, tolerance, self.cuts, rough=rough)


def driven_share_of(match: Match, guide: MatchingInput, slack: float) -> float:
    """Share of the nominal length that was driven."""
    vertices, curve = guide.vertices, guide.curve
    length = np.where(guide.on_parts, Legs(vertices).length, 0.0)
    driven = np.zeros(len(length))
    if is_as_planned(visits(match, vertices, slack)):
        use = match.leg != OFF_PATH
        np.add.at(driven, match.leg[use], match.track.lengths[use])
    else:
        for leg, spans in _spans(match, Legs(vertices)).items():
            upto = 0.0
            for low, high in sorted(spans):
                driven[leg] += max(0.0, high - max(low, upto))
                upto = max(upto, high)
    # parts of a curve begin and end at points that the track passes, a hop more or less
    seen, whole = np.bincount(curve, driven), np.bincount(curve, length)
    return float(np.minimum(seen, whole).sum() / length.sum())


def _spans(match: Match, legs: Legs) -> dict[int, list[tuple[float, float]]]:
    """Driven spans of every leg, m from its start."""
    places = [match.pose.apply(p) for p in (match.track.starts, match.track.ends)]
    spans: dict[int, list[tuple[float, float]]] = {}
    for k in np.flatnonzero(match.leg != OFF_PATH).tolist():
        j = int(match.leg[k])
        low, high = sorted(float((p[k] - legs.corners[j]) @ legs.unit[j]) for p in places)
        spans.setdefault(j, []).append((max(low, 0.0), min(high, float(legs.length[j]))))
    return spans
