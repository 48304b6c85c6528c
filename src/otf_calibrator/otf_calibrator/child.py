# SPDX-License-Identifier: Apache-2.0
"""What a child of the calibrator does: it calibrates for the node, or diagnoses one run.

Here and nowhere else the calibrator meets a simulation: a diagnosis, and the search for effects,
compare a run with its twin, which is handed to them here.
"""

from __future__ import annotations

import gc
import pickle
import shutil
import sys
import traceback
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from otf_calibrator.children import (
    CalibrationTask,
    ChildError,
    DiagnosisTask,
    Failure,
    internal_error,
)
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import NONE
from otf_core.diagnosis.diagnose import calibrate_with_effects, diagnose
from otf_core.errors import OtfError
from otf_core.live.stages import DIAGNOSE, Progress, of_whole
from otf_core.reports.diagnosis import BESIDE_TABLES, diagnosis_to_dict, write_diagnosis
from otf_core.sim.twin import twin_recording


def _calibrate(task: CalibrationTask, progress: Progress) -> CalibrationResult:
    """Calibrate a run; OtfError if that is not possible."""
    runs = [task.recording]
    if task.effects != NONE:
        return calibrate_with_effects(
            runs, task.effects, twin_recording, task.config, progress, task.method
        )
    return calibrate_recordings(runs, task.config, progress, task.method)


def _diagnose(task: DiagnosisTask, progress: Progress) -> dict[str, Any]:
    """Diagnose a run as ``./otf diagnose`` does, write its files, return what gap.json holds.

    Raises
    ------
    OtfError
        If the run cannot be diagnosed or a file cannot be written.
    """
    stages = of_whole(DIAGNOSE, progress)
    recording = replace(task.recording, name=task.name)
    diagnosis = diagnose([recording], twin_recording, (), task.config, stages)
    stages('writing', 0.0)
    write_diagnosis(diagnosis, task.folder, BESIDE_TABLES)
    return diagnosis_to_dict(diagnosis)


def _serve_calibrations(node: Connection) -> int:
    """Perform tasks until the node is gone."""
    answer: CalibrationResult | OtfError | ChildError
    try:
        while True:
            task: CalibrationTask = node.recv()
            try:
                answer = _calibrate(task, lambda stage, share: node.send((stage, share)))
            except OtfError as error:
                answer = error
            except (BrokenPipeError, ConnectionResetError):
                raise
            except Exception:  # noqa: BLE001 - a defect, which the node reports
                answer = ChildError(traceback.format_exc())
            node.send(answer)
            del task, answer  # the next one may be hours away
            gc.collect()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return 0


def _perform_diagnosis(node: Connection) -> int:
    """Diagnose the run on standard input."""
    task: DiagnosisTask = pickle.load(sys.stdin.buffer)
    try:
        try:
            node.send(_diagnose(task, lambda stage, share: node.send((stage, share))))
        except OtfError as error:
            node.send(Failure(error.exit_code, str(error)))
        except BrokenPipeError:
            raise
        except Exception as error:  # noqa: BLE001 - the same
            node.send(Failure(1, internal_error(error), traceback.format_exc()))
    except BrokenPipeError:  # the node is gone, which would remove it
        shutil.rmtree(task.folder, ignore_errors=True)
        return 1
    return 0


def main() -> int:
    """Run a child: ``calibrate`` or ``diagnose``, and the descriptor of its end of the pipe."""
    gc.set_threshold(1_000_000)  # looking for cycles takes a twelfth of the time otherwise
    work, end = sys.argv[1], int(sys.argv[2])
    if work == 'diagnose':
        return _perform_diagnosis(Connection(end, readable=False))
    return _serve_calibrations(Connection(end))


if __name__ == '__main__':
    raise SystemExit(main())
