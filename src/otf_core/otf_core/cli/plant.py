# SPDX-License-Identifier: Apache-2.0
"""Verbs on many runs, a process each, here or on other hosts: fleet, blind."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from otf_core.cli.options import AddVerb
from otf_core.cli.output import (
    LIMIT_NOT_PROVEN,
    QUALITY_GATE_FAILED,
    answer,
    answer_from,
    listed,
    note,
)
from otf_core.errors import ConfigError

if TYPE_CHECKING:
    from otf_core.fleet.fleet import Workers

LISTED = ('calibrate', 'diagnose')
BLIND, VALIDATE = 'blind', 'validate'
MOST = {'trials': 100_000, 'seed': 10_000_000}
NEEDED = {
    **dict.fromkeys(LISTED, ('list',)),
    **dict.fromkeys((BLIND, VALIDATE), ('trials', 'seed')),
}
"""Options that say what is done, by what is asked for; each takes no other of them."""


def add_plant_verbs(verb: AddVerb) -> None:
    """Add fleet."""
    sub = verb('fleet', run_fleet_verb)
    sub.add_argument('what', choices=tuple(NEEDED), help='command for each run or cell')
    sub.add_argument(
        '--list', metavar='runs.csv',
        help='calibrate, diagnose: CSV with the header name,bag,machine; paths may be relative '
        'to its folder',
    )  # fmt: skip
    sub.add_argument('--trials', type=int, metavar='N', help='blind, validate: number of cells')
    sub.add_argument(
        '--seed', type=int, metavar='N',
        help='blind: seed of all random draws; validate: seed of the first cell',
    )  # fmt: skip
    sub.add_argument(
        '--leave-one-out', action='store_true',
        help='blind: diagnose every effect with that effect removed from the catalogue',
    )  # fmt: skip
    sub.add_argument(
        '--out', required=True,
        help='folder for the results and fleet.json; an interrupted fleet resumes there',
    )  # fmt: skip
    sub.add_argument(
        '--workers', type=int, metavar='N', help='parallel runs (default: one per core)'
    )
    sub.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='address of a Dask scheduler, e.g. tcp://host:8786, whose workers process the runs',
    )  # fmt: skip


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse options that are missing, or that another kind of fleet has."""
    needed = NEEDED[arguments.what]
    for name in sorted({n for names in NEEDED.values() for n in names}):
        given = getattr(arguments, name) is not None
        if given and name not in needed:
            raise ConfigError(f'--{name}: not of fleet {arguments.what}; leave it out')
        if not given and name in needed:
            raise ConfigError(f'fleet {arguments.what}: --{name} is missing')
    if arguments.leave_one_out and arguments.what != BLIND:
        raise ConfigError(f'--leave-one-out: not of fleet {arguments.what}; leave it out')
    if 'trials' in needed:
        _check_cells(arguments)


def _check_cells(arguments: argparse.Namespace) -> None:
    for name, low in (('trials', 1), ('seed', 0)):
        value = getattr(arguments, name)
        if not low <= value <= MOST[name]:
            raise ConfigError(f'--{name}: {value} is out of range [{low}, {MOST[name]}]')


def _workers(arguments: argparse.Namespace) -> Workers:
    """Who does the runs."""
    from otf_core.fleet.workers import done_by_dask, done_here

    count = arguments.workers
    if count is not None and not 1 <= count <= 1000:
        raise ConfigError(f'--workers: {count} is out of range [1, 1000]')
    if count is not None and arguments.scheduler is not None:
        raise ConfigError('--workers: the scheduler has its own; leave it out with --scheduler')
    if arguments.scheduler is not None:
        return partial(done_by_dask, address=arguments.scheduler)
    return partial(done_here, workers=count or os.cpu_count() or 1)


def _progress(arguments: argparse.Namespace) -> Callable[[str], None]:
    def told(text: str) -> None:
        if not arguments.quiet:
            note(f'otf {arguments.verb}: {text}')

    return told


