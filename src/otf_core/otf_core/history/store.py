# SPDX-License-Identifier: Apache-2.0
"""Calibrations of machines kept as plain files, and brought to one convention over time."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import Common, common_ground, source_of_tables
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, write_text
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    load_tables,
    tables_from_dict,
)
from otf_core.prediction.volumetric import table_values

# A folder of calibrations and events: one plain JSON file each, named by its hash.
#
# Nothing is ever rewritten; what was added twice is there once. A file whose content is not that
# of its name was changed by hand and is refused.

SCHEMA = 'otf-history-entry/1'
RUN, EVENT = 'run', 'event'
HASH_DIGITS = 12
"""Digits of a hash that are shown."""


@dataclass(frozen=True)
class StoredRun:
    """A calibration of the store; its tables are read on first use.

    Attributes
    ----------
    name : str
        First digits of its hash.
    at : datetime
        When it was measured, UTC.
    machine : str
    path : Path
        File of the store.
    """

    name: str
    at: datetime
    machine: str
    path: Path

    @cached_property
    def content(self) -> CalibrationDocument:
        """Tables with their covariances: some megabytes."""
        return _tables_of(_read_entry(self.path), self.path)


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
        """What belongs to one machine; the tables that are read of it are not kept here."""
        return Store(
            tuple(replace(r) for r in self.runs if r.machine == machine),
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
            f'{where}: {text!r} is not a date; write 2026-11-21 or 2026-11-21T10:30:00Z'
        ) from None
    return moment.replace(tzinfo=moment.tzinfo or timezone.utc).astimezone(timezone.utc)


def measurement_time(content: CalibrationDocument) -> str | None:
    """When a calibration was measured by its own account, else when it was written."""
    block = content.provenance
    measured = block.get('measured')
    last = measured.get('last') if isinstance(measured, dict) else None
    date = last or block.get('written')
    return date if isinstance(date, str) else None


def add_run(folder: Path, tables: Path, at: str | None = None) -> tuple[str, bool]:
    """Put a calibration into the store.

    Parameters
    ----------
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
    moment = at or measurement_time(content)
    if moment is None:
        raise ConfigError(f'{tables}: does not state when it was measured; give --at DATE')
    when = read_moment(moment, '--at' if at else str(tables))
    # a run that does not say when it was measured is dated by its calibration
    measured = content.provenance.get('measured') or {}
    own = _digests(content.provenance) if at or measured.get('last') else set()
    for path in sorted(folder.glob('*.json')) if own else ():
        entry = _read_entry(path)
        same = entry['kind'] == RUN and _digests(entry['tables'].get('provenance') or {}) == own
        if same and read_moment(str(entry['at']), str(path)) != when:
            raise ConfigError(
                f'{tables}: the same recordings (SHA-256) are in the store as of {entry["at"]}; '
                f'a run was measured once: correct --at, or delete {path}'
            )
    return _add(folder, {'kind': RUN, 'at': moment, 'tables': read_json(tables)})


def _digests(provenance: Mapping[str, Any]) -> set[str]:
    """SHA-256 of the recordings of a calibration; empty where it does not state them."""
    runs = provenance.get('runs')
    own = [run.get('sha256') for run in runs] if isinstance(runs, list) else []
    return {str(digest) for digest in own if digest}


def add_event(folder: Path, words: str, at: str, machine: str = '') -> tuple[str, bool]:
    """Put an event into the store; of all machines if none is named. As ``add_run``."""
    read_moment(at, '--at')
    if not words.strip():
        raise ConfigError('--event: state what happened')
    return _add(folder, {'kind': EVENT, 'at': at, 'machine': machine, 'words': words.strip()})


def _add(folder: Path, entry: dict[str, Any]) -> tuple[str, bool]:
    text = json.dumps({'schema': SCHEMA, **entry}, indent=1) + '\n'
    digest = hashlib.sha256(text.encode()).hexdigest()
    path = ensure_folder(folder) / f'{digest}.json'
    new = not path.exists()
    if new:
        write_text(path, text)
    return digest[:HASH_DIGITS], new


