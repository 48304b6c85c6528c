# SPDX-License-Identifier: Apache-2.0
"""The runs of a list as jobs: ``DIR/NAME/`` holds the results of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from otf_core.files.json_file import read_json
from otf_core.files.manifest import file_digest, written_files
from otf_core.fleet.job import VERBS, Job, JobResult, hash_of
from otf_core.fleet.run_list import ListedRun

RESULTS = {'calibrate': 'error_tables.json', 'diagnose': 'gap.json'}
"""What each verb writes."""


def listed_jobs(verb: str, runs: Sequence[ListedRun], folder: Path) -> list[Job]:
    """Return a job for every run of a list: the command that a user types.

    Parameters
    ----------
    verb : str
        Of ``RESULTS``.
    runs : sequence of ListedRun
    folder : Path
        Of the fleet.
    """
    jobs = []
    for run in runs:
        out = str((folder / run.name).absolute())
        words = (VERBS, verb, str(run.bag), '--machine', str(run.machine), '--out', out)
        inputs = _inputs(verb, run)
        jobs.append(
            Job(
                run.name,
                (*words, '--overwrite', '--quiet'),
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


def _inputs(verb: str, run: ListedRun) -> str:
    """Hash of all that a result depends on; bags by name, size and time of their files."""
    try:
        machine = file_digest(run.machine)
    except OSError:
        machine = 'missing'
    files = written_files(run.bag) if run.bag.is_dir() else [run.bag]
    sizes = [(p.name, p.stat().st_size) for p in files if p.is_file()]
    return hash_of(verb, str(run.bag), newest(run.bag), sizes, machine)


def listed_results(
    verb: str, folder: Path, outcomes: Mapping[str, JobResult]
) -> Iterator[tuple[str, Any]]:
    """Names of the runs that are done, with the content of their result files."""
    for name, outcome in outcomes.items():
        if outcome.done:
            yield name, read_json(folder / name / RESULTS[verb])
