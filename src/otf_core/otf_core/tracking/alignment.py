# SPDX-License-Identifier: Apache-2.0
"""Alignment of tracker samples with the nominal path (paper 1.2.3).

Rough: ``matching``. Fine: each point's nearest point on its own leg, then the rigid motion that
minimises the distances perpendicular to the legs, repeated to a stop criterion. The paper fits
point to point; point to line is the same problem without the sliding along the path, and settles
in three or four steps instead of hundreds (docs/formulation.md).

A motion u + w x l moves a point l along its line d by [d, l x d] . [u, w], which costs nothing;
all else counts. Points of one line differ in l alone, so a line needs no more of them than their
moments up to the second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.curves import (
    Lines,
    PathShape,
    largest_sagitta,
    shape_of_parts,
    straight_shape,
)
from otf_core.tracking.driving_order import (
    FORWARD,
    OFF_PATH,
    Driven,
    Match,
    assign_legs,
    driven_path,
    sample_chords,
)
from otf_core.tracking.matching import (
    MIN_MATCHED_SHARE,
    MatchingInput,
    cut_track,
    driven_share_of,
)
from otf_core.tracking.measured_track import Track, measured_track
from otf_core.tracking.no_match import MIRRORED_MESSAGE, match_mirrored, why_no_match


def line_step(
    points: Array, origin: Array, direction: Array, weight: Array, line: Index
) -> tuple[Array, Array]:
    """One least-squares step of a rigid motion towards lines.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Measured points in the machine frame.
    origin, direction : ndarray, shape (m, 3)
        A point (m) and the unit direction of each line.
    weight : ndarray, shape (n,)
    line : ndarray of int64, shape (n,)
        Line of each point.

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
    centre = np.ones(len(points)) @ points / len(points)
    local = np.subtract(points.T, centre[:, None], order='C')
    size = float(np.sqrt(np.vdot(local, local) / len(points))) or 1.0
    local /= size
    away, unit = np.ascontiguousarray((centre - origin).T), np.ascontiguousarray(direction.T)
    moments = _moments(local, weight / weight.sum(), line, len(origin))
    normal, right = _line_sums(*moments, away, unit, size)
    if np.linalg.eigvalsh(normal)[0] < 1e-7:
        raise InputError(
            'the driven lines do not determine the tracker pose (all parallel or too few); '
            'record the whole path'
        )
    motion = np.linalg.solve(normal, right)
    rotation_vector = motion[3:] / size
    return np.asarray(motion[:3] - np.cross(rotation_vector, centre)), np.asarray(rotation_vector)


def _moments(local: Array, share: Array, line: Index, lines: int) -> tuple[Array, Array, Array]:
    """Sums over the points (3, n) of every line of 1, l and l l^T: (m,), (3, m), (3, 3, m)."""
    passages = np.flatnonzero(np.diff(line, prepend=-1))  # points in a row on the same line
    passed = line[passages]

    def of_lines(values: Array) -> Array:
        sums = np.bincount(passed, np.add.reduceat(values, passages), lines)
        return sums.astype(np.float64, copy=False)

    square = np.empty((3, 3, lines))
    weighted = local * share
    for i in range(3):
        for j in range(i + 1):
            square[i, j] = square[j, i] = of_lines(weighted[i] * local[j])
    return of_lines(share), np.stack([of_lines(row) for row in weighted]), square


