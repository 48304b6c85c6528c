# SPDX-License-Identifier: Apache-2.0
"""Calibrations and diagnoses in processes of their own: neither they nor samples wait.

A child may copy itself (``otf_core.aside``), which the process of a node must not, and can be
ended at once, whatever it does. The one that calibrates is started as soon as a run is examined,
so it is there when the run ends; each diagnosis has its own. They send progress, a stage and the
share of it that is done, and then their answer.

What a child does stands in ``child``.
"""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any

from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import CalibrationConfig
from otf_core.errors import OtfError
from otf_core.live.stages import Progress
from otf_core.pieces.runs import Recording

MODULE = 'otf_calibrator.child'
LOOK = 0.05
"""s; interval at which to check that the calibration is still wanted."""
OF_A_CAUSE = ('effects*.yaml', 'calibration_plain', 'calibration_with_effects')
"""What a diagnosis writes only if it names a cause."""


@dataclass(frozen=True)
class CalibrationTask:
    """A run to be calibrated; ``method`` and ``effects`` as the parameters of the node."""

    recording: Recording
    config: CalibrationConfig
    method: str
    effects: str


@dataclass(frozen=True)
class DiagnosisTask:
    """A run to be diagnosed, its name in the report, and where the files go."""

    recording: Recording
    config: CalibrationConfig
    name: str
    folder: Path


@dataclass(frozen=True)
class Failure:
    """Why there is no diagnosis; the code is the exit code of ``./otf diagnose``.

    ``traceback`` is that of a defect.
    """

    exit_code: int
    text: str
    traceback: str = ''


class ChildError(Exception):
    """A defect in a child; the text is its traceback."""


def internal_error(error: BaseException) -> str:
    """A defect in one line; its traceback belongs into the log."""
    text = str(error).strip().splitlines()[-1] if isinstance(error, ChildError) else repr(error)
    return f'internal error: {text}'


Answer = dict[str, Any] | Failure
"""Content of gap.json, or why there is none."""


def _start(
    work: str, end: Connection, stdin: int | IO[bytes] = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a child that calibrates or diagnoses, with its end of the pipe; OSError if not."""
    return subprocess.Popen(
        [sys.executable, '-m', MODULE, work, str(end.fileno())],
        stdin=stdin,
        pass_fds=[end.fileno()],
        start_new_session=True,  # Ctrl-C reaches the node only, which ends both in order
    )


class Solver:
    """Performs one calibration at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._end: Connection | None = None

    def warm_up(self) -> None:
        """Start the process if there is none, as a calibration is to be expected."""
        with suppress(OtfError):  # reported when there is something to calibrate
            self._begin()

    def _begin(self) -> None:
        """Start the process if there is none; OtfError if the system does not let it."""
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._leave()
            self._end, end = Pipe()
            with end:
                try:
                    self._process = _start('calibrate', end)
                except OSError as error:
                    raise OtfError(f'the calibration cannot be started: {error}') from None

    def solve(self, task: CalibrationTask, progress: Progress) -> CalibrationResult:
        """Calibrate a run.

        Parameters
        ----------
        progress : callable(stage, fraction)
            Called again and again; what it raises ends the work.

        Raises
        ------
        OtfError
            As ``calibrate_recordings``; or if the process was ended.
        ChildError
            If it failed for any other reason.
        """
        self._begin()
        assert self._end is not None and self._process is not None, 'just begun'
        stage = ('aligning', 0.0)
        try:
            self._end.send(task)
            while True:
                progress(*stage)
                if not self._end.poll(LOOK):
                    continue
                answer = self._end.recv()
                if not isinstance(answer, tuple):
                    break
                stage = answer
        except (EOFError, OSError):
            raise _ended(self._process.wait()) from None
        except BaseException:  # given up, or no answer that can be read
            self.close()  # whatever it was at
            raise
        if isinstance(answer, OtfError | ChildError):
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
    """Error about a process that has ended on its own."""
    if code >= 0:  # the traceback is on standard error
        return OtfError(f'internal error: the calibration ended, code {code}')
    return OtfError(
        f'the calibration was ended by the system (signal {-code}), as it is when memory is '
        f'short; the samples stay: call calibrator/calibrate to try again'
    )


class Diagnosis:
    """Diagnoses one calibrated run; starts at once, never waits.

    Parameters
    ----------
    folder : Path
        Of its calibration; the files of the diagnosis go there when they are whole.

    Attributes
    ----------
    stage, fraction : str and float
        What is being done, and the share of the whole that is done.

    Raises
    ------
    OSError
        If the process cannot be started.
    """

    def __init__(self, recording: Recording, config: CalibrationConfig, folder: Path) -> None:
        self._folder = folder
        self.stage, self.fraction = 'starting', 0.0
        self._partial = TemporaryDirectory(prefix='.diagnosis-', dir=folder)
        self._answers, answers = Pipe(duplex=False)
        self._answer: Answer | None = None
        task = DiagnosisTask(recording, config, folder.name, Path(self._partial.name))
        with answers, TemporaryFile() as file:
            pickle.dump(task, file)  # into a pipe it would wait until the process has read it
            file.seek(0)
            self._process = _start('diagnose', answers, file)

    def finished(self) -> Answer | None:
        """Take in what the process has sent; return its answer once it has ended."""
        code = self._process.poll()
        while self._answer is None and self._answers.poll():
            try:
                sent = self._answers.recv()
            except EOFError:
                break
            if isinstance(sent, tuple):
                self.stage, self.fraction = sent
            else:
                self._answer = sent
        if code is None:
            return None
        answer = self._answer or Failure(1, f'internal error: the diagnosis ended, code {code}')
        if not isinstance(answer, Failure):
            answer = self._put_in_place(answer)
        self.close()
        return answer

    def close(self) -> None:
        """End the process, whatever it does, and leave nothing half-written."""
        self._process.kill()
        self._process.wait()
        self._answers.close()
        self._partial.cleanup()

    def _put_in_place(self, answer: Answer) -> Answer:
        """Give the files their final names, gap.json last."""
        written = sorted(Path(self._partial.name).iterdir(), key=lambda p: p.name == 'gap.json')
        earlier = [p for pattern in OF_A_CAUSE for p in self._folder.glob(pattern)]
        try:
            for path in earlier:  # of an earlier diagnosis of this run
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            for path in written:
                os.replace(path, self._folder / path.name)
        except OSError as error:
            return Failure(2, f'{self._folder}: cannot be written ({error.strerror})')
        return answer
