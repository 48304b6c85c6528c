# SPDX-License-Identifier: Apache-2.0
"""The process that diagnoses one run: its task on standard input, its answer into a pipe.

It does what ``./otf diagnose`` does with the bag of the run. Here and in ``job``, where effects
are taken off, and nowhere else the calibrator meets a simulation: a diagnosis compares the run
with its twin, and is given the twin from here.
"""

from __future__ import annotations

import pickle
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from otf_calibrator.diagnosis_task import Failure, Task
from otf_core.diagnosis.diagnose import diagnose
from otf_core.errors import OtfError
from otf_core.live.stages import DIAGNOSE, of_whole
from otf_core.memory import seldom_look_for_cycles
from otf_core.reports.diagnosis import BESIDE_TABLES, diagnosis_to_dict, write_diagnosis
from otf_core.sim.twin import twin_recording


def perform(task: Task, progress: Callable[[str, float], None]) -> dict[str, Any]:
    """Diagnose a run and write its files.

    Parameters
    ----------
    progress : callable
        Takes what is being done, and the share of the whole that is done.

    Returns
    -------
    dict
        What gap.json holds.

    Raises
    ------
    OtfError
        If the run cannot be diagnosed or a file cannot be written.
    """
    tell = of_whole(DIAGNOSE, progress)
    recording = replace(task.recording, name=task.name)
    diagnosis = diagnose([recording], twin_recording, (), task.config, tell)
    tell('writing', 0.0)
    write_diagnosis(diagnosis, task.folder, BESIDE_TABLES)
    return diagnosis_to_dict(diagnosis)


def main() -> int:
    """Diagnose the run on standard input; the descriptor of the pipe is the only argument."""
    seldom_look_for_cycles()
    answer = Connection(int(sys.argv[1]), readable=False)
    task: Task = pickle.load(sys.stdin.buffer)
    try:
        try:
            answer.send(perform(task, lambda stage, share: answer.send((stage, share))))
        except OtfError as error:
            answer.send(Failure(error.exit_code, str(error)))
    except BrokenPipeError:  # the node is gone, which would remove it
        shutil.rmtree(task.folder, ignore_errors=True)
        return 1
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
