# SPDX-License-Identifier: Apache-2.0
"""What the process that calibrates is given, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.calibration.with_effects import EffectsCalibration
from otf_core.config import CalibrationConfig
from otf_core.pieces.runs import Recording

Solved = CalibrationResult | EffectsCalibration


@dataclass(frozen=True)
class Task:
    """A run to be calibrated; ``method`` and ``effects`` as the parameters of the node."""

    recording: Recording
    config: CalibrationConfig
    method: str
    effects: str
