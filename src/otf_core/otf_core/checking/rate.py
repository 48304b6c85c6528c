# SPDX-License-Identifier: Apache-2.0
"""How often the tracker measured, and how far the target moved from one sample to the next."""

from __future__ import annotations

import numpy as np

from otf_core.checking.checked import Check, Checked, warnings
from otf_core.checking.seen import Seen

PER_PIECE = 2.0
"""Samples of a path piece at the top feed that are wanted at least."""
FAST = 99.0
"""Percentile of the steps that is taken for the top feed."""


def _ask(seen: Seen) -> Checked:
    samples = seen.samples
    if samples is None or len(samples) < 2:
        return Checked(facts={'rate_hz': 0.0, 'duration_s': 0.0})
    rate = 1.0 / samples.step
    apart = np.linalg.norm(np.diff(samples.xyz, axis=0), axis=1)
    usual = np.diff(samples.stamp_ns) < 1.5 * samples.step_ns
    spacing = float(np.percentile(apart[usual], FAST)) if usual.any() else 0.0
    coarse, enough = '', seen.config.piece_length / PER_PIECE
    if spacing > enough:
        coarse = (
            f'samples lie {1e3 * spacing:.1f} mm apart at the top feed, above '
            f'{1e3 * enough:g} mm: raise the rate of the tracker or drive slower'
        )
    duration = float(samples.time[-1])
    return Checked(
        f'{rate:.1f} Hz over {duration:.1f} s, a sample every {1e3 * spacing:.2f} mm at the top '
        f'feed',
        {'rate_hz': rate, 'duration_s': duration, 'spacing_mm': 1e3 * spacing},
        warnings(coarse),
    )


RATE = Check('rate', _ask)
