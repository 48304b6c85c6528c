# SPDX-License-Identifier: Apache-2.0
"""A run under way as plain data for a page: what stays (scene) and what moves (now)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.live.layers import driven_part, enlargement, size_of, thinned
from otf_core.live.run import LiveRun, Solved

UM = 1e6
PAGE_POINTS = 1500
"""Points of a path in a page."""


def scene(run: LiveRun) -> dict[str, Any]:
    """Return path, errors on the grid and what is solved; lengths in m, errors in um and urad."""
    data: dict[str, Any] = {'path': None, 'volume': None, 'solved': None}
    if run.path is not None:
        data['path'] = _rounded(thinned(run.path.points, PAGE_POINTS), 5)
    volume = run.volume
    if volume is not None and run.path is not None:
        data['volume'] = {
            'points': _rounded(volume.points, 5),
            'errors_um': _rounded(UM * volume.errors, 3),
            'scale': enlargement(volume.errors, size_of(run.path)),
            'mean_um': UM * volume.mean,
            'provisional': volume.provisional,
        }
    if run.solved:
        data['solved'] = _solved(run.solved)
    return data


def now(run: LiveRun) -> dict[str, Any]:
    """Return state, progress, target, tracker and deviations; lengths in m, deviations in um."""
    progress, track = run.progress, run.track
    places, deviations = track.deviations()
    data: dict[str, Any] = {
        'state': progress.state,
        'stage': progress.stage,
        'fraction': progress.fraction,
        'time_left': _number(progress.time_left),
        'message': progress.message,
        'samples': progress.samples,
        'lost': progress.lost,
        'rate': _number(run.rate),
        'travelled': progress.travelled,
        'length': run.path.length if run.path else None,
        'distance_um': _number(UM * track.distance),
        'tracker': _rounded(run.pose.translation, 5) if run.pose else None,
        'target': None if track.position is None else _rounded(track.position, 5),
        'driven': None,
        'places': _rounded(places, 5),
        'deviations_um': _rounded(UM * deviations, 2),
        'scale': 1.0,
    }
    if run.path is not None:
        data['driven'] = _rounded(
            thinned(driven_part(run.path, progress.travelled), PAGE_POINTS), 5
        )
        data['scale'] = enlargement(deviations, size_of(run.path))
    return data


def _solved(solved: Solved) -> dict[str, Any]:
    micro = {
        name: [_number(UM * value), _number(UM * u)]
        for name, (value, u) in {**solved.motions, **solved.squareness}.items()
    }
    return {
        'provisional': solved.provisional,
        'ok': solved.ok,
        'message': solved.message,
        'mae_before_um': UM * solved.mae_before,
        'mae_after_um': _number(UM * solved.left),
        'residual_rms_um': UM * solved.residual_rms,
        'motions': {name: micro[name] for name in solved.motions},
        'squareness': {name: micro[name] for name in solved.squareness},
        'warnings': list(solved.warnings),
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _rounded(values: Array, digits: int) -> list[Any]:
    found: list[Any] = np.round(values, digits).tolist()
    return found
