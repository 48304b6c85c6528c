# SPDX-License-Identifier: Apache-2.0
"""Alignment of tracker samples with the nominal path (paper 1.2.3).

Rough: ``matching``. Fine: each point's nearest point on its own leg, then the rigid motion that
minimises the distances perpendicular to the legs, repeated to a stop criterion. The paper fits
point to point; point to line is the same problem without the sliding along the path, and settles
in three or four steps instead of hundreds (docs/formulation.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import Legs, NominalPath
from otf_core.tracking.arcs import Bulge, bulge_of, with_arcs
from otf_core.tracking.curves import SHORT_CURVE, Lines, PathShape, straight_shape
from otf_core.tracking.driven_path import Driven, as_planned, driven_path, sample_chords, visits
from otf_core.tracking.driving_order import FORWARD, OFF_PATH, Match, follow
from otf_core.tracking.guide import Guide
from otf_core.tracking.line_step import line_step
from otf_core.tracking.matching import ENOUGH, LEAST, cut_track
from otf_core.tracking.no_match import MIRRORED, mirrored, why_no_match
from otf_core.tracking.rounding import rounded_ends, sharpened
from otf_core.tracking.track import Track, measured_track

DOUBTFUL = 0.9
"""If a smaller share does, the track may be mirrored."""
CLEARLY = 0.1
"""More of the measured length that a mirrored track must explain."""
SLIGHTLY = 0.005
"""The same for a track with its corners sharpened."""


@dataclass(frozen=True)
class Alignment:
    """Pose of the tracker and the leg of every sample.

    Attributes
    ----------
    T_machine_tracker : RigidTransform
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
    published : ndarray of int64, shape (m,), optional
        Leg of the published path of every leg, ``OFF_PATH`` for connecting moves; the same
        numbers without it.
    rounded : ndarray, shape (m, 2), optional
        Length at the start and the end of every leg that the machine rounds, m.
    bulge : Bulge, optional
        Whether curves were driven along chords or arcs; None if that makes no difference.
    """

    T_machine_tracker: RigidTransform
    corners: Array
    leg: NDArray[np.int32]
    coverage: float
    last_leg_driven: bool
    curves: PathShape | None = None
    published: NDArray[np.int64] | None = None
    rounded: Array | None = None
    bulge: Bulge | None = None

    @property
    def shape(self) -> PathShape:
        """Corner points and curves."""
        return self.curves or straight_shape(self.corners)

    @property
    def remark(self) -> str:
        """What the reader of a result should know of the driven path; empty if nothing."""
        return '' if self.bulge is None else self.bulge.remark


def _refine(
    match: Match, driven: Driven, rounded: Array, config: CalibrationConfig
) -> RigidTransform:
    """Fine alignment on the hops of the assigned legs."""
    margin = np.maximum(config.corner_exclusion, rounded)
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
        inside = (along > margin[chord, 0]) & (along < total - margin[chord, 1])
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


def _hop_legs(match: Match) -> NDArray[np.int64]:
    """Measured leg of every hop of the track, ``OFF_PATH`` if it belongs to no leg of the path."""
    legs = np.full(len(match.track.hops), OFF_PATH, dtype=np.int64)
    pairs = zip(match.track.start, match.track.stop, match.leg, strict=True)
    for k, (first, last, leg) in enumerate(pairs):
        legs[first : last + 1] = k if leg != OFF_PATH else OFF_PATH
    return legs


def _match(track: Track, guide: Guide, tolerance: float) -> Match | None:
    """Match a track; if that fails, with the rounding of its corners taken off."""
    match = guide.find(track, tolerance)
    if match is not None and match.explained > ENOUGH:
        return match
    sharp = sharpened(track, tolerance)
    other = None if sharp is None else guide.find(sharp, tolerance)
    if other is not None and (match is None or other.explained > match.explained + SLIGHTLY):
        return other
    return match


def _coverage(match: Match, guide: Guide, slack: float) -> float:
    """Share of the nominal length that was driven."""
    vertices, curve = guide.vertices, guide.curve
    length = Legs(vertices).length
    driven = np.zeros(len(length))
    if as_planned(visits(match, vertices, slack)):
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
    found: dict[int, list[tuple[float, float]]] = {}
    for k in np.flatnonzero(match.leg != OFF_PATH).tolist():
        j = int(match.leg[k])
        low, high = sorted(float((p[k] - legs.corners[j]) @ legs.unit[j]) for p in places)
        found.setdefault(j, []).append((max(low, 0.0), min(high, float(legs.length[j]))))
    return found


@dataclass(frozen=True)
class Followed:
    """How a measured track follows a path: all of an alignment but the legs of single samples.

    What is known of a run whose target only stands since.

    Attributes
    ----------
    measured : Track
    path : NominalPath
    config : CalibrationConfig
    guide : Guide
    match : Match
        With the track as it was matched.
    driven : Driven
    rounded : ndarray, shape (m, 2), m
        See ``Alignment``.
    pose : RigidTransform
        Tracker to machine.
    """

    measured: Track
    path: NominalPath
    config: CalibrationConfig
    guide: Guide
    match: Match
    driven: Driven
    rounded: Array
    pose: RigidTransform

    @property
    def to_the_end(self) -> bool:
        """True if the track ends at the end of the path."""
        return _reaches_end(self.match, self.guide.vertices, self.config.match_tolerance)

    def is_of(self, track: Track, path: NominalPath, config: CalibrationConfig) -> bool:
        """Tell whether this is what such a track, path and configuration give."""
        same = config == self.config and np.array_equal(path.points, self.path.points)
        return same and track.same_as(self.measured)


def align(
    samples: Samples, path: NominalPath, config: CalibrationConfig, seen: Followed | None = None
) -> Alignment:
    """Find the tracker's pose and the leg of every sample.

    Parameters
    ----------
    samples : Samples
    path : NominalPath
    config : CalibrationConfig
    seen : Followed, optional
        Of the same run before its last samples; saves time if the target has not moved since.

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        If samples and path do not belong together, or the pose is not determined; says why.
    """
    known = followed(samples, path, config, seen)
    tolerance, driven, pose = config.match_tolerance, known.driven, known.pose
    exclusion = config.corner_exclusion
    found = Alignment(
        pose,
        driven.shape.corners,
        sample_chords(known.match, driven, pose, samples.xyz, exclusion, 4 * tolerance),
        _coverage(known.match, known.guide, 4 * tolerance),
        known.to_the_end,
        driven.shape,
        driven.published,
        known.rounded,
    )
    if driven.shape.straight:
        return found
    return _on_arcs(found, pose.apply(samples.xyz), SHORT_CURVE * exclusion)


def followed(
    samples: Samples, path: NominalPath, config: CalibrationConfig, seen: Followed | None = None
) -> Followed:
    """Find the tracker's pose and the leg of every part of the track; see ``align``."""
    tolerance = config.match_tolerance
    measured = measured_track(samples, tolerance)
    if seen is not None and seen.is_of(measured, path, config):
        return seen
    guide, track = Guide.of(path, tolerance), measured
    match = _match(track, guide, tolerance)
    if match is None or match.explained < LEAST:
        raise InputError(
            f'samples do not follow the path: {why_no_match(samples, track, guide, tolerance)}'
        )
    if match.explained < DOUBTFUL:
        image = mirrored(track, guide, tolerance)
        if image is not None and image.explained > match.explained + CLEARLY:
            raise InputError(f'samples do not follow the path: {MIRRORED}')
    driven = driven_path(match, guide.shape, guide.vertex, 4 * tolerance)
    track, rounded = match.track, _rounded(match, driven, config)
    for _ in range(2):
        pose = _refine(match, driven, rounded, config)
        whole = cut_track(track, pose, guide.cuts, 2 * tolerance)
        match = follow(pose, whole, guide.vertices, tolerance, match.free)
        if match.explained < LEAST:
            raise InputError(
                f'samples do not follow the path: only {100 * match.explained:.0f} % of '
                f'the measured track lies within {1e3 * tolerance:g} mm of it; '
                f'{why_no_match(samples, track, guide, tolerance)}'
            )
        driven = driven_path(match, guide.shape, guide.vertex, 4 * tolerance)
        rounded = _rounded(match, driven, config)
    pose = _refine(match, driven, rounded, config)
    return Followed(measured, path, config, guide, match, driven, rounded, pose)


