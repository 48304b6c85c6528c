# SPDX-License-Identifier: Apache-2.0
"""A run in progress as its viewers know it, and as plain data for a page."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.live.layers import Track, driven_part, enlargement, size_of, thin
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.model.path import NominalPath

# A run under way as its viewers know it: what was driven, what is known so far, its numbers.

RATE_OVER = 2.0
"""s; over so long the rate of samples is the mean."""
DRIVING = 'BUFFERING'
"""State of the calibrator while it collects samples."""


@dataclass(frozen=True)
class RunProgress:
    """How far the calibrator is; as ``calibrator/state`` says it.

    Attributes
    ----------
    parts, part : int
        Parts of the path, and that which is driven, from 1; 0 for none.
    target : str
        Reflector in view.
    """

    state: str = ''
    stage: str = ''
    fraction: float = 0.0
    time_left: float = math.nan
    samples: int = 0
    lost: int = 0
    travelled: float = 0.0
    message: str = ''
    parts: int = 0
    part: int = 0
    target: str = ''


@dataclass(frozen=True)
class LiveSolution:
    """What samples say of machine and set-up.

    Attributes
    ----------
    ok : bool
        Solved, and no quality gate failed.
    mae_before, mae_after, residual_rms : float
        m; distance from the path.
    motions : mapping of EXX ... ECZ to (largest absolute error, largest u of a node), m or rad
        u is NaN where the samples do not determine the motion.
    squareness : mapping of C0Y, B0Z, A0Z to (value, u), rad
    location : mapping of X0C, A0C ... to (value, u), m or rad
        Of rotary axes.
    """

    ok: bool
    message: str
    mae_before: float = 0.0
    mae_after: float = 0.0
    residual_rms: float = 0.0
    motions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    squareness: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    location: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def left(self) -> float:
        """Mean distance from the path that compensation leaves, m; NaN if nothing is solved."""
        return self.mae_after if self.motions else math.nan


class LiveRun:
    """Takes what the nodes say, in any order.

    Attributes
    ----------
    pose : RigidTransform or None
        Of the tracker in the machine frame, as this run shows it.
    rate : float
        Samples per second as they arrive, Hz; NaN as long as it is not known.
    """

    def __init__(self) -> None:
        self.path: NominalPath | None = None
        self.pose: RigidTransform | None = None
        self.track = Track()
        self.progress = RunProgress()
        self.solved: LiveSolution | None = None
        self.volume: VolumeErrors | None = None
        self.rate = math.nan
        self._counted: deque[tuple[float, int]] = deque()

    @property
    def collecting(self) -> bool:
        """Whether samples are being taken."""
        return self.progress.state == DRIVING and self.progress.samples > 0

    def set_path(self, path: NominalPath) -> None:
        """Take the nominal path."""
        self.path = path
        self.track.set_path(path)

    def set_progress(self, progress: RunProgress, now: float) -> None:
        """Take the state of the calibrator, at a time in s; fewer samples are another run's."""
        if progress.samples < self.progress.samples:
            self._begin()
        self.progress = progress
        self._counted.append((now, progress.samples))
        while len(self._counted) > 2 and now - self._counted[1][0] >= RATE_OVER:
            self._counted.popleft()
        began, count = self._counted[0]
        if now > began:
            self.rate = (progress.samples - count) / (now - began)

    def set_pose(self, pose: RigidTransform) -> None:
        """Take the place of the tracker."""
        self.pose = pose
        self.track.set_pose(pose)

    def _begin(self) -> None:
        self.track.clear()
        self.track.set_pose(None)
        self._counted.clear()
        self.pose, self.solved, self.rate = None, None, math.nan


# A run under way as plain data for a page: what stays (scene) and what moves (now).

UM = 1e6
PAGE_POINTS = 1500
"""Points of a path in a page."""


def scene(run: LiveRun) -> dict[str, Any]:
    """Return path, errors on the grid and what is solved; lengths in m, errors in um and urad."""
    data: dict[str, Any] = {'path': None, 'volume': None, 'solved': None}
    if run.path is not None:
        data['path'] = _rounded(thin(run.path.points, PAGE_POINTS), 5)
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
        'parts': progress.parts,
        'part': progress.part,
        'target_name': progress.target,
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
        data['driven'] = _rounded(thin(driven_part(run.path, progress.travelled), PAGE_POINTS), 5)
        data['scale'] = enlargement(deviations, size_of(run.path))
    return data


def _solved(solved: LiveSolution) -> dict[str, Any]:
    micro = {
        name: [_number(UM * value), _number(UM * u)]
        for names in (solved.motions, solved.squareness, solved.location)
        for name, (value, u) in names.items()
    }
    return {
        'ok': solved.ok,
        'message': solved.message,
        'mae_before_um': UM * solved.mae_before,
        'mae_after_um': _number(UM * solved.left),
        'residual_rms_um': UM * solved.residual_rms,
        'motions': {name: micro[name] for name in solved.motions},
        'squareness': {name: micro[name] for name in solved.squareness},
        'location': {name: micro[name] for name in solved.location},
        'warnings': list(solved.warnings),
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _rounded(values: Array, digits: int) -> list[Any]:
    rounded: list[Any] = np.round(values, digits).tolist()
    return rounded
