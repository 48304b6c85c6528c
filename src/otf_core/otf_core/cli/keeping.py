# SPDX-License-Identifier: Apache-2.0
"""Verb on results of years: history."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from otf_core.cli.exporting import tables_file
from otf_core.cli.options import AddVerb, output_folder
from otf_core.cli.output import QUALITY_GATE_FAILED, answer, listed, note
from otf_core.errors import ConfigError

if TYPE_CHECKING:
    from otf_core.history.interim_check import InterimCheck
    from otf_core.history.judged import History


def add_keeping_verbs(verb: AddVerb) -> None:
    """Add history."""
    sub = verb('history', run_history)
    sub.add_argument('store', metavar='STORE', help='folder of runs; the first --add creates it')
    sub.add_argument(
        '--add', action='append', default=[], metavar='RESULTS',
        help='add results of otf calibrate, or an error_tables.json, to the store',
    )  # fmt: skip
    sub.add_argument(
        '--event', metavar='TEXT', help='add an event in the life of the machine to the store'
    )
    sub.add_argument(
        '--at',
        metavar='DATE',
        help='date of the addition, ISO 8601, UTC (default: as measured; now)',
    )
    sub.add_argument('--name', help='name of the machine, if the store contains several')
    sub.add_argument(
        '--limit', type=float, metavar='UM',
        help='permitted mean volumetric drift (um; default: twice u of the latest tables)',
    )  # fmt: skip
    sub.add_argument(
        '--interim', metavar='BAG',
        help='check the latest tables with a run, e.g. of interim_path.csv; exit code 4: invalid',
    )  # fmt: skip
    sub.add_argument(
        '--out',
        help='folder for history.json, history.html, and interim_path.csv (--name if several): '
        'a two-minute path that shows the drift best',
    )
    sub.add_argument('--overwrite', action='store_true', help='replace existing results')


def _added(arguments: argparse.Namespace) -> int:
    """Put into the store what was given; how much that was."""
    from otf_core.history.store import add_event, add_run

    folder = Path(arguments.store)
    for results in arguments.add:
        name, new = add_run(folder, tables_file(results), arguments.at)
        note(f'otf history: {results}: {"added as" if new else "is there already as"} {name}')
    if arguments.event is not None:
        now = datetime.now(timezone.utc).isoformat(timespec='seconds')
        name, new = add_event(folder, arguments.event, arguments.at or now, arguments.name or '')
        note(f'otf history: event {"added as" if new else "is there already as"} {name}')
    return len(arguments.add) + (arguments.event is not None)


def run_history(arguments: argparse.Namespace) -> int:
    """Drift of the machines of a store."""
    from otf_core.history.judged import history_of
    from otf_core.history.store import read_store
    from otf_core.reports.history_report import format_history, store_to_dict, write_history

    if arguments.limit is not None and not arguments.limit > 0:
        raise ConfigError(f'--limit: {arguments.limit:g} um is not above 0')
    if arguments.at is not None and not arguments.add and arguments.event is None:
        raise ConfigError('--at: belongs to --add or --event')
    out = output_folder(arguments, arguments.store) if arguments.out else None
    _added(arguments)
    store = read_store(arguments.store)
    machines = [m for m in store.machines if arguments.name in (None, m)]
    if not machines:
        raise ConfigError(
            f'--name: no {arguments.name} in the store; there: {", ".join(store.machines)}'
        )
    limit = None if arguments.limit is None else 1e-6 * arguments.limit
    histories: list[History] = [history_of(store, m, limit) for m in machines]
    words = '\n\n'.join(map(format_history, histories))
    if out is not None:
        with out.filled('history') as folder:
            names = [f.name for f in write_history(histories, folder)]
            if len(histories) == 1:
                names.append(_interim_path(histories[0], folder))
        words += listed([out.path / n for n in names], arguments.out)
    data = store_to_dict(histories)
    if arguments.interim is None:
        answer(arguments, words, data)
        return 0
    if len(histories) > 1:
        raise ConfigError(f'--interim: of which machine? --name {"|".join(machines)}')
    check = _interim_check(histories[0], arguments.interim)
    data['interim'] = {**asdict(check), 'ratio': check.ratio, 'holds': check.holds}
    answer(arguments, f'{words}\n\n{check.words}', data)
    return 0 if check.holds else QUALITY_GATE_FAILED


def _interim_path(history: History, folder: Path) -> str:
    """Write the path of an interim check; its file name."""
    from otf_core.files.csv_points import write_csv
    from otf_core.history.interim_path import interim_path

    name = 'interim_path.csv'
    write_csv(folder / name, 'x,y,z', interim_path(history).points)
    return name


def _interim_check(history: History, bag: str) -> InterimCheck:
    """Judge the latest tables of a machine by a run."""
    from otf_core.history.interim_check import interim_check
    from otf_core.inputs.recordings import read_recording

    machine = history.series.runs[-1].content.tables.machine
    return interim_check(read_recording([bag], machine), history.series)
