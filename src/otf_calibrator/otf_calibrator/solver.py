# SPDX-License-Identifier: Apache-2.0
"""Calibrations in a process of their own: no sample waits for them, and they for no sample.

The process may copy itself (``otf_core.aside``), which that of a node must not, and can be ended
at once. It is begun as soon as a run is looked at, so it is there when the run ends.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from otf_calibrator.solver_task import Solved, Task
from otf_core.errors import OtfError
from otf_core.live.stages import Progress

MODULE = 'otf_calibrator.solver_process'
LOOK = 0.05
"""s; so often it is asked whether the calibration is still wanted."""


class Solver:
    """Performs one task at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._end: Connection | None = None

    def warm_up(self) -> None:
        """Start the process if there is none, as a calibration is to be expected."""
        with suppress(OtfError):  # told when there is something to calibrate
            self._begin()

    def _begin(self) -> None:
        """Start the process if there is none; OtfError if the system does not let it."""
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._leave()
            self._end, end = Pipe()
            words = [sys.executable, '-m', MODULE, str(end.fileno())]
            with end:
                try:
                    self._process = subprocess.Popen(
                        words,
                        stdin=subprocess.DEVNULL,
                        pass_fds=[end.fileno()],
                        start_new_session=True,  # Ctrl-C reaches the node only, which ends both
                    )
                except OSError as error:
                    raise OtfError(f'the calibration cannot be started: {error}') from None

    def solve(self, task: Task, progress: Progress) -> Solved:
        """Calibrate a run.

        Parameters
        ----------
        progress : callable(stage, fraction)
            Called again and again; what it raises ends the work.

        Raises
        ------
        OtfError
            As ``calibrate_runs``; or if the process was ended.
        """
        self._begin()
        assert self._end is not None and self._process is not None, 'just begun'
        said = ('aligning', 0.0)
        try:
            self._end.send(task)
            while True:
                progress(*said)
                if not self._end.poll(LOOK):
                    continue
                answer = self._end.recv()
                if not isinstance(answer, tuple):
                    break
                said = answer
        except (EOFError, OSError):
            raise _ended(self._process.wait()) from None
        except OtfError:
            self.close()  # whatever it was at
            raise
        if isinstance(answer, OtfError):
            raise answer
        return answer

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._lock:
            self._leave()

    def _leave(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        if self._end is not None:
            self._end.close()
            self._end = None


def _ended(code: int) -> OtfError:
    """What is said of a process that has ended on its own."""
    if code >= 0:  # the traceback is on standard error
        return OtfError(f'internal error: the calibration ended, code {code}')
    return OtfError(
        f'the calibration was ended by the system (signal {-code}), as it is when memory is '
        f'short; the samples stay: call calibrator/calibrate to try again'
    )