def read_store(folder: str | Path) -> Store:
    """Read a store: all of it is checked, of the runs only what identifies them is kept.

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
            f'{folder}: no such folder; otf history {folder} --add RESULTS creates a store'
        )
    runs: list[StoredRun] = []
    events: list[StoredEvent] = []
    for path in sorted(folder.glob('*.json')):
        entry = _read_entry(path)
        at = read_moment(str(entry['at']), str(path))
        if entry['kind'] == EVENT:
            events.append(StoredEvent(at, str(entry['machine']), str(entry['words'])))
        else:
            machine = _tables_of(entry, path).tables.machine.name
            runs.append(StoredRun(path.stem[:HASH_DIGITS], at, machine, path))
    if not runs:
        raise ConfigError(f'{folder}: holds no runs; otf history {folder} --add RESULTS adds one')
    return Store(_in_time(runs), tuple(sorted(events, key=lambda e: (e.at, e.words))))


def _tables_of(entry: Mapping[str, Any], path: Path) -> CalibrationDocument:
    return tables_from_dict(entry['tables'], str(path))


def _in_time(runs: Sequence[StoredRun]) -> tuple[StoredRun, ...]:
    return tuple(sorted(runs, key=lambda run: (run.at, run.name)))


def _read_entry(path: Path) -> dict[str, Any]:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != path.stem:
        raise InputError(
            f'{path}: its content does not match its name (SHA-256): edited or truncated; '
            f'remove it from the store and add the results again'
        )
    entry = read_json(path)
    if not isinstance(entry, dict) or entry.get('schema') != SCHEMA:
        raise InputError(f'{path}: not an entry of a store (schema {SCHEMA})')
    return entry


# Calibrations of one machine in one convention: vectors over time with their covariances
# (``comparison.compare.Common``), each the errors that the run knows but for a rigid motion.

DAY = 86400.0
SAME_OFFSET = 1e-3
"""m; target offsets that differ by less count as one: of 100 urad that is 0.1 um."""


@dataclass(frozen=True)
class Series:
    """Runs of one machine.

    Attributes
    ----------
    runs : tuple of StoredRun
        In the order of time.
    values : ndarray, shape (r, m), m or rad
    covariances : ndarray, shape (r, m, m)
        Of noise and misfit of a run and what does not repeat: what changes are judged by.
    u : ndarray, shape (r,), m
        Mean standard uncertainty of the error vectors on the grid, with all that is stated.
    """

    runs: tuple[StoredRun, ...]
    common: Common
    values: Array
    covariances: Array
    u: Array

    @property
    def days(self) -> Array:
        """Time of the runs, days since the first, shape (r,)."""
        first = self.runs[0].at
        return np.array([(run.at - first).total_seconds() / DAY for run in self.runs])

    @property
    def warnings(self) -> list[str]:
        """Runs that cannot be brought to the target offset of the latest, in words."""
        offset = self.common.machine.target_offset
        words = []
        for run in self.runs:
            tables = run.content.tables
            unseen = [m for m in self.common.folded if not tables.motions[m].identifiable]
            if unseen and not np.allclose(tables.machine.target_offset, offset, atol=SAME_OFFSET):
                words.append(
                    f'the run {run.name} of {run.at:%Y-%m-%d} was measured with the target '
                    f'offset {_millimetres(tables.machine.target_offset)}, the latest run with '
                    f'{_millimetres(offset)}: {", ".join(unseen)}, which it did not determine, '
                    f'act there as other translations; an apparent change may be due to the '
                    f'target alone'
                )
        return words

    def lengths(self, vector: Array) -> Array:
        """Lengths of the error vectors on the grid, shape (n,), m."""
        field = self.common.field_rows @ vector
        return np.asarray(np.linalg.norm(field.reshape(-1, 3), axis=1))

    def since(self, first: int) -> Series:
        """The runs from one on."""
        return Series(
            self.runs[first:],
            self.common,
            self.values[first:],
            self.covariances[first:],
            self.u[first:],
        )


def _millimetres(offset: Array) -> str:
    return f'({", ".join(f"{1e3 * v:.1f}" for v in offset)}) mm'


def series_of(runs: Sequence[StoredRun]) -> Series:
    """Bring runs of one machine to one convention, at the target offset of the latest.

    Raises
    ------
    ConfigError
        If they are of different machines or share nothing.
    """
    sources = [source_of_tables(run.name, run.content) for run in runs]
    common = common_ground(sources[::-1])
    matrices = [common.matrix(source) for source in sources]
    both = list(zip(matrices, sources, strict=True))
    values = np.array([h @ table_values(s.tables) for h, s in both])
    changes = np.array([h @ s.change @ h.T for h, s in both])
    u = np.array([mean_u(common, h @ s.covariance @ h.T) for h, s in both])
    return Series(tuple(runs), common, values, changes, u)


def mean_u(common: Common, covariance: Array) -> float:
    """Mean standard uncertainty of the error vectors on the grid, m."""
    rows = common.field_rows
    variance = np.einsum('ij,ij->i', rows @ covariance, rows).reshape(-1, 3).sum(axis=1)
    return float(np.mean(np.sqrt(np.maximum(variance, 0.0))))
