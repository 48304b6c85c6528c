# SPDX-License-Identifier: Apache-2.0
"""First look at a run in progress: tracker pose, and which of two published paths it follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.layers import PathDistance, driven_part
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.alignment import align

MAX_SAMPLES = 500
"""Samples, evenly spread, whose distance from the path is evaluated."""
MIN_FOLLOWED_SHARE = 0.8
"""Share of the path driven so far that the track has to follow."""
MIN_LEGS = 3
"""Legs that have to be driven: fewer do not fix a tracker."""


@dataclass(frozen=True)
class FirstSight:
    """What the samples of a part of a run show.

    Attributes
    ----------
    share : float
        Of the length of the path, driven so far.
    distance : float
        Mean distance of the aligned samples from the path, m.
    """

    T_machine_tracker: RigidTransform
    samples: int
    share: float
    distance: float

    @property
    def words(self) -> str:
        """One sentence."""
        return (
            f'the tracker is found and the target follows the path; provisional, of the first '
            f'{100 * self.share:.0f} % of the path: {1e6 * self.distance:.3g} um from it on '
            f'average, nothing compensated yet; errors come after the first lap'
        )


def first_legs(path: NominalPath) -> float:
    """Length of the legs of a path without which nothing is seen, m."""
    last = path.corners()[1][: MIN_LEGS + 1][-1]
    return float(path.leg_lengths[:last].sum())


def first_sight(
    samples: Samples, path: NominalPath, travelled: float, config: CalibrationConfig
) -> FirstSight:
    """Align what was driven so far with the beginning of the path.

    With the whole path it could not be: parts of a path often repeat elsewhere in the volume.

    Parameters
    ----------
    samples : Samples
        May be in the order of their arrival.
    travelled : float
        Length driven so far, m.

    Raises
    ------
    InputError
        If the samples do not follow the path, or do not yet determine the place of the tracker;
        says why.
    """
    beginning = NominalPath(driven_part(path, travelled))
    alignment = align(samples.in_order(), beginning, config)
    if alignment.coverage < MIN_FOLLOWED_SHARE:
        raise InputError(
            f'the target has travelled {travelled:.2f} m and followed only '
            f'{100 * alignment.coverage:.0f} % of the first {beginning.length:.2f} m of the path'
        )
    few = np.unique(np.linspace(0, len(samples) - 1, MAX_SAMPLES).astype(int))
    points = alignment.T_machine_tracker.apply(samples.xyz[few])
    away = np.linalg.norm(PathDistance(path).deviation(points), axis=1)
    share = min(1.0, travelled / path.length)
    return FirstSight(alignment.T_machine_tracker, len(samples), share, float(away.mean()))


MAX_DISTANCE = 5e-3
"""m; a target that is nearer to a path than this follows it: far above the errors of a machine,
and about what the rounding of corners takes off."""


@dataclass(frozen=True)
class TwoPaths:
    """A run along one path, and another path that was published meanwhile.

    Attributes
    ----------
    samples : Samples
        Of the run, in the order of their arrival.
    since : int
        Samples that had come when the other path was published.
    travelled, travelled_since : float
        Length that the target has travelled in the run, and since the other path came, m.
    """

    samples: Samples
    since: int
    present: NominalPath
    other: NominalPath
    travelled: float
    travelled_since: float


def follows_the_other(run: TwoPaths, config: CalibrationConfig) -> bool:
    """Return whether the target has left the present path and follows the other one.

    False as long as too little is driven to determine that; the present path is kept then.
    """
    newer = run.samples.part(run.since, len(run.samples))
    try:
        first_sight(newer, run.other, run.travelled_since, config)
    except InputError:
        return False
    return not _on_the_present(run, newer, config)


def _on_the_present(run: TwoPaths, newer: Samples, config: CalibrationConfig) -> bool:
    """Return whether what came since lies on the present path, the tracker standing still."""
    beginning = NominalPath(driven_part(run.present, run.travelled))
    try:
        alignment = align(run.samples.in_order(), beginning, config)
    except InputError:
        return False
    if alignment.coverage < MIN_FOLLOWED_SHARE:
        return False
    few = np.unique(np.linspace(0, len(newer) - 1, MAX_SAMPLES).astype(int))
    points = alignment.T_machine_tracker.apply(newer.xyz[few])
    away = np.linalg.norm(PathDistance(run.present).deviation(points), axis=1)
    return float(np.mean(away < MAX_DISTANCE)) >= MIN_FOLLOWED_SHARE
