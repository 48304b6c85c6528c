# SPDX-License-Identifier: Apache-2.0
"""How every method of calibration prepares recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.pieces.runs import Recording, Run, prepare_runs
from otf_core.pieces.standstill_method import prepare_stops

Preparation = Callable[
    [Sequence[Recording], CalibrationConfig], tuple[list[Run], dict[str, NDArray[np.float64]]]
]
"""From recordings to runs reduced to pieces, and the table nodes."""
PREPARATIONS: Mapping[str, Preparation] = {OTF: prepare_runs, STANDSTILL: prepare_stops}
