# SPDX-License-Identifier: Apache-2.0
"""Which of two paths a run follows, where another one was published while it was driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.calibration.first_sight import ASKED, FOLLOWED, first_sight
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.layers import PathDistance, driven_part
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.alignment import align

NEAR = 5e-3
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
    present, other : NominalPath
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
    """Tell whether the target has left the present path and follows the other one.

    False as long as too little is driven to determine that; the present path is kept then.
    """
    newer = run.samples.part(run.since, len(run.samples))
    try:
        first_sight(newer, run.other, run.travelled_since, config)
    except InputError:
        return False
    return not _on_the_present(run, newer, config)


def _on_the_present(run: TwoPaths, newer: Samples, config: CalibrationConfig) -> bool:
    """Tell whether what came since lies on the present path, the tracker standing still."""
    beginning = NominalPath(driven_part(run.present, run.travelled))
    try:
        found = align(run.samples.in_order(), beginning, config)
    except InputError:
        return False
    if found.coverage < FOLLOWED:
        return False
    few = np.unique(np.linspace(0, len(newer) - 1, ASKED).astype(int))
    points = found.T_machine_tracker.apply(newer.xyz[few])
    away = np.linalg.norm(PathDistance(run.present).deviation(points), axis=1)
    return float(np.mean(away < NEAR)) >= FOLLOWED
