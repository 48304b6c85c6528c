# SPDX-License-Identifier: Apache-2.0
"""Places of the tracker proposed by points at equal distances along track and path.

Corners tell nothing on circles and smooth curves, and none is shared by a path driven backward.
The length along the path does not depend on the frame either: points that follow each other at
equal lengths have the same mutual distances in the track and in the path.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.path import Legs
from otf_core.tracking.track import Track

WIDTH = 6
"""Points of a window."""
SPANS = (2.0, 1.0, 0.4)
"""Lengths of windows, in extents of the path."""
STARTS = 20_000
"""Windows of the path at most."""
TRIES = 12
"""Windows of the track per length."""


def dense_points(corners: Array, step: float) -> tuple[Array, Array]:
    """Points along a polyline at most ``step`` m apart, and their path lengths, m."""
    done = Legs(corners).reach
    along = np.linspace(0.0, done[-1], max(2, int(np.ceil(done[-1] / step)) + 1))
    return at_length(corners, done, along), along


def at_length(points: Array, done: Array, along: Array) -> Array:
    """Points of a polyline at path lengths, shape (n, 3), m."""
    return np.stack([np.interp(along, done, points[:, k]) for k in range(3)], axis=1)


def _mutual(windows: Array) -> Array:
    first, second = np.triu_indices(windows.shape[1], 1)
    return np.asarray(np.linalg.norm(windows[:, first] - windows[:, second], axis=2))


def _path_windows(corners: Array, span: float, step: float) -> Array:
    points, along = dense_points(corners, step)
    starts = along[along <= along[-1] - span]
    place = starts[:, None] + np.linspace(0.0, span, WIDTH)
    return at_length(points, along, place.ravel()).reshape(-1, WIDTH, 3)


def _track_windows(track: Track, span: float) -> Array:
    """Windows of the track without a gap inside, those of largest extent first."""
    bounds = np.concatenate([np.flatnonzero(~track.joined), [len(track.joined)]])
    windows = [np.empty((0, WIDTH, 3))]
    for low, high in pairwise(bounds):
        points = track.points[track.start[low] : track.stop[high - 1] + 1]
        done = Legs(points).reach
        starts = np.linspace(0.0, done[-1] - span, 8 * TRIES) if done[-1] > span else np.empty(0)
        place = starts[:, None] + np.linspace(0.0, span, WIDTH)
        windows.append(at_length(points, done, place.ravel()).reshape(-1, WIDTH, 3))
    found = np.concatenate(windows)
    if not len(found):
        return found
    spread = np.linalg.svd(found - found.mean(axis=1, keepdims=True), compute_uv=False)
    # the widest of every part of the run: a part that was driven otherwise must not take all
    parts = np.array_split(np.argsort(np.arange(len(found)), kind='stable'), TRIES)
    best = [int(p[np.argmax(spread[p, 1] + spread[p, 2])]) for p in parts if len(p)]
    order = np.argsort(-(spread[best, 1] + spread[best, 2]), kind='stable')
    return np.asarray(found[np.array(best)[order]])


def _hits(difference: Array, limit: float) -> list[int]:
    """Places where the difference is below the limit and least among its neighbours."""
    low = np.flatnonzero(difference < limit)
    runs = np.split(low, np.flatnonzero(np.diff(low) > 1) + 1) if len(low) else []
    return [int(r[np.argmin(difference[r])]) for r in runs]


def propose(track: Track, corners: Array, tolerance: float) -> list[RigidTransform]:
    """Poses under which some stretch of the track has the shape of some stretch of the path.

    Parameters
    ----------
    track : Track
    corners : ndarray, shape (n, 3), m
    tolerance : float
        m.
    """
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    total = float(Legs(corners).length.sum())
    step = max(tolerance, total / STARTS)
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
