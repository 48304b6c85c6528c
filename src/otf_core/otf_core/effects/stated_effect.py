# SPDX-License-Identifier: Apache-2.0
"""Effects as a calibration states them: taken off its data, their parameters with uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from otf_core.arrays import Array
from otf_core.prediction.calibration_document import StatedEffect

FOUND: Literal['found'] = 'found'
FILE: Literal['file'] = 'file'


@dataclass(frozen=True)
class RemovedEffects:
    """Effects that were taken off, and what the unknowns are uncertain by for them.

    Attributes
    ----------
    of_unknowns : ndarray, shape (full, full), m and rad
        Covariance.
    """

    stated: tuple[StatedEffect, ...]
    of_unknowns: Array
