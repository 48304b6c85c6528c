# SPDX-License-Identifier: Apache-2.0
"""Why samples do not follow a path, as far as their shapes tell."""

from __future__ import annotations

import numpy as np

from otf_core.guide import Guide
from otf_core.observation import Samples
from otf_core.path import NominalPath
from otf_core.track import Track, measured_track

WIDER = (2.5, 5.0, 10.0)
"""Multiples of the tolerance that are tried to say what is wrong."""
MIRRORED = 'the track fits only mirrored: are the tracker coordinates left-handed?'


def _wider(samples: Samples, path: NominalPath, tolerance: float) -> float | None:
    """Tolerance within which the track would fit the path, m; None if none of ``WIDER`` does."""
    for factor in WIDER:
        track = measured_track(samples, factor * tolerance)
        match = Guide.of(path, factor * tolerance).find(track, factor * tolerance, by_length=False)
        if match is not None and match.explained > 0.8:
            return factor * tolerance
    return None


def mirrored(track: Track, guide: Guide, tolerance: float) -> float:
    """Share of the measured length that follows the path if it is mirrored."""
    image = Track(
        track.hops, track.points * [-1.0, 1.0, 1.0], track.start, track.stop, track.joined
    )
    match = guide.find(image, tolerance)
    return 0.0 if match is None else match.explained


def complaint(samples: Samples, track: Track, path: NominalPath, tolerance: float) -> str:
    """Say why nothing fits, as far as the shapes tell.

    Parameters
    ----------
    samples : Samples
    track : Track
        Measured with ``tolerance``, m.
    path : NominalPath
    tolerance : float
        m.
    """
    corners = path.corners()[0]
    ratio = np.ptp(track.points, axis=0).max() / np.ptp(corners, axis=0).max()
    if not 0.3 < ratio < 3:
        factor = 1000.0 if ratio > 1 else 0.001
        unit = (
            f'; are the points in {"mm" if ratio > 1 else "km"}?'
            if 0.5 < ratio / factor < 2
            else ''
        )
        return f'the measured track is {ratio:.3g} times as large as the path{unit}'
    if mirrored(track, Guide.of(path, tolerance), tolerance) > 0.8:
        return MIRRORED
    enough = _wider(samples, path, tolerance)
    if enough is not None:
        return (
            f'it does within {1e3 * enough:g} mm, but match_tolerance is {1e3 * tolerance:g} mm. '
            f'If the machine rounds its corners that much, raise match_tolerance to {enough:g} '
            f'(m) and corner_exclusion to the length that is rounded, about {3 * enough:g}'
        )
    return (
        f'no run of measured corners fits the path within match_tolerance '
        f'({1e3 * tolerance:g} mm): do bag and path belong together?'
    )
