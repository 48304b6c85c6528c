# SPDX-License-Identifier: Apache-2.0
"""Where the beam was broken: points in the origin of the tracker, gaps while the target moved."""

from __future__ import annotations

import numpy as np

from otf_core.checking.checked import Check, Checked
from otf_core.checking.seen import Seen
from otf_core.tracking.track import HOP, broken


def _ask(seen: Seen) -> Checked:
    if seen.received is None or seen.samples is None:
        return Checked()
    lost = int(np.count_nonzero(~seen.received.xyz.any(axis=1)))
    samples = seen.samples
    at = np.flatnonzero(broken(samples))
    moved = np.linalg.norm(samples.xyz[at + 1] - samples.xyz[at], axis=1) > HOP
    breaks = int(np.count_nonzero(moved))
    reach = np.linalg.norm(samples.xyz, axis=1)
    words = f'{breaks} breaks while the target moved' if breaks else 'never broken in motion'
    origin = f', {lost} points in the origin of the tracker' if lost else ''
    return Checked(
        f'{words}{origin}; {reach.min():.2f} to {reach.max():.2f} m long',
        {
            'beam_breaks': breaks,
            'without_beam': lost,
            'beam_m': [float(reach.min()), float(reach.max())],
        },
    )


BEAM = Check('beam', _ask)
