# SPDX-License-Identifier: Apache-2.0
"""A run under way in a few numbers, for plots over time."""

from __future__ import annotations

from otf_core.live.run import LiveRun

NUMBERS = {
    'distance_from_path': 'm; of the newest sample, once the place of the tracker is known',
    'sample_rate': 'Hz; as samples arrive at the calibrator',
    'samples': 'so far',
    'samples_lost': 'published and not arrived, those that may be on their way not counted',
    'progress': '0 to 1; of driving, or of the calibration under way',
    'time_left': 's; estimated',
    'residual': 'm; mean distance from the path that compensation leaves, as solved so far',
}
"""Names with their units and meaning."""


def numbers(run: LiveRun) -> dict[str, float]:
    """Return the present value of each of NUMBERS; NaN where it is not known."""
    return {
        'distance_from_path': run.track.distance,
        'sample_rate': run.rate,
        'samples': float(run.progress.samples),
        'samples_lost': float(run.progress.lost),
        'progress': run.progress.fraction,
        'time_left': run.progress.time_left,
        'residual': float('nan') if run.solved is None else run.solved.left,
    }