def _on_arcs(found: Alignment, points: Array, least: float) -> Alignment:
    """Take the arcs through the joints of curves for the path, if they were driven."""
    lines = Lines.of(found.shape)
    on = np.flatnonzero(found.leg != OFF_PATH)
    on = on[lines.shape.curved[found.leg[on]]]
    bulge = bulge_of(points[on], found.leg[on].astype(np.int64), lines, least)
    if bulge is None or not bulge.arcs:
        return replace(found, bulge=bulge)
    shape, start, parent = with_arcs(lines)
    leg = np.where(found.leg == OFF_PATH, OFF_PATH, start[found.leg])
    on = np.flatnonzero(leg != OFF_PATH)
    leg[on] = Lines.of(shape).settled(points[on], leg[on])
    assert found.published is not None and found.rounded is not None
    return replace(
        found,
        corners=shape.corners,
        leg=leg.astype(np.int32),
        curves=shape,
        published=found.published[parent],
        rounded=found.rounded[parent],
        bulge=bulge,
    )


def _rounded(match: Match, driven: Driven, config: CalibrationConfig) -> Array:
    """Length at both ends of every leg of the driven path that is rounded, shape (m, 2), m."""
    found = np.zeros((len(driven.shape.stretch), 2))
    legs = np.flatnonzero((driven.chord != OFF_PATH) & (driven.chord == driven.last))
    chord = driven.chord[legs]
    corners = Legs(driven.shape.corners).seen_from(match.pose).corners
    ends = np.stack([corners[chord], corners[chord + 1]], axis=1)
    rounded = rounded_ends(match.track, legs, ends, config.corner_exclusion)
    np.maximum.at(found, chord, rounded)
    return found


def _reaches_end(match: Match, vertices: Array, tolerance: float) -> bool:
    k = int(np.flatnonzero(match.leg != OFF_PATH)[-1])
    end = match.pose.apply(match.track.ends[k : k + 1])[0]
    return bool(
        match.leg[k] == len(vertices) - 2
        and match.sense[k] == FORWARD
        and np.linalg.norm(end - vertices[-1]) < 4 * tolerance
    )
