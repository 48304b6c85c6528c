# SPDX-License-Identifier: Apache-2.0
"""One diagnosis in a process of its own: it can be ended at once, and holds up no samples."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from multiprocessing import Pipe
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from otf_calibrator.diagnosis_task import Failure, Task
from otf_calibrator.job import Calibrated

MODULE = 'otf_calibrator.diagnosis_process'
OF_A_CAUSE = ('effects*.yaml', 'calibration_plain', 'calibration_with_effects')
"""What a diagnosis writes only if it names a cause."""
Answer = dict[str, Any] | Failure


class DiagnosisJob:
    """Diagnoses a calibrated run; starts at once, never waits.

    Parameters
    ----------
    outcome : Calibrated
        Its files have been written; those of the diagnosis go beside them when they are whole.

    Attributes
    ----------
    stage, fraction : str and float
        What is being done, and the share of the whole that is done.

    Raises
    ------
    OSError
        If the process cannot be started.
    """

    def __init__(self, outcome: Calibrated) -> None:
        assert outcome.folder is not None, 'an obstacle'
        self.outcome, self._folder = outcome, outcome.folder
        self.stage, self.fraction = 'starting', 0.0
        self._partial = TemporaryDirectory(prefix='.diagnosis-', dir=self._folder)
        self._answers, answers = Pipe(duplex=False)
        self._answer: Answer | None = None
        partial = Path(self._partial.name)
        task = Task(outcome.recording, outcome.request.config, self._folder.name, partial)
        with answers, TemporaryFile() as file:
            pickle.dump(task, file)  # into a pipe it would wait until the process has read it
            file.seek(0)
            self._process = subprocess.Popen(
                [sys.executable, '-m', MODULE, str(answers.fileno())],
                stdin=file,
                pass_fds=[answers.fileno()],
                start_new_session=True,  # Ctrl-C reaches the node only, which ends both in order
            )

    def finished(self) -> Answer | None:
        """Take in what the process has said; return its answer once it has ended.

        Returns
        -------
        dict or Failure or None
            What gap.json holds; why there is none; None while the diagnosis is under way.
        """
        code = self._process.poll()
        while self._answer is None and self._answers.poll():
            try:
                said = self._answers.recv()
            except EOFError:
                break
            if isinstance(said, tuple):
                self.stage, self.fraction = said
            else:
                self._answer = said
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