def _line_sums(
    total: Array, mean: Array, square: Array, away: Array, unit: Array, size: float
) -> tuple[Array, Array]:
    """Normal matrix (6, 6) and right side (6,) of ``line_step`` from the moments of lines.

    ``away`` (3, m) leads from a point of each line to the centre of all points, m.
    """
    off, turned = size * mean + away * total, _cross(square, unit)
    along = np.stack([unit * total, _cross(mean, unit)]).reshape(6, -1) @ unit.T
    normal = np.zeros((6, 6))
    normal[:3, :3] = total.sum() * np.eye(3) - along[:3]
    normal[3:, :3] = -along[3:] - np.cross(mean.sum(axis=1), np.eye(3))
    normal[:3, 3:] = normal[3:, :3].T
    whole = square.sum(axis=2)
    normal[3:, 3:] = np.trace(whole) * np.eye(3) - whole
    normal[3:, 3:] -= _cross(np.swapaxes(turned, 0, 1), unit).sum(axis=2)
    across = away - unit * np.sum(unit * away, axis=0)
    turn = _cross(mean, across) - size * np.einsum('ikm,km->im', turned, unit)
    shift = off - unit * np.sum(unit * off, axis=0)
    return normal, -np.concatenate([shift.sum(axis=1), turn.sum(axis=1)])


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (3, ..., m) with vectors (3, m)."""
    rest = ((1, 2), (2, 0), (0, 1))
    return np.stack([a[i] * b[j] - a[j] * b[i] for i, j in rest])


MIN_SAGITTA_REMARK = 2e-6
"""m; a sagitta of the published chords that is worth a remark."""
MIN_SHARE_UNDOUBTED = 0.9
"""If a smaller share does, the track may be mirrored."""
MIN_GAIN_MIRRORED = 0.1
"""More of the measured length that a mirrored track must explain."""


@dataclass(frozen=True)
class Part:
    """One part of a run as it was measured.

    Attributes
    ----------
    path : AxisPath
        As driven, in the order of the axes of the machine.
    first, last : int
        Its samples.
    driven : float
        Share of the path that was driven.
    distance : float
        m; median distance of the samples from the curve, where a curve was matched.
    """

    path: AxisPath
    first: int
    last: int
    driven: float = 1.0
    distance: float = 0.0


@dataclass(frozen=True)
class Alignment:
    """Pose of the tracker, places of the reflectors and the leg of every sample.

    Attributes
    ----------
    corners : ndarray, shape (m + 1, 3), m
        Corner points of the path as driven, straight-through points removed; leg j runs from j
        to j + 1. That is the published path, unless legs were repeated or driven backward.
    leg : ndarray of int32, shape (n,)
        Leg of every sample, ``OFF_PATH`` where there is none.
    coverage : float
        Driven share of the length of the published path.
    last_leg_driven : bool
        True if the track ends at the end of the path.
    curves : PathShape, optional
        Which legs are chords of curves; none without it.
    parts : tuple of Part
        Empty where the machine is not known.
    missing : tuple of AxisPath
        Parts of the path that were not recorded.
    places : mapping of target to ndarray, shape (3,), m
        Where reflectors were found.
    location : mapping of name to float, m and rad
        Rough location errors of the rotary axes.
    as_planned : bool
        Legs were driven forward and in order.
    followed : float
        Share of the track that lies within ``match_tolerance`` of the path.
    remarks : tuple of str
        What the reader of a result should know of the driven path.
    published : ndarray of int64, shape (m,), optional
        Leg of the published path of every leg, ``OFF_PATH`` for connecting moves; the same
        numbers without it.
    """

    T_machine_tracker: RigidTransform
    corners: Array
    leg: NDArray[np.int32]
    coverage: float
    last_leg_driven: bool
    curves: PathShape | None = None
    published: Index | None = None
    parts: tuple[Part, ...] = ()
    missing: tuple[AxisPath, ...] = ()
    places: Mapping[str, Array] = field(default_factory=dict)
    location: Mapping[str, float] = field(default_factory=dict)
    as_planned: bool = True
    followed: float = 1.0
    remarks: tuple[str, ...] = ()

    @property
    def shape(self) -> PathShape:
        """Corner points and curves."""
        return self.curves or straight_shape(self.corners)

    def moved(self, pose: RigidTransform, places: Mapping[str, Array]) -> Alignment:
        """The same with the tracker and the reflectors of parts elsewhere."""
        known = {**self.places, **places}
        pairs = zip(self.shape.sights, self.parts, strict=True)
        sights = [replace(sight, place=known[part.path.target]) for sight, part in pairs]
        shape = shape_of_parts(sights, [part.path.positions for part in self.parts])
        return replace(
            self, T_machine_tracker=pose, corners=shape.corners, curves=shape, places=known
        )


def _remarks(shape: PathShape) -> tuple[str, ...]:
    sagitta = largest_sagitta(Lines.of(shape))
    if sagitta < MIN_SAGITTA_REMARK:
        return ()
    return (
        f'curves are published as chords of up to {1e6 * sagitta:.2g} um sagitta and taken as '
        f'driven along these chords: publish chords of 1 mm or less',
    )


def _refine(match: Match, driven: Driven, config: CalibrationConfig) -> RigidTransform:
    """Fine alignment on the hops of the assigned legs."""
    margin = config.corner_exclusion
    track, lines = match.track, Lines.of(driven.shape)
    legs = _hop_legs(match)
    use = legs != OFF_PATH
    source = track.points[use]
    chord = driven.chord[legs[use]]
    pose = match.pose
    for _ in range(config.max_iterations):
        points = pose.apply(source)
        chord = lines.settled(points, chord)
        along = lines.start[chord] + lines.along(points, chord)
        total = lines.total[chord]
        inside = (along > margin) & (along < total - margin)
        if inside.sum() < 10:
            raise InputError('hardly any point lies on a line of the path away from its corners')
        weight = inside / total  # every leg counts alike, however fast it was driven
        step = line_step(points, lines.corners[:-1], lines.unit, weight, chord)
        moved = pose.moved_by(*step)
        change = float(np.abs(moved.apply(source) - points).max())
        pose = moved
        if change < max(config.alignment_stop, 1e-6):
            break
    return pose


def _hop_legs(match: Match) -> Index:
    """Measured leg of every hop of the track, ``OFF_PATH`` if it belongs to no leg of the path."""
    legs = np.full(len(match.track.hops), OFF_PATH, dtype=np.int64)
    pairs = zip(match.track.start, match.track.stop, match.leg, strict=True)
    for k, (first, last, leg) in enumerate(pairs):
        legs[first : last + 1] = k if leg != OFF_PATH else OFF_PATH
    return legs


@dataclass(frozen=True)
class FollowedTrack:
    """How a measured track follows a path: all of an alignment but the legs of single samples.

    What is known of a run whose target only stands since.

    Attributes
    ----------
    match : Match
        With the track as it was matched.
    pose : RigidTransform
        Tracker to machine.
    """

    measured: Track
    path: NominalPath
    config: CalibrationConfig
    guide: MatchingInput
    match: Match
    driven: Driven
    pose: RigidTransform

    @property
    def to_the_end(self) -> bool:
        """True if the track ends at the end of the path."""
        return _reaches_end(self.match, self.guide.vertices, self.config.match_tolerance)

    def is_of(self, track: Track, path: NominalPath, config: CalibrationConfig) -> bool:
        """Return whether this is what such a track, path and configuration give."""
        same = config == self.config and np.array_equal(path.points, self.path.points)
        return same and track.same_as(self.measured)


def align(
    samples: Samples,
    path: NominalPath,
    config: CalibrationConfig,
    seen: FollowedTrack | None = None,
) -> Alignment:
    """Find the tracker's pose and the leg of every sample.

    Parameters
    ----------
    seen : FollowedTrack, optional
        Of the same run before its last samples; saves time if the target has not moved since.

    Raises
    ------
    InputError
        If samples and path do not belong together, or the pose is not determined.
    """
    known = follow_track(samples, path, config, seen)
    tolerance, driven, pose = config.match_tolerance, known.driven, known.pose
    exclusion = config.corner_exclusion
    return Alignment(
        pose,
        driven.shape.corners,
        sample_chords(known.match, driven, pose, samples.xyz, exclusion, 4 * tolerance),
        driven_share_of(known.match, known.guide, 4 * tolerance),
        known.to_the_end,
        driven.shape,
        driven.published,
        remarks=_remarks(driven.shape),
    )


def follow_track(
    samples: Samples,
    path: NominalPath,
    config: CalibrationConfig,
    seen: FollowedTrack | None = None,
) -> FollowedTrack:
    """Find the tracker's pose and the leg of every part of the track; see ``align``."""
    tolerance = config.match_tolerance
    measured = measured_track(samples, tolerance)
    if seen is not None and seen.is_of(measured, path, config):
        return seen
    guide, track = MatchingInput.of(path, tolerance), measured
    match = guide.find(track, tolerance)
    if match is None or match.explained < MIN_MATCHED_SHARE:
        raise InputError(
            f'samples do not follow the path: {why_no_match(samples, track, guide, tolerance)}'
        )
    if match.explained < MIN_SHARE_UNDOUBTED:
        image = match_mirrored(track, guide, tolerance)
        if image is not None and image.explained > match.explained + MIN_GAIN_MIRRORED:
            raise InputError(f'samples do not follow the path: {MIRRORED_MESSAGE}')
    driven = driven_path(match, guide.shape, guide.vertex, 4 * tolerance)
    track = match.track
    for _ in range(2):
        pose = _refine(match, driven, config)
        whole = cut_track(track, pose, guide.cuts, 2 * tolerance)
        match = assign_legs(pose, whole, guide.vertices, tolerance, match.free)
        if match.explained < MIN_MATCHED_SHARE:
            raise InputError(
                f'samples do not follow the path: only {100 * match.explained:.0f} % of '
                f'the measured track lies within {1e3 * tolerance:g} mm of it; '
                f'{why_no_match(samples, track, guide, tolerance)}'
            )
        driven = driven_path(match, guide.shape, guide.vertex, 4 * tolerance)
    pose = _refine(match, driven, config)
    return FollowedTrack(measured, path, config, guide, match, driven, pose)


def _reaches_end(match: Match, vertices: Array, tolerance: float) -> bool:
    k = int(np.flatnonzero(match.leg != OFF_PATH)[-1])
    end = match.pose.apply(match.track.ends[k : k + 1])[0]
    return bool(
        match.leg[k] == len(vertices) - 2
        and match.sense[k] == FORWARD
        and np.linalg.norm(end - vertices[-1]) < 4 * tolerance
    )
