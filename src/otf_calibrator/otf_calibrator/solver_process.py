# SPDX-License-Identifier: Apache-2.0
"""The process that calibrates for the node: one task after another from a pipe, answers into it.

Here, in ``diagnosis_process`` and nowhere else the calibrator meets a simulation: where effects
are looked for and taken off, the run is compared with its twin, and is given the twin from here.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection

from otf_calibrator.solver_task import Solved, Task
from otf_core.calibration.calibrate import calibrate_runs
from otf_core.diagnosis.diagnose import NONE, calibrate_with_effects
from otf_core.errors import OtfError
from otf_core.memory import give_back, seldom_look_for_cycles
from otf_core.pieces.methods import PREPARATIONS
from otf_core.sim.twin import twin_recording


def perform(task: Task, progress: Callable[[str, float], None]) -> Solved:
    """Calibrate a run; OtfError if it cannot be."""
    runs = [task.recording]
    if task.effects != NONE:
        return calibrate_with_effects(
            runs, task.effects, twin_recording, task.config, progress, task.method
        )
    return calibrate_runs(runs, task.config, progress, PREPARATIONS[task.method])


def main() -> int:
    """Perform tasks until the node is gone; the descriptor of the pipe is the only argument."""
    seldom_look_for_cycles()
    node = Connection(int(sys.argv[1]))
    answer: Solved | OtfError
    try:
        while True:
            task: Task = node.recv()
            try:
                answer = perform(task, lambda stage, share: node.send((stage, share)))
            except OtfError as error:
                answer = error
            node.send(answer)
            del task, answer  # the next one may be hours away
            gc.collect()
            give_back()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return 0


if __name__ == '__main__':
    raise SystemExit(main())
