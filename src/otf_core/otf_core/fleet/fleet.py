# SPDX-License-Identifier: Apache-2.0
"""A fleet of runs: what is done stays done, one bad bag ends nothing but itself.

``DIR/NAME/`` holds the results of a run, ``DIR/.fleet/NAME.json`` how it ended and by which
inputs. A run is left alone when it is started again with the same inputs and has its results;
failed ones are tried again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_core.files.json_file import read_json
from otf_core.files.manifest import file_digest, written_files
from otf_core.files.writing import ensure_folder, write_text
from otf_core.fleet.job import RESULTS, Job, Outcome, newest
from otf_core.fleet.run_list import ListedRun
from otf_core.live.time_left import StepsLeft
from otf_core.version import __version__

SCHEMA = 'otf-fleet/1'
FILE, PAGE, STATE = 'fleet.json', 'fleet.html', '.fleet'
VERB_FILE = 'verb.json'
Workers = Callable[[Sequence[Job]], Iterator[tuple[Job, Outcome]]]
Progress = Callable[[str], None]


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
    verb: str, runs: Sequence[ListedRun], folder: Path, workers: Workers, progress: Progress
) -> dict[str, Outcome]:
    """Do all runs that are not done.

    Parameters
    ----------
    verb : str
        'calibrate' or 'diagnose'.
    runs : sequence of ListedRun
    folder : Path
        See ``take_folder``.
    workers : callable(jobs)
        Yields every job with its outcome.
    progress : callable(str)

    Returns
    -------
    mapping of name to Outcome
        In the order of the list.
    """
    outcomes, jobs = {}, []
    keys = {run.name: _inputs(verb, run) for run in runs}
    for run in runs:
        known = _done_before(folder, verb, run.name, keys[run.name])
        if known is not None:
            outcomes[run.name] = known
        else:
            out = str((folder / run.name).absolute())
            jobs.append(Job(verb, run.name, str(run.bag), str(run.machine), out))
    if outcomes:
        progress(f'{len(outcomes)} of {len(runs)} runs are done already')
    left = StepsLeft(len(jobs))
    for number, (job, outcome) in enumerate(workers(jobs), start=1 + len(outcomes)):
        outcomes[job.name] = outcome
        state = {'inputs': keys[job.name], 'outcome': asdict(outcome)}
        write_text(folder / STATE / f'{job.name}.json', json.dumps(state) + '\n')
        said = outcome.message or 'done'
        progress(f'{number}/{len(runs)} {job.name}: {said}{left.after_one()}')
    return {run.name: outcomes[run.name] for run in runs}


def _inputs(verb: str, run: ListedRun) -> str:
    """Hash of all that a result depends on; bags by name, size and time of their files."""
    try:
        machine = file_digest(run.machine)
    except OSError:
        machine = 'missing'
    files = written_files(run.bag) if run.bag.is_dir() else [run.bag]
    sizes = [(p.name, p.stat().st_size) for p in files if p.is_file()]
    given = [__version__, verb, str(run.bag), newest(run.bag), sizes, machine]
    return hashlib.sha256(json.dumps(given).encode()).hexdigest()


def _done_before(folder: Path, verb: str, name: str, key: str) -> Outcome | None:
    """Outcome of an earlier start, if its results are there and its inputs are the same."""
    state = folder / STATE / f'{name}.json'
    if not state.exists():
        return None
    known = read_json(state)
    outcome = Outcome(**known['outcome'])
    result = folder / name / RESULTS[verb]
    if known['inputs'] != key or not outcome.done or not result.exists():
        return None
    return outcome if file_digest(result) == outcome.sha256 else None


def fleet_to_dict(verb: str, outcomes: Mapping[str, Outcome]) -> dict[str, Any]:
    """Return a fleet as plain data: fleet.json."""
    done = sum(outcome.done for outcome in outcomes.values())
    return {
        'schema': SCHEMA,
        'verb': verb,
        'done': done,
        'failed': len(outcomes) - done,
        'runs': {name: asdict(outcome) for name, outcome in outcomes.items()},
    }


def results(verb: str, folder: Path, outcomes: Mapping[str, Outcome]) -> Iterable[tuple[str, Any]]:
    """Names of the runs that are done, with the content of their result files."""
    for name, outcome in outcomes.items():
        if outcome.done:
            yield name, read_json(folder / name / RESULTS[verb])
