# SPDX-License-Identifier: Apache-2.0
"""Reduction of recordings to their stops.

Standstill calibration (Montavon et al., Lamdamap 2019; paper, Table 1): the machine stops at every
corner point. Stops are recognised in the samples, matched to the points in driving order by their
mutual distances alone (how the machine moves between them does not matter), and averaged. Every
stop gives the full deviation in three directions, weighted by the tracker noise along and across
the beam; the same equations are solved as on the fly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import STANDSTILL, CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.observation import Samples
from otf_core.model.path import MIN_LEG, NominalPath, leg_bounds, sides_of_travel
from otf_core.noise.standstill import find_standstills
from otf_core.pieces.pieces import Pieces
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.curves import STANDS, PathShape, shape_of_parts
from otf_core.tracking.matching import OFF_PATH, find_match
from otf_core.tracking.measured_track import Track

MIN_STOP = 0.05
"""s; shortest part of a stop, settling left out, that is averaged."""
MIN_STOPS = 4
"""Fewer stops do not determine the tracker pose."""
SAME_PLACE, SAME_STOP = 1e-4, 0.5
"""m and s; successive standstills that lie closer together are one stop."""
AT_STOP = 1.5e-3
"""m; stops of parts are this near their corners."""
GENTLE = 0.05
"""s; left out at both ends of a stop: a reflector near a rotary axis starts and stops so gently
that its speed does not show it."""


@dataclass(frozen=True)
class Stops:
    """Standstills of a recording.

    Attributes
    ----------
    span : ndarray of int64, shape (k, 2)
        First sample and one past the last.
    xyz : ndarray, shape (k, 3), m
        Mean point in the tracker frame, outliers left out.
    samples : tuple of ndarray of int64
        Samples averaged, one array a stop.
    """

    span: Index
    xyz: Array
    samples: tuple[Index, ...]


def _without_outliers(xyz: Array, limit: float) -> NDArray[np.bool_]:
    """Points within ``limit`` robust standard deviations of the median."""
    distance = np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1)
    return np.asarray(distance <= limit * max(float(np.median(distance)), 1e-9))


def find_stops(samples: Samples, config: CalibrationConfig, margin: float = 0.0) -> Stops:
    """Recognise and average standstills; parts of one stop are joined.

    Parameters
    ----------
    margin : float
        s; left out at both ends beside what the speed leaves out.

    Raises
    ------
    InputError
        If there are fewer than ``MIN_STOPS``.
    """
    span = find_standstills(samples, config.standstill_speed, MIN_STOP)
    place = [np.median(samples.xyz[a:b], axis=0) for a, b in span]
    joined: list[list[int]] = []
    for k, (first, last) in enumerate(span.tolist()):
        if (
            joined
            and np.linalg.norm(place[k] - place[k - 1]) < SAME_PLACE
            and samples.time[first] - samples.time[joined[-1][1] - 1] < SAME_STOP
        ):
            joined[-1][1] = last
        else:
            joined.append([first, last])
    less = round(margin / samples.step)
    inner = [(a + less, b - less) for a, b in joined if b - a > 2 * less + 2]
    if len(inner) < MIN_STOPS:
        raise InputError(
            f'{len(inner)} standstills in the recording; the standstill method needs a stop at '
            f'every point of the path (use the method otf for a run without stops)'
        )
    limit = config.outlier_limit
    used = tuple(a + np.flatnonzero(_without_outliers(samples.xyz[a:b], limit)) for a, b in inner)
    mean = np.array([samples.xyz[places].mean(axis=0) for places in used])
    return Stops(np.array(inner, dtype=np.int64), mean, used)


def _distinct_points(path: NominalPath) -> Array:
    """Points of the path, successive repetitions merged, shape (n, 3), m."""
    step = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    return np.asarray(path.points[np.concatenate([[True], step > MIN_LEG])])


def match_in_order(measured: Array, nominal: Array, tolerance: float) -> Index:
    """Assign stops to points so that most are assigned and the order never runs backwards.

    Parameters
    ----------
    measured : ndarray, shape (k, 3), m
        Stops in order of time, machine frame.
    nominal : ndarray, shape (n, 3), m
        Points in driving order; a point visited twice is listed twice.
    tolerance : float
        m.

    Returns
    -------
    ndarray of int64, shape (k,)
        Point of every stop, ``OFF_PATH`` for stops elsewhere.
    """
    near = np.linalg.norm(measured[:, None] - nominal[None], axis=2) < tolerance
    count, points = near.shape
    best = np.zeros((count + 1, points), dtype=np.int64)
    for i in range(count):  # most assigned stops among the first i, the last one at point <= j
        best[i + 1] = np.maximum.accumulate(np.maximum(best[i], best[i] + near[i]))
    matched = np.full(count, OFF_PATH, dtype=np.int64)
    j = points - 1
    for i in range(count, 0, -1):
        if best[i, j] == best[i - 1, j]:
            continue
        j = int(np.argmax(best[i, : j + 1] == best[i, j]))
        matched[i - 1] = j
    return matched


def _rough_pose(stops: Stops, points: Array, tolerance: float) -> RigidTransform:
    number = np.arange(len(stops.xyz))
    track = Track(stops.span[:, 0], stops.xyz, number[:-1], number[1:], number[:-1] > 0)
    match = find_match(track, points, tolerance)
    if match is None:
        raise InputError(
            'no run of stops fits the points of the path: do bag and path belong together, and '
            'does the machine stop at every point?'
        )
    return match.pose


def align_stops(samples: Samples, path: NominalPath, config: CalibrationConfig) -> Alignment:
    """Find the tracker's pose and the point of every stop.

    Returns
    -------
    Alignment
        ``corners`` are the points of the path; ``leg`` holds the point of every sample in a
        stop; ``coverage`` is the share of points with a stop.

    Raises
    ------
    InputError
        If stops and points do not belong together.
    """
    points, stops = _distinct_points(path), find_stops(samples, config)
    pose = _rough_pose(stops, points, config.match_tolerance)
    for _ in range(3):
        matched = match_in_order(pose.apply(stops.xyz), points, 2 * config.match_tolerance)
        use = matched != OFF_PATH
        if use.sum() < MIN_STOPS:
            raise InputError(f'only {use.sum()} stops lie at points of the path')
        pose = rigid_fit(stops.xyz[use], points[matched[use]])
    leg = np.full(len(samples), OFF_PATH, dtype=np.int32)
    for (first, last), point in zip(stops.span, matched, strict=True):
        leg[first:last] = point
    coverage = len(np.unique(matched[use])) / len(points)
    return Alignment(pose, points, leg, coverage, bool(matched.max() == len(points) - 1))


def reduce_to_stops(samples: Samples, alignment: Alignment, config: CalibrationConfig) -> Pieces:
    """Average the stops at the corners of the path.

    Raises
    ------
    InputError
        If a part has none.
    """
    shape = alignment.shape
    if not shape.sights:
        stops = find_stops(samples, config)
        point = alignment.leg[stops.span[:, 0]].astype(np.int64)
        return _stop_pieces(samples, shape, stops, point)
    stops = find_stops(samples, config, GENTLE)
    positions = [part.path.positions for part in alignment.parts]
    at_corners = shape_of_parts(shape.sights, positions, corners_alone=True)
    places, at = alignment.T_machine_tracker.apply(stops.xyz), np.full(len(stops.xyz), OFF_PATH)
    first = np.cumsum([0, *(len(q) for q in positions)])
    for k, (a, b) in enumerate(stops.span.tolist()):
        chord = alignment.leg[a:b]
        chord = chord[chord != OFF_PATH]
        if not len(chord):
            continue
        number, place = int(shape.part_of_corners[chord[0]]), int(np.median(shape.places[chord]))
        low = first[number] + max(0, place - 2)
        near = at_corners.corners[low : min(first[number + 1], first[number] + place + 4)]
        away = np.linalg.norm(near - places[k], axis=1)
        if away.min() < AT_STOP:
            at[k] = low + int(away.argmin())
    for number, part in enumerate(alignment.parts):
        if not np.any((at >= first[number]) & (at < first[number + 1])):
            raise InputError(
                f"part {number + 1} ('{part.path.target}'): no stop lies at a corner of its "
                f'path; use the method otf for a run without stops'
            )
    return _stop_pieces(samples, at_corners, stops, at)


def _stop_pieces(samples: Samples, shape: PathShape, stops: Stops, point: Index) -> Pieces:
    """Return the stops at points of the path as pieces, each with a leg number of its own.

    Their direction is that of approach from the point before; zero, as unknown, at the first of a
    part.

    Parameters
    ----------
    shape : PathShape
        Whose corners are the points.
    point : ndarray of int64, shape (k,)
        Point of every stop or ``OFF_PATH``.
    """
    use, part = np.flatnonzero(point != OFF_PATH), shape.part_of_corners
    at, begins = point[use], np.append(True, np.diff(part) != 0)
    approach, moved = (
        np.where(begins[:, None], 0.0, np.diff(own, axis=0, prepend=own[:1]))
        for own in (shape.corners, shape.positions)
    )
    size = np.linalg.norm(approach, axis=1, keepdims=True)
    approach /= np.where(size > 0.0, size, np.inf)
    moved /= np.maximum(np.abs(moved).max(axis=1, keepdims=True), STANDS)
    side = np.concatenate([sides_of_travel(moved[a:b]) for a, b in leg_bounds(part)])
    span, time, count = stops.span[use], samples.time, len(use)
    averaged = [stops.samples[k] for k in use]
    samples_of = np.array([len(a) for a in averaged])
    return Pieces(
        q=shape.positions[at],
        step=moved[at],
        spread=np.zeros(count),
        xyz=stops.xyz[use],
        nominal=shape.corners[at],
        direction=approach[at],
        origin=shape.corners[at],
        part=part[at],
        leg=np.arange(count),
        stretch=np.arange(count),
        side=side[at],
        rate=np.zeros_like(shape.positions[at]),
        speed=np.zeros(count),
        count=samples_of,
        time=0.5 * (time[span[:, 0]] + time[span[:, 1] - 1]),
        duration=time[span[:, 1] - 1] - time[span[:, 0]],
        used=int(samples_of.sum()),
        outliers=int((span[:, 1] - span[:, 0] - samples_of).sum()),
        end=float(time[-1]),
        method=STANDSTILL,
        samples=np.concatenate(averaged),
        piece=np.repeat(np.arange(count), samples_of),
        stamps=(int(samples.stamp_ns[0]), int(samples.stamp_ns[-1])),
    )
