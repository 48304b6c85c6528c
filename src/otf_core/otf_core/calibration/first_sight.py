# SPDX-License-Identifier: Apache-2.0
"""First look at a run in progress: where the tracker stands, long before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.layers import PathDistance, driven_part
from otf_core.model.axis_path import PartsTrack
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.alignment import align
from otf_core.tracking.curve_matching import match

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
    distance : float
        Mean distance of the aligned samples from the path, m.
    places : mapping of target to ndarray, shape (3,), m
        Of a machine with rotary axes: where the reflectors sit.
    """

    T_machine_tracker: RigidTransform
    distance: float
    places: Mapping[str, Array] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """One sentence."""
        return (
            f'the tracker is found and the target follows the path: {1e6 * self.distance:.3g} um '
            f'from it on average, nothing compensated'
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
    path : NominalPath
        Or the track of the parts that were driven.
    travelled : float
        Length driven so far, m.

    Raises
    ------
    InputError
        If the samples do not follow the path, or do not yet determine the place of the tracker;
        says why.
    """
    if isinstance(path, PartsTrack):
        matched = match(
            samples.in_order(), path.machine, path.parts, quick=True, in_any_order=False
        )
        distance = float(np.mean([part.distance for part in matched.parts]))
        return _near(FirstSight(matched.T_machine_tracker, distance, matched.places), config)
    beginning = NominalPath(driven_part(path, travelled))
    alignment = align(samples.in_order(), beginning, config)
    if alignment.coverage < MIN_FOLLOWED_SHARE:
        raise InputError(
            f'the target has travelled {travelled:.2f} m and followed only '
            f'{100 * alignment.coverage:.0f} % of the first {beginning.length:.2f} m of the path'
        )
    few = np.unique(np.linspace(0, len(samples) - 1, MAX_SAMPLES).astype(int))
    points = alignment.T_machine_tracker.apply(samples.xyz[few])
    distance = float(np.linalg.norm(PathDistance(path).deviation(points), axis=1).mean())
    return _near(FirstSight(alignment.T_machine_tracker, distance), config)


def _near(sight: FirstSight, config: CalibrationConfig) -> FirstSight:
    """Return what is seen; InputError if that is no target that follows the path."""
    if sight.distance > config.match_tolerance:
        raise InputError(f'the target is {1e3 * sight.distance:.3g} mm from the path on average')
    return sight
