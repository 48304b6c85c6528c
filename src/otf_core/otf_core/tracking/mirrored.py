# SPDX-License-Identifier: Apache-2.0
"""Why samples do not follow a path, as far as their shapes tell."""

from __future__ import annotations

from otf_core.tracking.guide import Guide
from otf_core.tracking.track import Track


def mirrored(track: Track, guide: Guide, tolerance: float) -> float:
    """Share of the measured length that follows the path if it is mirrored."""
    image = Track(
        track.hops, track.points * [-1.0, 1.0, 1.0], track.start, track.stop, track.joined
    )
    match = guide.find(image, tolerance)
    return 0.0 if match is None else match.explained
