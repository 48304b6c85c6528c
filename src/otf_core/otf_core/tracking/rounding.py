# SPDX-License-Identifier: Apache-2.0
"""Corners that the machine rounds: where they would be, and how far the rounding reaches.

A control in continuous-path mode leaves one line before its end and meets the next after its
start. The lines themselves are still driven; where two of them meet is the corner of the path.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.tracking.track import HOP, Track

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LINE = 0.05
"""m; shorter measured legs may be part of a rounding."""
REACH = 0.08
"""m; a rounding begins no further from its corner."""
PARALLEL = 0.05
"""Sine of the angle below which two lines have no corner."""
DEVIATION = 1e-4
"""m; where a measured leg departs from its own line by more, it is rounded."""
BOW = 15.0
"""A leg that is bent all along departs at its ends by less, as a multiple of its middle."""
CUT, MISSED = 5e-4, 3e-3
"""m; a corner was rounded if its end departs from the line by one or stays away by the other."""
TAIL = 1.2
"""A rounding begins before it can be told: it departs with the square of the path length."""


def _line(points: Array) -> tuple[Array, Array]:
    """Centre and direction of the middle half of the points of a leg."""
    inner = points[len(points) // 4 : max(len(points) // 4 + 2, 3 * len(points) // 4)]
    centre = inner.mean(axis=0)
    direction = np.linalg.svd(inner - centre, full_matrices=False)[2][0]
    return centre, direction * np.sign(direction @ (points[-1] - points[0]))


def _meeting(before: Array, after: Array, tolerance: float) -> Array | None:
    """Where the lines of two measured legs (points) meet beyond them; None if they do not."""
    (p, u), (q, v) = _line(before), _line(after)
    normal = np.cross(u, v)
    sine = float(np.linalg.norm(normal))
    if sine < PARALLEL or abs(float((q - p) @ normal)) / sine > tolerance:
        return None
    s = float(np.cross(q - p, v) @ normal) / sine**2
    t = float(np.cross(q - p, u) @ normal) / sine**2
    corner = 0.5 * (p + s * u + q + t * v)
    past, due = float((corner - before[-1]) @ u), float((after[0] - corner) @ v)
    if not (-tolerance < past < REACH and -tolerance < due < REACH):
        return None
    return np.asarray(corner)


def sharpened(track: Track, tolerance: float) -> Track | None:
    """Track with the rounding of its corners taken off; None if there is none.

    Parameters
    ----------
    track : Track
    tolerance : float
        m; corners that are rounded less stay.
    """
    lengths = track.lengths
    long = np.flatnonzero(lengths >= LINE)
    points, gone = track.points.copy(), np.zeros(len(track.start), dtype=bool)
    start, stop = track.start.copy(), track.stop.copy()
    for i, j in pairwise(long.tolist()):
        if not track.joined[i + 1 : j + 1].all() or lengths[i + 1 : j].sum() > 2 * REACH:
            continue
        if max(lengths[[i, j]] / (track.stop[[i, j]] - track.start[[i, j]])) > 10 * HOP:
            continue  # no track but jumps
        before = track.points[track.start[i] : track.stop[i] + 1]
        after = track.points[track.start[j] : track.stop[j] + 1]
        corner = _meeting(before, after, tolerance)
        if corner is None:
            continue
        between = np.arange(track.stop[i], track.start[j] + 1)
        off = np.linalg.norm(track.points[between] - corner, axis=1)
        if off.min() < tolerance:
            continue
        hop = int(between[np.argmin(off)])
        points[hop], stop[i], start[j] = corner, hop, hop
        gone[i + 1 : j] = True
    if np.array_equal(points, track.points):
        return None
    keep = ~gone
    return replace(
        track, points=points, start=start[keep], stop=stop[keep], joined=track.joined[keep]
    )


def rounded_ends(points: Array, corners: Array, joined: tuple[bool, bool], least: float) -> Array:
    """Length at both ends of a leg that is rounded, shape (2,), m.

    Zero where that is less than ``least`` or the measured leg is too short to tell. A leg is
    rounded where it departs from its own line, or ends far from the corner.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Points of the measured leg, machine frame.
    corners : ndarray, shape (2, 3), m
        Ends of the leg of the path.
    joined : pair of bool
        Whether the track goes on at the ends.
    least : float
        m.
    """
    found = np.zeros(2)
    if len(points) < 12 or np.linalg.norm(points[-1] - points[0]) < LINE:
        return found
    centre, direction = _line(points)
    local = points - centre
    off = np.linalg.norm(local - np.outer(local @ direction, direction), axis=1)
    quarter = len(points) // 4
    limit = max(DEVIATION, BOW * float(np.sqrt(np.mean(off[quarter:-quarter] ** 2))))
    for side in (0, 1):
        order = slice(None) if side == 0 else slice(None, None, -1)
        part, way = off[order][: 2 * quarter], points[order]
        beyond = float(np.linalg.norm(way[0] - corners[side]))
        hop = float(np.linalg.norm(way[1] - way[0]))
        if not joined[side] or (max(part[:2]) < CUT and beyond < max(MISSED, 2 * hop)):
            continue
        inner = np.flatnonzero(part[1:] < limit)
        if not len(inner):
            continue
        length = float(np.linalg.norm(way[int(inner[0])] - corners[side]))
        if least < length < REACH:
            found[side] = TAIL * length + 1e-3
    return found
