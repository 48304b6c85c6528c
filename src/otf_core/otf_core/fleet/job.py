# SPDX-License-Identifier: Apache-2.0
"""One run of a fleet in a process of its own: what it does, it does to itself alone.

The process is the command that a user types, so results are the same bits whoever runs it. A run
that was killed is tried again. In its results ``written`` is the time of the bag's newest file
(SOURCE_DATE_EPOCH): results depend on nothing but their inputs.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from otf_core.files.manifest import file_digest

RESULTS = {'calibrate': 'error_tables.json', 'diagnose': 'gap.json'}
"""What each verb writes."""
COMMAND = (sys.executable, '-m', 'otf_core.cli')
TRIES = 3
LONGEST_MESSAGE = 1000
DATE = 'SOURCE_DATE_EPOCH'


@dataclass(frozen=True)
class Job:
    """What to do: verb, bag, machine.yaml, and the folder for the results."""

    verb: str
    name: str
    bag: str
    machine: str
    out: str


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
    """

    exit: int
    message: str
    sha256: str | None

    @property
    def done(self) -> bool:
        """True if there are results."""
        return self.sha256 is not None


def newest(path: Path) -> int:
    """Time of the newest file of a bag, s since 1970; 0 if there is none."""
    files = [p for p in path.rglob('*') if p.is_file()] if path.is_dir() else [path]
    return int(max((p.stat().st_mtime for p in files if p.exists()), default=0))


def run_job(job: Job) -> JobResult:
    """Run one job to its end, in a process."""
    command = [
        *COMMAND, job.verb, job.bag, '--machine', job.machine, '--out', job.out, '--overwrite',
        '--quiet',
    ]  # fmt: skip
    environment = {DATE: str(newest(Path(job.bag))), **os.environ}
    places = [str(Path(__file__).parents[2]), os.environ.get('PYTHONPATH', '')]
    environment['PYTHONPATH'] = os.pathsep.join(filter(None, places))
    code, said = 0, ''
    for _ in range(TRIES):
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, env=environment, text=True, errors='replace',
        )  # fmt: skip
        try:
            said = process.communicate()[1]
        finally:
            process.kill()
        code = process.returncode
        if code >= 0:
            break
        _clear_half(Path(job.out))
    result = Path(job.out) / RESULTS[job.verb]
    worked = code in (0, 4) and result.exists()
    return JobResult(code, _message(code, said), file_digest(result) if worked else None)


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
    gates = [line for line in lines if 'quality gate failed' in line]
    text = '; '.join(gates) if code == 4 and gates else (lines[-1] if lines else 'said nothing')
    return text[:LONGEST_MESSAGE]
