# SPDX-License-Identifier: Apache-2.0
"""A fleet of runs: what is done stays done, one that is broken ends nothing but itself.

``DIR/.fleet/NAME.json`` holds how a run ended and by which inputs. A run is left alone when it is
started again with the same inputs and has its results; failed ones are tried again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_core.files.json_file import read_json
from otf_core.files.manifest import file_digest
from otf_core.files.writing import ensure_folder, write_text
from otf_core.fleet.job import Job, JobResult
from otf_core.live.time_left import StepsLeft

SCHEMA = 'otf-fleet/1'
FILE, PAGE, STATE = 'fleet.json', 'fleet.html', '.fleet'
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
        raise ConfigError(f'{folder}: holds files already, and no fleet; choose another folder')
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
    jobs : sequence of Job
    folder : Path
        Its ``.fleet`` keeps how they ended.
    workers : callable(jobs)
        Yields every job with its outcome.
    progress : callable(str)

    Returns
    -------
    mapping of name to JobResult
        In the order of the jobs.
    """
    ensure_folder(folder / STATE)
    known = {job.name: _done_before(folder, job) for job in jobs}
    outcomes = {name: outcome for name, outcome in known.items() if outcome is not None}
    if outcomes:
        progress(f'{len(outcomes)} of {len(jobs)} runs are done already')
    left = [job for job in jobs if job.name not in outcomes]
    to_go = StepsLeft(len(left))
    for number, (job, outcome) in enumerate(workers(left), start=1 + len(outcomes)):
        outcomes[job.name] = outcome
        state = {'inputs': job.inputs, 'outcome': asdict(outcome)}
        write_text(folder / STATE / f'{job.name}.json', json.dumps(state) + '\n')
        said = outcome.message or 'done'
        progress(f'{number}/{len(jobs)} {job.name}: {said}{to_go.after_one()}')
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


def fleet_to_dict(verb: str, outcomes: Mapping[str, JobResult]) -> dict[str, Any]:
    """Return a fleet as plain data: fleet.json."""
    done = sum(outcome.done for outcome in outcomes.values())
    runs = {
        name: {'exit': o.exit, 'message': o.message, 'sha256': o.sha256}
        for name, o in outcomes.items()
    }
    return {
        'schema': SCHEMA,
        'verb': verb,
        'done': done,
        'failed': len(outcomes) - done,
        'runs': runs,
    }
