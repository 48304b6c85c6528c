# SPDX-License-Identifier: Apache-2.0
"""Verbs on many recordings: fleet."""

from __future__ import annotations

import argparse
import os
from functools import partial
from pathlib import Path

from otf_core.cli.options import AddVerb
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, listed, note
from otf_core.errors import ConfigError


def add_plant_verbs(verb: AddVerb) -> None:
    """Add fleet."""
    sub = verb('fleet', run_fleet_verb)
    sub.add_argument('what', choices=('calibrate', 'diagnose'), help='what is done with each run')
    sub.add_argument(
        '--list', required=True, metavar='runs.csv',
        help='CSV with the header name,bag,machine; relative paths are looked for beside it',
    )  # fmt: skip
    sub.add_argument(
        '--out', required=True,
        help='folder: NAME/, fleet.json, fleet.html; an interrupted fleet goes on there',
    )  # fmt: skip
    sub.add_argument(
        '--workers', type=int, metavar='N', help='runs at once (default: one per core)'
    )
    sub.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='of a Dask scheduler, e.g. tcp://host:8786: its workers do the runs',
    )  # fmt: skip


def run_fleet_verb(arguments: argparse.Namespace) -> int:
    """Many recordings at once."""
    from otf_core.fleet.fleet import fleet_to_dict, run_fleet, take_folder
    from otf_core.fleet.run_list import read_list
    from otf_core.fleet.workers import done_by_dask, done_here
    from otf_core.reports.fleet import format_fleet, write_fleet

    count = arguments.workers
    if count is not None and not 1 <= count <= 1000:
        raise ConfigError(f'--workers: {count} is out of range [1, 1000]')
    if count is not None and arguments.scheduler is not None:
        raise ConfigError('--workers: the scheduler has its own; leave it out with --scheduler')
    runs = read_list(arguments.list)
    folder = take_folder(Path(arguments.out), arguments.what)
    if arguments.scheduler is not None:
        workers = partial(done_by_dask, address=arguments.scheduler)
    else:
        workers = partial(done_here, workers=count or os.cpu_count() or 1)

    def progress(text: str) -> None:
        if not arguments.quiet:
            note(f'otf fleet: {text}')

    outcomes = run_fleet(arguments.what, runs, folder, workers, progress)
    files = write_fleet(arguments.what, folder, outcomes)
    words = format_fleet(arguments.what, outcomes) + listed(files, arguments.out)
    answer(arguments, words, fleet_to_dict(arguments.what, outcomes))
    return QUALITY_GATE_FAILED if any(o.exit for o in outcomes.values()) else 0
