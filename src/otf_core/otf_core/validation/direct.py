# SPDX-License-Identifier: Apache-2.0
"""Comparison with a direct instrument (paper 2.3), here a simulated one."""

from __future__ import annotations

import numpy as np

from otf_core.calibration.result import CalibrationResult
from otf_core.comparison.compare import (
    Comparison,
    compare,
    source_of_measurement,
    source_of_tables,
)
from otf_core.model.motions import ErrorMotion
from otf_core.model.tables import ErrorTables
from otf_core.validation.laboratory import Laboratory


def direct_test(
    laboratory: Laboratory, truth: ErrorTables, result: CalibrationResult, seed: int
) -> Comparison:
    """Compare a calibration on the fly with a direct measurement of the same machine."""
    measurement = laboratory.measure_directly(truth, seed)
    return compare(
        source_of_measurement('direct instrument (simulated)', measurement, truth.machine),
        source_of_tables('on the fly', result.tables, result.covariance),
    )


def largest_differences(comparison: Comparison) -> tuple[float, float, float]:
    """Largest difference of positioning (m), straightness (m) and rotations (rad)."""
    groups: tuple[list[float], list[float], list[float]] = ([], [], [])
    for symbol, motion in comparison.motions.items():
        name = ErrorMotion.of(symbol)
        group = 0 if name.is_positioning else 1 if name.is_straightness else 2
        groups[group].append(float(np.abs(motion.difference).max()))
    return max(groups[0]), max(groups[1]), max(groups[2])