def run_fleet_verb(arguments: argparse.Namespace) -> int:
    """Many runs at once."""
    _check_options(arguments)
    workers = _workers(arguments)
    if arguments.what == BLIND:
        return _trial(arguments, workers, overwrite=False)
    if arguments.what == VALIDATE:
        return _validation(arguments, workers)
    return _listed_runs(arguments, workers)


def _listed_runs(arguments: argparse.Namespace, workers: Workers) -> int:
    """Calibrate or diagnose recordings."""
    from otf_core.fleet.fleet import fleet_to_dict, run_fleet, take_folder
    from otf_core.fleet.listed import listed_jobs
    from otf_core.fleet.run_list import read_list
    from otf_core.reports.fleet_report import format_fleet, offset_warnings, write_fleet

    verb = arguments.what
    runs = read_list(arguments.list)
    folder = take_folder(Path(arguments.out), verb)
    jobs = listed_jobs(verb, runs, folder)
    outcomes = run_fleet(jobs, folder, workers, _progress(arguments))
    files = write_fleet(verb, folder, outcomes)
    warnings = offset_warnings(verb, folder, outcomes)
    words = '\n'.join([format_fleet(verb, outcomes), *warnings]) + listed(files, arguments.out)
    answer(arguments, words, fleet_to_dict(verb, outcomes) | {'warnings': warnings})
    exits = {o.exit for o in outcomes.values()} - {0}
    if not exits:
        return 0
    return LIMIT_NOT_PROVEN if exits == {LIMIT_NOT_PROVEN} else QUALITY_GATE_FAILED


def _validation(arguments: argparse.Namespace, workers: Workers) -> int:
    """The paper's comparisons, a cell a run, in one table."""
    from otf_core.cli.simulating import told_limits
    from otf_core.fleet.fleet import fleet_to_dict, run_fleet, take_folder
    from otf_core.reports.fleet_report import format_fleet, list_results, write_outcomes
    from otf_core.reports.validation import write_table
    from otf_core.validation.spread import cell_jobs, table_of
    from otf_core.validation.table import format_rows

    folder = take_folder(Path(arguments.out), VALIDATE)
    jobs = cell_jobs(arguments.seed, arguments.trials, folder)
    outcomes = run_fleet(jobs, folder, workers, _progress(arguments))
    words, files = format_fleet(VALIDATE, outcomes, gates=False), []
    seeds, rows = table_of(folder, outcomes)
    if rows:
        files = write_table(seeds, rows, folder)
        words = f'{format_rows(rows)}\n\n{words}'
    files.append(write_outcomes(VALIDATE, folder, outcomes))
    list_results(VALIDATE, folder)
    answer(arguments, words + listed(files, arguments.out), fleet_to_dict(VALIDATE, outcomes))
    beyond = told_limits(rows)
    return QUALITY_GATE_FAILED if any(not o.done for o in outcomes.values()) else beyond


def run_blind(arguments: argparse.Namespace) -> int:
    """Blind trial: draw and seal cells, diagnose them, score."""
    from otf_core.fleet.workers import done_here

    _check_cells(arguments)
    workers = partial(done_here, workers=arguments.jobs)
    return _trial(arguments, workers, overwrite=arguments.overwrite)


def _trial(arguments: argparse.Namespace, workers: Workers, *, overwrite: bool) -> int:
    """Run a blind trial."""
    from otf_core.blind.seal import holds_trial
    from otf_core.blind.trial import list_files, run_leave_one_out, run_trial
    from otf_core.files.output import OutputFolder
    from otf_core.reports.fleet_report import format_fleet, write_outcomes

    folder = Path(arguments.out)
    if overwrite or not holds_trial(folder):
        OutputFolder(folder, overwrite=overwrite).clear()
    run = run_leave_one_out if arguments.leave_one_out else run_trial
    try:
        found = run(arguments.trials, arguments.seed, folder, workers, _progress(arguments))
        files = [write_outcomes(BLIND, folder, found.ended), folder / 'score.txt']
    finally:
        list_files(folder)
    failed = any(not ended.done for ended in found.ended.values())
    words = f'{found.words}\n\n{format_fleet(BLIND, found.ended)}' if failed else found.words
    answer_from(arguments, words, files, 'score.json')
    return QUALITY_GATE_FAILED if failed else 0
