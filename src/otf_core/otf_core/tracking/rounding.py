# SPDX-License-Identifier: Apache-2.0
"""Corners that the machine rounds: where they would be, and how far the rounding reaches.

A control in continuous-path mode leaves one line before its end and meets the next after its
start. The lines themselves are still driven; where two of them meet is the corner of the path.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.tracking.track import HOP, Track

FEWEST = 11
"""Hops of a leg of which roundings can be told."""
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


def _meeting(track: Track, i: int, j: int, tolerance: float) -> Array | None:
    """Where the lines of two measured legs meet beyond them; None if they do not."""
    (p, q), (u, v) = (values[[i, j]] for values in track.lines)
    normal = np.cross(u, v)
    sine = float(np.linalg.norm(normal))
    if sine < PARALLEL or abs(float((q - p) @ normal)) / sine > tolerance:
        return None
    s = float(np.cross(q - p, v) @ normal) / sine**2
    t = float(np.cross(q - p, u) @ normal) / sine**2
    corner = 0.5 * (p + s * u + q + t * v)
    past, due = float((corner - track.ends[i]) @ u), float((track.starts[j] - corner) @ v)
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
        corner = _meeting(track, i, j, tolerance)
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


def rounded_ends(track: Track, legs: Index, corners: Array, least: float) -> Array:
    """Length at both ends of measured legs that is rounded, shape (k, 2), m.

    Zero where that is less than ``least`` or the measured leg is too short to tell. A leg is
    rounded where it departs from its own line, or ends far from the corner, and the track goes on.

    Parameters
    ----------
    track : Track
    legs : ndarray of int64, shape (k,)
        Measured legs, each on one leg of the path.
    corners : ndarray, shape (k, 2, 3), m
        Ends of that leg of the path, tracker frame.
    least : float
        m.
    """
    found, points = np.zeros((len(legs), 2)), track.points
    centre, unit = (values[legs] for values in track.lines)
    first, last = track.start[legs], track.stop[legs]
    outer, inner = points[np.stack([first, last], 1)], points[np.stack([first + 1, last - 1], 1)]
    beyond, hop = _length(outer - corners), _length(outer - inner)
    off = np.maximum(*(_across(p - centre[:, None], unit[:, None]) for p in (outer, inner)))
    told = (last - first >= FEWEST) & (_length(outer[:, 1] - outer[:, 0]) >= LINE)
    goes_on = np.append(track.joined, False)[np.stack([legs, legs + 1], axis=1)]
    doubtful = goes_on & ((off >= CUT) | (beyond >= np.maximum(MISSED, 2 * hop)))
    for k, side in np.argwhere(doubtful & told[:, None]).tolist():
        way = points[first[k] : last[k] + 1][:: -1 if side else 1]
        found[k, side] = _rounded(way, centre[k], unit[k], corners[k, side], least)
    return found


def _rounded(way: Array, centre: Array, unit: Array, corner: Array, least: float) -> float:
    """Length of the rounding at the start of points (n, 3) of a leg, m; zero if there is none."""
    off, quarter = _across(way - centre, unit), len(way) // 4
    limit = max(DEVIATION, BOW * float(np.sqrt(np.mean(off[quarter:-quarter] ** 2))))
    straight = np.flatnonzero(off[1 : 2 * quarter] < limit)
    if not len(straight):
        return 0.0
    length = float(_length(way[straight[0]] - corner))
    return TAIL * length + 1e-3 if least < length < REACH else 0.0


def _length(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _across(vectors: Array, unit: Array) -> Array:
    """Length of vectors (..., 3) across unit vectors."""
    return _length(vectors - np.sum(vectors * unit, axis=-1, keepdims=True) * unit)
