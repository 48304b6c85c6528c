# SPDX-License-Identifier: Apache-2.0
"""A folder of calibrations and events: one plain JSON file each, named by its hash.

Nothing is ever rewritten; what was added twice is there once. A file whose content is not that of
its name was changed by hand and is refused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError, InputError
from otf_core.files.json_file import read_json
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.tables import TablesFile, load_tables, tables_from_dict

SCHEMA = 'otf-history-entry/1'
RUN, EVENT = 'run', 'event'
SHOWN = 12
"""Digits of a hash that are shown."""


@dataclass(frozen=True)
class StoredRun:
    """A calibration of the store.

    Attributes
    ----------
    name : str
        First digits of its hash.
    at : datetime
        When it was measured, UTC.
    content : TablesFile
    """

    name: str
    at: datetime
    content: TablesFile

    @property
    def machine(self) -> str:
        """Name of the machine."""
        return self.content.tables.machine.name


@dataclass(frozen=True)
class StoredEvent:
    """Something that happened to a machine: a repair, a collision, another place."""

    at: datetime
    machine: str
    words: str


@dataclass(frozen=True)
class Store:
    """Runs and events in the order of time."""

    runs: tuple[StoredRun, ...]
    events: tuple[StoredEvent, ...]

    @property
    def machines(self) -> list[str]:
        """Names of the machines, those with the latest run first."""
        return list(dict.fromkeys(run.machine for run in reversed(self.runs)))

    def of(self, machine: str) -> Store:
        """What belongs to one machine."""
        return Store(
            tuple(r for r in self.runs if r.machine == machine),
            tuple(e for e in self.events if e.machine in ('', machine)),
        )


def read_moment(text: str, where: str) -> datetime:
    """Read a moment by ISO 8601; without a zone it is UTC.

    Raises
    ------
    ConfigError
        If it is none.
    """
    try:
        moment = datetime.fromisoformat(text.replace('Z', '+00:00'))
    except ValueError:
        raise ConfigError(
            f'{where}: {text!r} is no date; write 2026-11-21 or 2026-11-21T10:30:00Z'
        ) from None
    return moment.replace(tzinfo=moment.tzinfo or timezone.utc).astimezone(timezone.utc)


def measured_at(content: TablesFile) -> str | None:
    """When a calibration was measured by its own account, else when it was written."""
    block = content.extra.get('provenance')
    if not isinstance(block, dict):
        return None
    measured = block.get('measured')
    last = measured.get('last') if isinstance(measured, dict) else None
    found = last or block.get('written')
    return found if isinstance(found, str) else None


def add_run(folder: Path, tables: Path, at: str | None = None) -> tuple[str, bool]:
    """Put a calibration into the store.

    Parameters
    ----------
    folder : Path
    tables : Path
        An error_tables.json.
    at : str, optional
        When it was measured, ISO 8601; as its provenance says if not given.

    Returns
    -------
    name : str
    new : bool
        False if it was there already.

    Raises
    ------
    ConfigError
        If the tables cannot be read or nobody says when they were measured.
    """
    content = load_tables(tables)
    moment = at or measured_at(content)
    if moment is None:
        raise ConfigError(f'{tables}: does not say when it was measured; give --at DATE')
    read_moment(moment, '--at' if at else str(tables))
    return _add(folder, {'kind': RUN, 'at': moment, 'tables': read_json(tables)})


def add_event(folder: Path, words: str, at: str, machine: str = '') -> tuple[str, bool]:
    """Put an event into the store; of all machines if none is named. As ``add_run``."""
    read_moment(at, '--at')
    if not words.strip():
        raise ConfigError('--event: say what happened')
    return _add(folder, {'kind': EVENT, 'at': at, 'machine': machine, 'words': words.strip()})


def _add(folder: Path, entry: dict[str, Any]) -> tuple[str, bool]:
    text = json.dumps({'schema': SCHEMA, **entry}, indent=1) + '\n'
    digest = hashlib.sha256(text.encode()).hexdigest()
    path = ensure_folder(folder) / f'{digest}.json'
    new = not path.exists()
    if new:
        write_text(path, text)
    return digest[:SHOWN], new


def read_store(folder: str | Path) -> Store:
    """Read all of a store.

    Raises
    ------
    ConfigError
        If there is no such folder, or it is empty.
    InputError
        If a file was changed since it was added.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(
            f'{folder}: no such folder; otf history {folder} --add RESULTS begins a store'
        )
    runs: list[StoredRun] = []
    events: list[StoredEvent] = []
    for path in sorted(folder.glob('*.json')):
        entry = _read_entry(path)
        at = read_moment(str(entry['at']), str(path))
        if entry['kind'] == EVENT:
            events.append(StoredEvent(at, str(entry['machine']), str(entry['words'])))
        else:
            content = tables_from_dict(entry['tables'], str(path))
            runs.append(StoredRun(path.stem[:SHOWN], at, content))
    if not runs:
        raise ConfigError(f'{folder}: holds no runs; otf history {folder} --add RESULTS adds one')
    return Store(_in_time(runs), tuple(sorted(events, key=lambda e: (e.at, e.words))))


def _in_time(runs: Sequence[StoredRun]) -> tuple[StoredRun, ...]:
    return tuple(sorted(runs, key=lambda run: (run.at, run.name)))


def _read_entry(path: Path) -> dict[str, Any]:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != path.stem:
        raise InputError(
            f'{path}: its content is not that of its name (SHA-256): changed by hand or cut; take '
            f'it out of the store and add the results again'
        )
    entry = read_json(path)
    if not isinstance(entry, dict) or entry.get('schema') != SCHEMA:
        raise InputError(f'{path}: no entry of a store (schema {SCHEMA})')
    return entry
