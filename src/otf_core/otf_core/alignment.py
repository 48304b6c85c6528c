# SPDX-License-Identifier: Apache-2.0
"""Alignment of tracker samples with the nominal path (paper 1.2.3).

Rough: ``matching``. Fine: each point's nearest point on its own leg, then the rigid motion that
minimises the distances perpendicular to the legs, repeated to a stop criterion. The paper fits
point to point; point to line is the same problem without the sliding along the path, and settles
in three or four steps instead of hundreds (docs/formulation.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.contradictions.no_match import why_no_match
from otf_core.errors import InputError
from otf_core.frames import RigidTransform
from otf_core.matching import OFF_PATH, Match, find_match, follow
from otf_core.observation import Samples
from otf_core.path import NominalPath
from otf_core.track import Track, measured_track

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Alignment:
    """Pose of the tracker and the leg of every sample.

    Attributes
    ----------
    T_machine_tracker : RigidTransform
    corners : ndarray, shape (m + 1, 3), m
        Corner points of the path, straight-through points removed; leg j runs from j to j + 1.
    leg : ndarray of int64, shape (n,)
        Leg of every sample, ``OFF_PATH`` where there is none.
    coverage : float
        Driven share of the path length.
    last_leg_driven : bool
        True if the track reaches the end of the path.
    """

    T_machine_tracker: RigidTransform
    corners: Array
    leg: NDArray[np.int64]
    coverage: float
    last_leg_driven: bool


def line_step(
    points: Array, origin: Array, direction: Array, weight: Array
) -> tuple[Array, Array]:
    """One least-squares step of a rigid motion towards lines.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Measured points in the machine frame.
    origin, direction : ndarray, shape (n, 3)
        A point (m) and the unit direction of each point's line.
    weight : ndarray, shape (n,)

    Returns
    -------
    translation : ndarray, shape (3,), m
    rotation_vector : ndarray, shape (3,), rad
        About the origin of the machine frame.

    Raises
    ------
    InputError
        If the lines leave a motion free, such as turning about a single line.
    """
    centre = points.mean(axis=0)
    local = points - centre
    size = np.sqrt(np.mean(np.einsum('ij,ij->i', local, local))) or 1.0
    turn = np.cross(np.eye(3)[:, None, :], local[None] / size).transpose(1, 2, 0)
    columns = np.concatenate([np.broadcast_to(np.eye(3), turn.shape), turn], axis=2)
    columns = (
        columns - direction[:, :, None] * np.einsum('ij,ijk->ik', direction, columns)[:, None]
    )
    offset = points - origin
    offset = offset - direction * np.einsum('ij,ij->i', direction, offset)[:, None]
    normal = np.einsum('n,nik,nil->kl', weight, columns, columns) / weight.sum()
    right = -np.einsum('n,nik,ni->k', weight, columns, offset) / weight.sum()
    if np.linalg.eigvalsh(normal)[0] < 1e-7:
        raise InputError(
            'the driven lines do not fix the place of the tracker (all parallel or too few); '
            'record the whole path'
        )
    motion = np.linalg.solve(normal, right)
    rotation_vector = motion[3:] / size
    return motion[:3] - np.cross(rotation_vector, centre), rotation_vector


def _refine(
    match: Match, track: Track, corners: Array, config: CalibrationConfig
) -> RigidTransform:
    """Fine alignment on the hops of the assigned legs."""
    legs = _hop_legs(match, track)
    use = legs != OFF_PATH
    source, legs = track.points[use], legs[use]
    step = np.diff(corners, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / length[:, None]
    pose = match.pose
    for _ in range(config.max_iterations):
        points = pose.apply(source)
        along = np.einsum('ij,ij->i', points - corners[legs], unit[legs])
        inside = (along > config.corner_exclusion) & (
            along < length[legs] - config.corner_exclusion
        )
        if inside.sum() < 10:
            raise InputError('hardly any point lies on a line of the path away from its corners')
        weight = inside / length[legs]  # every leg counts alike, however fast it was driven
        shift, turn = line_step(points, corners[legs], unit[legs], weight)
        moved = pose.moved_by(shift, turn)
        change = float(np.abs(moved.apply(source) - points).max())
        pose = moved
        if change < max(config.alignment_stop, 1e-6):
            break
    return pose


def _hop_legs(match: Match, track: Track) -> NDArray[np.int64]:
    """Leg of every hop of the track."""
    legs = np.full(len(track.hops), OFF_PATH, dtype=np.int64)
    for first, last, leg in zip(track.start, track.stop, match.leg, strict=True):
        legs[first : last + 1] = leg
    return legs


def _explained(match: Match, track: Track) -> float:
    """Share of the measured length that lies on the path."""
    return float(track.lengths[match.leg != OFF_PATH].sum() / track.lengths.sum())


def _coverage(match: Match, track: Track, corners: Array) -> float:
    """Share of the nominal length that was driven."""
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    use = match.leg != OFF_PATH
    driven = np.bincount(match.leg[use], track.lengths[use], minlength=len(length))
    return float(np.minimum(driven, length).sum() / length.sum())


def _sample_legs(match: Match, track: Track, count: int) -> NDArray[np.int64]:
    legs = np.full(count, OFF_PATH, dtype=np.int64)
    for first, last, leg in zip(track.start, track.stop, match.leg, strict=True):
        legs[track.hops[first] : track.hops[last] + 1] = leg
    return legs


def align(samples: Samples, path: NominalPath, config: CalibrationConfig) -> Alignment:
    """Find the tracker's pose and the leg of every sample.

    Parameters
    ----------
    samples : Samples
    path : NominalPath
    config : CalibrationConfig

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        If samples and path do not belong together, or the pose is not determined; says why.
    """
    corners, _ = path.corners()
    if len(corners) < 3:
        raise InputError('path: a single straight line cannot be aligned; it needs corners')
    tolerance = config.match_tolerance
    track = measured_track(samples, tolerance)
    match = find_match(track, corners, tolerance)
    if match is None or _explained(match, track) < 0.3:
        raise InputError(
            f'samples do not follow the path: {why_no_match(samples, track, corners, tolerance)}'
        )
    for _ in range(2):
        pose = _refine(match, track, corners, config)
        match = follow(pose, track, corners, tolerance)
        if _explained(match, track) < 0.3:
            raise InputError(
                f'samples do not follow the path: only {100 * _explained(match, track):.0f} % of '
                f'the measured track lies within {1e3 * tolerance:g} mm of it; '
                f'{why_no_match(samples, track, corners, tolerance)}'
            )
    return Alignment(
        _refine(match, track, corners, config),
        corners,
        _sample_legs(match, track, len(samples)),
        _coverage(match, track, corners),
        _reaches_end(match, track, corners, tolerance),
    )


def _reaches_end(match: Match, track: Track, corners: Array, tolerance: float) -> bool:
    last = int(match.leg.max())
    end = match.pose.apply(track.ends[match.leg == last][-1:])[0]
    return last == len(corners) - 2 and bool(np.linalg.norm(end - corners[-1]) < 4 * tolerance)
