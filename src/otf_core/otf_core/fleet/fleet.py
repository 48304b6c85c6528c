# SPDX-License-Identifier: Apache-2.0
"""Many recordings, one process each, here or on other hosts; a failing run affects no other."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from otf_core.documents import Document, stated
from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.files.output_folder import file_digest, written_files
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, unreadable, write_text
from otf_core.live.stages import StepProgress
from otf_core.version import __version__

# One run of a fleet in a process of its own: what it does, it does to itself alone.
#
# The process is a command that a user types, or a function by its name (``call``), so results are
# the same bits whoever runs it. A run that was killed is tried again. In its results ``written``
# is a time that the job names (SOURCE_DATE_EPOCH): results depend on nothing but their inputs.

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
    """

    name: str
    words: tuple[str, ...]
    out: str
    result: str
    inputs: str
    date: int


@dataclass(frozen=True)
class JobResult(Document):
    """How a run ended; it took ``seconds``, which are part of no result."""

    exit: int = stated('exit code of its command; negative: the signal that ended it, each time')
    message: str = stated('what it said in the end; empty if all is well')
    sha256: str | None = stated('of its result file; null: there is none')
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
    environment['PYTHONPATH'] = os.pathsep.join(
        filter(None, [str(Path(__file__).resolve().parents[2]), os.environ.get('PYTHONPATH', '')])
    )
    start = time.monotonic()
    code, message = 0, ''
    for _ in range(TRIES):
        process = subprocess.Popen(
            [*COMMAND, *job.words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, env=environment, text=True, errors='replace',
        )  # fmt: skip
        try:
            message = process.communicate()[1]
        finally:
            process.kill()
        code = process.returncode
        if code >= 0:
            break
        _clear_half(Path(job.out))
    result = Path(job.out) / job.result
    worked = code in (0, *JUDGED) and result.exists()
    digest = file_digest(result) if worked else None
    words = _message(code, message)
    if worked and code and (verdict := _verdict(result)):
        words = verdict
    return JobResult(code, words, digest, time.monotonic() - start)


def _clear_half(out: Path) -> None:
    """Remove what a killed process has left beside its folder."""
    for unfinished in out.parent.glob(f'.{out.name}.*.new'):
        shutil.rmtree(unfinished, ignore_errors=True)


def _verdict(result: Path) -> str:
    """Verdict that is not good, of a calibration; empty of anything else."""
    verdicts = read_json(result).get('verdicts') or {}
    good = verdicts.get('measurement', {}).get('good', True)
    return str(verdicts.get('machine' if good else 'measurement', {}).get('sentence', ''))


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
    return shortened(text, LONGEST_MESSAGE)


# The list of a fleet: CSV with the header ``name,bag,machine``, a line per run.

HEADER = ['name', 'bag', 'machine']
NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,99}')
TAKEN = ('fleet.json', 'fleet.html', 'manifest.json')
"""Names in the folder of results that no run may have."""


@dataclass(frozen=True)
class ListedRun:
    """One line: name of the run and of its folder, bag, machine.yaml."""

    name: str
    bag: Path
    machine: Path


def read_list(path: str | Path) -> list[ListedRun]:
    """Read a list of runs.

    Relative paths are looked for beside the list, then where the command runs.

    Raises
    ------
    ConfigError
        Names file, line and what is wrong. Bags that are missing are no mistake of the list: such
        a run fails alone.
    """
    path = Path(path)
    try:
        with open(path, newline='', encoding='utf-8-sig') as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise unreadable(path, error) from None
    except (UnicodeDecodeError, csv.Error):
        raise ConfigError(f'{path}: not a CSV text file') from None
    if not rows or [h.strip() for h in rows[0]] != HEADER:
        raise ConfigError(f'{path}: line 1: expected the header {",".join(HEADER)}')
    runs: dict[str, ListedRun] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not any(word.strip() for word in row):
            continue
        words = [word.strip() for word in row]
        if len(words) != len(HEADER) or not all(words):
            raise ConfigError(f'{path}: line {number}: expected name,bag,machine, got {row}')
        name, bag, machine = words
        if not NAME.fullmatch(name) or name in TAKEN:
            raise ConfigError(
                f'{path}: line {number}: {name!r} is not a folder name; use letters, digits, '
                f'dots, dashes and underscores'
            )
        if name in runs:
            raise ConfigError(f'{path}: line {number}: the name {name} appears twice')
        runs[name] = ListedRun(
            name, _absolute_path(path.parent, bag), _absolute_path(path.parent, machine)
        )
    if not runs:
        raise ConfigError(f'{path}: lists no runs')
    return list(runs.values())


def _absolute_path(folder: Path, word: str) -> Path:
    """Absolute path of what a list names."""
    beside, here = folder / word, Path(word)
    return (here if here.exists() and not beside.exists() else beside).absolute()


# The runs of a list as jobs: ``DIR/NAME/`` holds the results of each.

RESULTS = {'calibrate': 'error_tables.json', 'diagnose': 'gap.json'}
"""What each verb writes."""


def listed_jobs(
    verb: str, runs: Sequence[ListedRun], folder: Path, config: str | None = None
) -> list[Job]:
    """Return a job for every run of a list: the command that a user types.

    Parameters
    ----------
    verb : str
        Of ``RESULTS``.
    folder : Path
        Of the fleet.
    config : str, optional
        File of ``--config``, for every run.
    """
    jobs = []
    options = () if config is None else ('--config', str(Path(config).absolute()))
    for run in runs:
        out = str((folder / run.name).absolute())
        words = (VERBS, verb, str(run.bag), '--machine', str(run.machine), '--out', out)
        inputs = _inputs(verb, run, config)
        jobs.append(
            Job(
                run.name,
                (*words, *options, '--overwrite'),
                out,
                RESULTS[verb],
                inputs,
                newest(run.bag),
            )
        )
    return jobs


