# SPDX-License-Identifier: Apache-2.0
"""What a child of the calibrator does: it calibrates for the node, or diagnoses one run.

Here and nowhere else the calibrator meets a simulation: a diagnosis, and the search for effects,
compare a run with its twin, which is handed to them here.
"""

from __future__ import annotations

import shutil
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from otf_calibrator.worker import serve
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import NONE, CalibrationConfig
from otf_core.diagnosis.diagnose import calibrate_with_effects, diagnose
from otf_core.live.stages import DIAGNOSE, Progress, of_whole
from otf_core.pieces.runs import Recording
from otf_core.reports.diagnosis import BESIDE_TABLES, write_diagnosis


def calibrate(
    recording: Recording, config: CalibrationConfig, method: str, effects: str, progress: Progress
) -> CalibrationResult:
    """Calibrate a run; OtfError if that is not possible."""
    if effects != NONE:
        return calibrate_with_effects([recording], effects, config, progress, method)
    return calibrate_recordings([recording], config, progress, method)


def diagnose_run(
    recording: Recording, config: CalibrationConfig, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Diagnose a run as ``./otf diagnose`` does, write its files, return what gap.json holds.

    Raises
    ------
    OtfError
        If the run cannot be diagnosed or a file cannot be written.
    """
    stages = of_whole(DIAGNOSE, progress)
    try:
        diagnosis = diagnose([recording], (), config, stages)
        stages('writing', 0.0)
    except (BrokenPipeError, ConnectionResetError):  # the node is gone, which would remove it
        shutil.rmtree(folder, ignore_errors=True)
        raise
    write_diagnosis(diagnosis, folder, BESIDE_TABLES)
    return diagnosis.document.to_dict()


if __name__ == '__main__':
    serve(Connection(int(sys.argv[1])), {'calibrate': calibrate, 'diagnose': diagnose_run})
