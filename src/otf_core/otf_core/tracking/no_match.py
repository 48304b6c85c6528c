# SPDX-License-Identifier: Apache-2.0
"""Why a track does not follow its path, or follows a part of it only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import Legs, NominalPath
from otf_core.tracking.driving_order import assign_legs
from otf_core.tracking.matching import OFF_PATH, Match, MatchingInput, cut_track, driven_share_of
from otf_core.tracking.measured_track import Track, measured_track

WIDER_TOLERANCES = (2.5, 5.0, 10.0)
"""Multiples of the tolerance that are tried to find what is wrong."""
MIN_COVERAGE = 0.8
"""Coverage below which a reason is searched for."""
MIN_SHARE_ON_PATH = 0.8
"""Share of a track that must lie on the path for a reason to hold."""
MIN_STANDOUT = 2e-4
"""m; a sample that lies further from the middle of its neighbours on a line stands out."""
MIN_STANDOUT_SHARE = 0.1
"""Share of samples standing out that is a reason."""
MAX_RATIO_OF_DISTANCES = 0.25
"""Distance of lines over that of corners from which on rounded corners are not the reason."""
INNER_PART_OF_LEG = (0.3, 0.7)
"""Part of a leg that rounding of its corners leaves alone."""


def match_mirrored(track: Track, guide: MatchingInput, tolerance: float) -> Match | None:
    """Match the mirror image of a track."""
    return guide.find(replace(track, points=track.points * [-1.0, 1.0, 1.0]), tolerance)


MIRRORED_MESSAGE = (
    'the track fits only mirrored: the tracker coordinates are left-handed (or two axes of '
    'the path are swapped); swap two coordinates or change the sign of one, in the driver'
)


def why_no_match(samples: Samples, track: Track, guide: MatchingInput, tolerance: float) -> str:
    """State why nothing fits, as far as the shapes show."""
    out, size = share_of_spikes(samples)
    ratio = extent(track.points) / extent(guide.vertices)
    if out > MIN_STANDOUT_SHARE:
        return (
            f'about {100 * out:.0f} % of the samples lie {1e3 * size:.2g} mm or more off '
            f'their neighbours: outliers; look for reflections, a dirty target or a disturbed '
            f'beam, and leave such samples out'
        )
    if not 0.3 < ratio < 3:
        return f'the measured track is {ratio:.3g} times as large as the path{unit_by_size(ratio)}'
    match = match_mirrored(track, guide, tolerance)
    if match is not None and match.explained > MIN_SHARE_ON_PATH:
        return MIRRORED_MESSAGE
    return _resembles(samples, guide, tolerance) or (
        f'no run of measured corners fits the path within match_tolerance '
        f'({1e3 * tolerance:g} mm): do bag and path belong together?'
    )


def extent(points: Array) -> float:
    """Length of a chord that is about the longest between points (n, 3), in any orientation, m."""
    first = points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()]
    return float(np.linalg.norm(points - first, axis=1).max())


def unit_by_size(ratio: float) -> str:
    """Unit that explains how large the track is beside the path, in words; empty: none does."""
    factor = max(ratio, 1.0 / ratio)
    large, small = ('points seem', 'path seems') if ratio > 1 else ('path seems', 'points seem')
    if 0.5 < factor / 1000.0 < 2.0:
        return f'; the {large} to be in mm, expected m'
    if abs(factor / INCHES_IN_M - 1.0) < SAME_UNIT:
        return f'; the {large} to be in inches: state it in the header, as in x_in,y_in,z_in'
    if abs(factor / MM_IN_INCH - 1.0) < SAME_UNIT:
        return (
            f'; the {small} to be in inches, not mm: state it in the header, as in x_in,y_in,z_in'
        )
    return ''


MM_IN_INCH, INCHES_IN_M = 25.4, 1000 / 25.4
SAME_UNIT = 0.05
"""By which the size of a track and of its path may differ."""


def _resembles(samples: Samples, guide: MatchingInput, tolerance: float) -> str:
    """State within which tolerance the track would fit, and whether corners are why."""
    otherwise = ''
    for factor in WIDER_TOLERANCES:
        enough = factor * tolerance
        match = guide.find(measured_track(samples, enough), enough)
        if match is None or match.explained <= MIN_SHARE_ON_PATH:
            continue
        beside = _beside_lines(match, guide.vertices)
        if beside > MAX_RATIO_OF_DISTANCES * enough:
            otherwise = otherwise or (
                f'it resembles the path, but lies {1e3 * beside:.2g} mm off the middle of its '
                f'lines: is it the path of another program or machine, or at another scale?'
            )
            continue
        return (
            f'they fit within {1e3 * enough:g} mm, but match_tolerance is {1e3 * tolerance:g} mm. '
            f'Its lines fit, its corners are rounded: raise match_tolerance to {enough:g} '
            f'(m) and corner_exclusion to the length that is rounded, about {3 * enough:g}'
        )
    return otherwise


def _beside_lines(match: Match, corners: Array) -> float:
    """Distance of the inner parts of the legs from their lines, root median square, m."""
    track = match.track
    points = match.pose.apply(track.points)
    unit = Legs(corners).unit
    distances = []
    for first, last, leg in zip(track.start, track.stop, match.leg, strict=True):
        low, high = (int(first + share * (last - first)) for share in INNER_PART_OF_LEG)
        if leg == OFF_PATH or high - low < 2:
            continue
        away = points[low:high] - corners[leg]
        distances.append(float(np.mean(np.linalg.norm(np.cross(away, unit[leg]), axis=1))))
    return float(np.percentile(distances, 75)) if distances else 0.0


def share_of_spikes(samples: Samples) -> tuple[float, float]:
    """Share of samples that stand out from their neighbours, and by how much.

    Returns
    -------
    share : float
        A bad sample spoils the second differences of three.
    size : float
        Median of what stands out, m.
    """
    xyz = samples.xyz
    if len(xyz) < 3:
        return 0.0, 0.0
    bend = 0.5 * np.linalg.norm(xyz[2:] - 2.0 * xyz[1:-1] + xyz[:-2], axis=1)
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    far = bend > max(MIN_STANDOUT, 0.25 * float(np.median(step)))
    share = 1.0 - (1.0 - float(np.mean(far))) ** (1.0 / 3.0)
    return share, float(np.median(bend[far])) if far.any() else 0.0


def check_partial(
    samples: Samples, path: NominalPath, pose: RigidTransform, now: float, tolerance: float
) -> None:
    """Look for the reason of a low coverage.

    Parameters
    ----------
    path : NominalPath
        As published.
    pose : RigidTransform
        Tracker to machine, as aligned.
    now : float
        Driven share of the path length.
    tolerance : float
        m.

    Raises
    ------
    InputError
        If the mirror image fits much better, or the rest fits from another place of the tracker.
    """
    if now > MIN_COVERAGE:
        return
    guide, track = MatchingInput.of(path, tolerance), measured_track(samples, tolerance)
    image = match_mirrored(track, guide, tolerance)
    if image is not None and driven_share_of(image, guide, 4 * tolerance) > 0.5 * (1.0 + now):
        raise InputError(f'samples do not follow the path: {MIRRORED_MESSAGE}')
    whole = cut_track(track, pose, guide.cuts, 2 * tolerance)
    _check_far_step(samples, assign_legs(pose, whole, guide.vertices, tolerance), guide, tolerance)


def _check_far_step(
    samples: Samples, match: Match, guide: MatchingInput, tolerance: float
) -> None:
    """Raise where what lies off the path before or after some moment fits with another pose."""
    track, on = match.track, match.leg != OFF_PATH
    if not on.any():
        return
    first, last = int(np.argmax(on)), len(on) - int(np.argmax(on[::-1]))
    for rest, moment in ((slice(last, None), last - 1), (slice(0, first), first)):
        if track.lengths[rest].sum() < 0.2 * track.lengths.sum():
            continue
        other = replace(
            track,
            start=track.start[rest],
            stop=track.stop[rest],
            joined=track.joined[rest].copy(),
        )
        other.joined[:1] = False
        again = guide.find(other, tolerance)
        if again is None or again.explained < MIN_SHARE_ON_PATH:
            continue
        middle = np.mean(track.points, axis=0)[None]
        shift = float(np.linalg.norm(again.pose.apply(middle) - match.pose.apply(middle)))
        edge = track.stop[moment] if rest.start else track.start[moment]
        seconds = float(samples.time[track.hops[edge]])
        raise InputError(
            f'tracker or target moved about {seconds:.1f} s after the start by '
            f'{1e3 * shift:.1f} mm: each part of the track follows the path, but both '
            f'together do not; clamp both and record again, or cut the recording there and '
            f'give the parts as two runs'
        )