def newest(path: Path) -> int:
    """Time of the newest file of a bag, s since 1970; 0 if there is none."""
    files = [p for p in path.rglob('*') if p.is_file()] if path.is_dir() else [path]
    return int(max((p.stat().st_mtime for p in files if p.exists()), default=0))


def _inputs(verb: str, run: ListedRun, config: str | None) -> str:
    """Hash of all that a result depends on; bags by name, size and time of their files."""
    try:
        machine = file_digest(run.machine)
    except OSError:
        machine = 'missing'
    files = written_files(run.bag) if run.bag.is_dir() else [run.bag]
    sizes = [(p.name, p.stat().st_size) for p in files if p.is_file()]
    options = () if config is None else (file_digest(Path(config)),)
    return hash_of(verb, str(run.bag), newest(run.bag), sizes, machine, *options)


def listed_results(
    verb: str, folder: Path, outcomes: Mapping[str, JobResult]
) -> Iterator[tuple[str, Any]]:
    """Names of the runs that are done, with the content of their result files."""
    for name, outcome in outcomes.items():
        if outcome.done:
            yield name, read_json(folder / name / RESULTS[verb])


# Who does the jobs: processes of this computer, or the workers of a Dask scheduler.

CONNECT = 20.0
"""s to wait for a scheduler and its workers."""


def done_here(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, JobResult]]:
    """Do jobs on this computer; yield each as it ends.

    Parameters
    ----------
    workers : int
        Jobs at once: a thread each that waits for the process of its job.
    """
    with ThreadPoolExecutor(workers) as pool:
        futures = {pool.submit(run_job, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            for future in futures:
                future.cancel()


def done_by_dask(jobs: Sequence[Job], address: str) -> Iterator[tuple[Job, JobResult]]:
    """Do jobs on the workers of a Dask scheduler; yield each as it ends.

    All hosts see the same files under the same names, and have otf_core of the same version. A
    worker that dies loses its jobs to others.

    Raises
    ------
    ConfigError
        If Dask distributed is missing, or nothing answers at the address.
    """
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError:
        raise ConfigError(
            '--scheduler: needs Dask distributed on this computer and on the workers: '
            'python3 -m pip install distributed'
        ) from None
    try:
        client = Client(address, timeout=CONNECT)
        client.wait_for_workers(1, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f'--scheduler: {address}: no workers there ({error})') from None
    with client:
        futures = {client.submit(run_job, job, pure=False): job for job in jobs}
        for future in completed(futures):
            lost = future.exception()
            if lost is not None:
                yield futures[future], JobResult(1, f'lost by its workers: {lost}', None)
            else:
                yield futures[future], future.result()


# A fleet of runs: what is done stays done, one that is broken ends nothing but itself.
#
# ``DIR/.fleet/NAME.json`` holds how a run ended and by which inputs. A run is left alone when it
# is started again with the same inputs and has its results; failed ones are tried again.

STATE = '.fleet'
VERB_FILE = 'verb.json'
Workers = Callable[[Sequence[Job]], Iterator[tuple[Job, JobResult]]]


def take_folder(folder: Path, verb: str) -> Path:
    """Make or take the folder of a fleet.

    Raises
    ------
    ConfigError
        If it holds anything but a fleet of the same verb.
    """
    state = folder / STATE
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f'{folder}: is a file; the results need a folder of their own')
    if folder.is_dir() and any(folder.iterdir()) and not (state / VERB_FILE).exists():
        raise ConfigError(f'{folder}: contains files but no fleet; choose another folder')
    ensure_folder(state)
    if (state / VERB_FILE).exists():
        other = read_json(state / VERB_FILE)
        if other != verb:
            raise ConfigError(f'{folder}: holds a fleet of {other}; choose another folder')
    write_text(state / VERB_FILE, json.dumps(verb) + '\n')
    return folder


def run_fleet(
    jobs: Sequence[Job], folder: Path, workers: Workers, progress: Callable[[str], None]
) -> dict[str, JobResult]:
    """Do all jobs that are not done.

    Parameters
    ----------
    folder : Path
        Its ``.fleet`` keeps how they ended.
    workers : callable(jobs)
        Yields every job with its outcome.

    Returns
    -------
    mapping of name to JobResult
        In the order of the jobs.
    """
    ensure_folder(folder / STATE)
    known = {job.name: _done_before(folder, job) for job in jobs}
    outcomes = {name: outcome for name, outcome in known.items() if outcome is not None}
    if outcomes:
        progress(f'{len(outcomes)} of {len(jobs)} runs are already done')
    remaining = [job for job in jobs if job.name not in outcomes]
    to_go = StepProgress(len(remaining))
    for number, (job, outcome) in enumerate(workers(remaining), start=1 + len(outcomes)):
        outcomes[job.name] = outcome
        state = {'inputs': job.inputs, 'outcome': asdict(outcome)}
        write_text(folder / STATE / f'{job.name}.json', json.dumps(state) + '\n')
        message = outcome.message or 'done'
        progress(f'{number}/{len(jobs)} {job.name}: {message}{to_go.after_one()}')
    return {job.name: outcomes[job.name] for job in jobs}


def _done_before(folder: Path, job: Job) -> JobResult | None:
    """Result of an earlier start, if its results are there and its inputs are the same."""
    state = folder / STATE / f'{job.name}.json'
    if not state.exists():
        return None
    known = read_json(state)
    outcome = JobResult(**known['outcome'])
    result = Path(job.out) / job.result
    if known['inputs'] != job.inputs or not outcome.done or not result.exists():
        return None
    return outcome if file_digest(result) == outcome.sha256 else None
