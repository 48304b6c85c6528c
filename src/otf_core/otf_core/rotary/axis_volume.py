# SPDX-License-Identifier: Apache-2.0
"""Errors of the target over all axes of a machine with rotary axes, on a grid, to be shown."""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.model.joints import Sight
from otf_core.model.kinematics import displacement
from otf_core.model.machine import SPINDLE, TABLE, TOOL
from otf_core.model.volume import VolumeErrors
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.rotary.axis_calibration import AxisCalibration

LINEAR, ROTARY = 3, 4
"""Positions of every linear and of every rotary axis."""


def volume_errors(result: AxisCalibration, provisional: bool = False) -> VolumeErrors:
    """Return the errors on a grid over the driven ranges of all axes, frame of the table."""
    machine, (low, high) = result.machine, result.driven
    ends = [_places(result, k, float(low[k]), float(high[k])) for k in range(len(low))]
    q = np.stack([mesh.ravel() for mesh in np.meshgrid(*ends, indexing='ij')], axis=1)
    place = np.array(machine.targets[TOOL].place)
    points = Sight(machine, TABLE, SPINDLE, place).nominal(q)
    nodes: dict[str, Array] = {m: result.tables.motions[m].position for m in machine.motions}
    u = prediction_uncertainty(machine, nodes, result.made.covariance, q)
    errors = displacement(result.tables, q)
    return VolumeErrors(points, errors, u, provisional, machine.axis_names, q)


def _places(result: AxisCalibration, column: int, low: float, high: float) -> Array:
    """Positions of one axis: one if it was not driven, no full turn twice."""
    if high - low <= 0.0:
        return np.array([low])
    axis = result.machine.axes[result.machine.axis_names[column]]
    count = ROTARY if axis.rotary else LINEAR
    return np.linspace(low, high, count, endpoint=not axis.endless)
