# SPDX-License-Identifier: Apache-2.0
"""One run of a fleet in a process of its own: what it does, it does to itself alone.

The process is a command that a user types, or a function by its name (``call``), so results are
the same bits whoever runs it. A run that was killed is tried again. In its results ``written`` is
a time that the job names (SOURCE_DATE_EPOCH): results depend on nothing but their inputs.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from otf_core.files.manifest import file_digest
from otf_core.version import __version__

COMMAND = (sys.executable, '-m')
VERBS = 'otf_core.cli'
TRIES = 3
LONGEST_MESSAGE = 1000
JUDGED = (4, 5)
"""Exit codes of a command that is done and states a verdict that is not good."""
DATE = 'SOURCE_DATE_EPOCH'


@dataclass(frozen=True)
class Job:
    """What to do.

    Attributes
    ----------
    name : str
        Of the run in its fleet; letters, digits, dots, dashes and underscores.
    words : tuple of str
        Module and its arguments.
    out : str
        Folder for its results.
    result : str
        File in it that holds the result.
    inputs : str
        Hash of all that the result depends on, see ``hash_of``.
    date : int
        s since 1970; ``written`` in what comes out, unless the environment names another.
    folder : str, optional
        Where the process runs.
    places : tuple of str, optional
        Folders that hold its modules, besides that of otf_core.
    limit : float, optional
        s; a process that takes longer is ended, and has failed.
    """

    name: str
    words: tuple[str, ...]
    out: str
    result: str
    inputs: str
    date: int
    folder: str | None = None
    places: tuple[str, ...] = ()
    limit: float | None = None


@dataclass(frozen=True)
class JobResult:
    """How a run ended.

    Attributes
    ----------
    exit : int
        Exit code of the command; negative: the signal that ended it, each time.
    message : str
        What it said in the end; empty if all is well.
    sha256 : str or None
        Of its result file; None if there is none.
    seconds : float
        It took; part of no result.
    """

    exit: int
    message: str
    sha256: str | None
    seconds: float = field(default=0.0, compare=False)

    @property
    def done(self) -> bool:
        """True if there are results."""
        return self.sha256 is not None


def hash_of(*given: Any) -> str:
    """Hash of plain data that a result depends on, and of the version of this program."""
    return hashlib.sha256(json.dumps([__version__, *given]).encode()).hexdigest()


def run_job(job: Job) -> JobResult:
    """Run one job to its end, in a process."""
    environment = {DATE: str(job.date), **os.environ}
    places = [str(Path(__file__).resolve().parents[2]), *job.places]
    environment['PYTHONPATH'] = os.pathsep.join(
        filter(None, [*places, os.environ.get('PYTHONPATH', '')])
    )
    start = time.monotonic()
    code, said = 0, ''
    for _ in range(TRIES):
        process = subprocess.Popen(
            [*COMMAND, *job.words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, env=environment, cwd=job.folder, text=True, errors='replace',
        )  # fmt: skip
        try:
            said = process.communicate(timeout=job.limit)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return JobResult(1, f'took longer than {job.limit:.0f} s', None)
        finally:
            process.kill()
        code = process.returncode
        if code >= 0:
            break
        _clear_half(Path(job.out))
    result = Path(job.out) / job.result
    worked = code in (0, *JUDGED) and result.exists()
    digest = file_digest(result) if worked else None
    return JobResult(code, _message(code, said), digest, time.monotonic() - start)


def _clear_half(out: Path) -> None:
    """Remove what a killed process has left beside its folder."""
    for left in out.parent.glob(f'.{out.name}.*.new'):
        shutil.rmtree(left, ignore_errors=True)


def _message(code: int, said: str) -> str:
    """Last words of a command that failed; empty if it did not."""
    if code < 0:
        return f'killed by signal {-code} in {TRIES} tries; out of memory?'
    if code == 0:
        return ''
    lines = [line for line in said.splitlines() if line.strip()]
    text = lines[-1] if lines else 'said nothing'
    if code in JUDGED:
        text = text.removeprefix('otf: ')
    return text[:LONGEST_MESSAGE]
