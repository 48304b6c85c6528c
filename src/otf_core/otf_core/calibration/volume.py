# SPDX-License-Identifier: Apache-2.0
"""Errors that a calibration predicts on a grid, with the uncertainty of all its sources."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.model.evaluation import driven_grid
from otf_core.model.kinematics import displacement
from otf_core.model.motions import MOTIONS
from otf_core.model.volume import VolumeErrors
from otf_core.prediction.uncertainty import prediction_uncertainty

COUNT = 5
"""Points per axis."""


def volume_errors(
    result: CalibrationResult, provisional: bool = False, count: int = COUNT
) -> VolumeErrors:
    """Return the errors on a grid of count**3 points over the range of the tables."""
    tables = result.tables
    points = driven_grid(tables, count)
    nodes: dict[str, Array] = {name: tables.motions[name].position for name in MOTIONS}
    u = prediction_uncertainty(tables.machine, nodes, result.covariance, points)
    return VolumeErrors(points, displacement(tables, points), u, provisional)


def motion_sizes(result: CalibrationResult) -> dict[str, tuple[float, float]]:
    """Return of every motion the largest absolute error and the largest u of a node, m or rad.

    u is NaN where the samples do not determine the motion.
    """
    sizes: dict[str, tuple[float, float]] = {}
    for name in MOTIONS:
        table = result.tables.motions[name]
        seen = table.u if table.node_identifiable is None else table.u[table.node_identifiable]
        known = table.identifiable and len(seen) > 0
        u = float(seen.max()) if known else float('nan')
        sizes[name] = float(np.abs(table.value).max()), u
    return sizes
