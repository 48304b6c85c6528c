# SPDX-License-Identifier: Apache-2.0
"""The process that diagnoses one run: its task on standard input, its answer into a pipe.

It does what ``./otf diagnose`` does with the bag of the run. Here and in ``job``, where effects
are taken off, and nowhere else the calibrator meets a simulation: a diagnosis compares the run
with its twin, and is given the twin from here.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from otf_calibrator.diagnosis_task import Failure, Task
from otf_core.diagnosis.diagnose import diagnose
from otf_core.errors import OtfError
from otf_core.reports.diagnosis import BESIDE_TABLES, diagnosis_to_dict, write_diagnosis
from otf_core.sim.twin import twin_recording

SPANS = {
    'solving': (0.0, 0.25),
    'simulating': (0.25, 0.4),
    'diagnosing': (0.4, 0.8),
    'correcting': (0.8, 0.95),
}
"""Begin and end of the stages as shares of the time; then files are written."""
WRITING = 0.95


def perform(task: Task, progress: Callable[[str, float], None]) -> dict[str, Any]:
    """Diagnose a run and write its files.

    Parameters
    ----------
    task : Task
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

    def tell(stage: str, fraction: float) -> None:
        low, high = SPANS.get(stage, (0.0, 0.0))
        progress(stage, low + fraction * (high - low))

    recording = replace(task.recording, name=task.name)
    diagnosis = diagnose([recording], twin_recording, (), task.config, tell)
    progress('writing the report', WRITING)
    write_diagnosis(diagnosis, task.folder, BESIDE_TABLES)
    return diagnosis_to_dict(diagnosis)


def main() -> int:
    """Diagnose the run on standard input; the descriptor of the pipe is the only argument."""
    answer = Connection(int(sys.argv[1]), readable=False)
    task: Task = pickle.load(sys.stdin.buffer)
    try:
        answer.send(perform(task, lambda stage, share: answer.send((stage, share))))
    except OtfError as error:
        answer.send(Failure(error.exit_code, str(error)))
    except BrokenPipeError:
        return 1  # the node is gone
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
