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
from otf_core.comparison.compare import (
    GRID_POINTS,
    Common,
    Source,
    common_ground,
    operator,
    source_of_tables,
    vector_rows,
)
from otf_core.comparison.rotary_axes import check_one_machine, not_compared, whole_vector
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import read_json
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.evaluation import free_rows, lattice
from otf_core.model.joints import Sight
from otf_core.model.kinematics import nominal_position
from otf_core.model.motions import DIRECTIONS, MOTIONS, SQUARENESS
from otf_core.model.nodes import hat_matrix
from otf_core.model.tables import TablesFile, load_tables, tables_from_dict
from otf_core.prediction.covariance import unpack_covariance
from otf_core.prediction.uncertainty import prediction_rows

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
    def content(self) -> TablesFile:
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


def measurement_time(content: TablesFile) -> str | None:
    """When a calibration was measured by its own account, else when it was written."""
    block = content.extra.get('provenance')
    if not isinstance(block, dict):
        return None
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
    read_moment(moment, '--at' if at else str(tables))
    return _add(folder, {'kind': RUN, 'at': moment, 'tables': read_json(tables)})


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


def _tables_of(entry: Mapping[str, Any], path: Path) -> TablesFile:
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


# Calibrations of one machine in one convention: vectors over time with their covariances.
#
# A vector holds the motions that all runs know, at their common positions (see
# ``comparison.convention``), then C0Y, B0Z, A0Z: with the slopes that the convention takes out of
# the motions of a run, so that the vector is the errors that the run knows but for a rigid motion.

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
    """

    runs: tuple[StoredRun, ...]
    common: Common
    values: Array
    covariances: Array

    @property
    def days(self) -> Array:
        """Time of the runs, days since the first, shape (r,)."""
        first = self.runs[0].at
        return np.array([(run.at - first).total_seconds() / DAY for run in self.runs])

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Place of every motion and squareness error in the vectors."""
        parts, start = {}, 0
        for motion in self.common.motions:
            stop = start + len(self.common.position[motion.axis])
            parts[str(motion)] = slice(start, stop)
            start = stop
        for k, name in enumerate(SQUARENESS):
            parts[name] = slice(start + k, start + k + 1)
        return parts

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

    @cached_property
    def grid(self) -> Array:
        """Lattice over the common range, shape (n, 3), m."""
        return _grid(self.common)

    @cached_property
    def field_rows(self) -> Array:
        """From a vector to the errors on the grid without rigid motion, shape (3 n, m)."""
        return free_rows(self.rows(self.grid).reshape(3 * len(self.grid), -1), self.grid)

    def rows(self, q: Array) -> Array:
        """From a vector to the errors at positions (n, 3), m; shape (n, 3, m)."""
        return vector_rows(self.common, q)

    def lengths(self, vector: Array) -> Array:
        """Lengths of the error vectors on the grid, shape (n,), m."""
        return np.asarray(np.linalg.norm((self.field_rows @ vector).reshape(-1, 3), axis=1))

    def since(self, first: int) -> Series:
        """The runs from one on."""
        return Series(
            self.runs[first:], self.common, self.values[first:], self.covariances[first:]
        )


def _millimetres(offset: Array) -> str:
    return f'({", ".join(f"{1e3 * v:.1f}" for v in offset)}) mm'


def _grid(common: Common) -> Array:
    ends = [np.linspace(*_ends(common, a), GRID_POINTS) for a in common.machine.axis_names]
    return np.stack([g.ravel() for g in np.meshgrid(*ends, indexing='ij')], axis=1)


def _ends(common: Common, axis: str) -> tuple[float, float]:
    position, limits = common.position[axis], common.machine.axes[axis]
    if len(position):
        return float(position[0]), float(position[-1])
    return limits.min, limits.max


def _to_common(source: Source, common: Common) -> Array:
    """From squareness and nodes of a source to the vector of a series, shape (m, 3 + nodes).

    The squareness errors of the vector are those that leave nothing, but a rigid motion, of what
    the source knows less the motions of the vector.
    """
    first = len(SQUARENESS)
    motions = operator(source, common)
    matrix = np.hstack([np.zeros((len(motions), first)), motions])
    q = _grid(common)
    nodes: dict[str, Array] = {m: source.tables.motions[m].position for m in MOTIONS}
    own = prediction_rows(common.machine, nodes, q).reshape(3 * len(q), -1)
    start = first
    for motion in MOTIONS:
        stop = start + len(nodes[motion])
        if motion not in (*common.motions, *common.folded):
            own[:, start:stop] = 0.0
        start = stop
    parts = vector_rows(common, q).reshape(3 * len(q), -1)
    remainder = own - parts[:, :-first] @ matrix
    angles = free_rows(parts[:, -first:], q)
    return np.vstack([matrix, np.linalg.lstsq(angles, free_rows(remainder, q), rcond=None)[0]])


def series_of(runs: Sequence[StoredRun]) -> Series:
    """Bring runs of one machine to one convention.

    Raises
    ------
    ConfigError
        If they are of different machines or share nothing.
    """
    if any(run.content.tables.machine.rotary_names for run in runs):
        return _axis_series(runs)
    packed = []
    for run in runs:
        tables = run.content.tables
        size = len(SQUARENESS) + sum(len(tables.motions[m].position) for m in MOTIONS)
        packed.append(unpack_covariance(run.content.extra.get('covariance'), size))
    sources = [
        source_of_tables(run.name, run.content.tables, known)
        for run, known in zip(runs, packed, strict=True)
    ]
    common = common_ground(sources[::-1])  # at the target offset of the latest
    values, covariances = [], []
    for run, source, known in zip(runs, sources, packed, strict=True):
        square = run.content.tables.squareness
        full = _to_common(source, common)
        if known is None:
            known = np.zeros((full.shape[1], full.shape[1]))
            known[:3, :3] = np.diag([square[k].u ** 2 for k in SQUARENESS])
            known[3:, 3:] = source.covariance
        vector = np.concatenate([[square[k].value for k in SQUARENESS], source.values])
        values.append(full @ vector)
        covariances.append(full @ known @ full.T)
    return Series(tuple(runs), common, np.array(values), np.array(covariances))


# Machines with rotary axes: motions and scalars as they stand, in the gauge of our tables.

AXIS_GRID_POINTS = 4
"""Points per axis of the volume over which errors of a machine with rotary axes are judged."""


@dataclass(frozen=True)
class AxisSeries(Series):
    """Runs of one machine with rotary axes.

    A vector holds the motions that all runs know at the nodes of the latest, then squareness and
    location errors that all know.

    Attributes
    ----------
    scalars : tuple of str
    """

    scalars: tuple[str, ...] = ()

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Place of every motion, squareness and location error in the vectors."""
        ends = [len(self.common.position[m.axis]) for m in self.common.motions]
        names = [*map(str, self.common.motions), *self.scalars]
        bounds = np.cumsum([0, *ends, *(1 for _ in self.scalars)]).tolist()
        return {n: slice(a, b) for n, a, b in zip(names, bounds[:-1], bounds[1:], strict=True)}

    @cached_property
    def grid(self) -> Array:
        """Lattice over the common range, shape (n, k), m and rad."""
        machine = self.common.machine
        low, high = (np.array([self.common.position[a][k] for a in machine.axis_names])
                     for k in (0, -1))  # fmt: skip
        share = (lattice(machine, AXIS_GRID_POINTS) - machine.lower) / (
            machine.upper - machine.lower
        )
        return np.asarray(low + share * (high - low))

    @cached_property
    def field_rows(self) -> Array:
        """From a vector to the errors on the grid without rigid motion, shape (3 n, m)."""
        points = nominal_position(self.common.machine, self.grid)
        return free_rows(self.rows(self.grid).reshape(3 * len(points), -1), points)

    def rows(self, q: Array) -> Array:
        """From a vector to the errors at positions (n, k), m and rad; shape (n, 3, m)."""
        machine = self.common.machine
        seen = Sight.of_tool(machine).at(q)
        found = [
            seen.motions[m.axis][:, :, DIRECTIONS.index(m[1]), None]
            * hat_matrix(
                self.common.position[m.axis],
                machine.axes[m.axis].wrapped(q[:, machine.column(m.axis)]),
            )[:, None, :]
            for m in self.common.motions
        ]
        found += [seen.scalars[n][:, :, None] for n in self.scalars]
        return np.concatenate(found, axis=2)

    def since(self, first: int) -> AxisSeries:
        """The runs from one on."""
        return replace(
            self,
            runs=self.runs[first:],
            values=self.values[first:],
            covariances=self.covariances[first:],
        )


def _axis_series(runs: Sequence[StoredRun]) -> AxisSeries:
    """Runs of a machine with rotary axes; as ``series_of``."""
    latest = runs[-1].content.tables
    for run in runs[:-1]:
        check_one_machine((run.name, runs[-1].name), run.content.tables.machine, latest.machine)
    contents = [run.content for run in runs]
    reasons: dict[str, str] = {}
    for run in runs:
        reasons |= not_compared((run.name, runs[-1].name), run.content, runs[-1].content)
    machine = latest.machine
    motions = tuple(m for m in machine.motions if str(m) not in reasons)
    scalars = tuple(n for n in machine.scalars if n not in reasons)
    if not motions:
        raise ConfigError(
            f'the runs of {machine.name} share nothing: {next(iter(reasons.values()))}'
        )
    position = {a: latest.motions[f'EX{a}'].position for a in machine.axis_names}
    values, covariances = [], []
    for content in contents:
        vector, covariance = whole_vector(content)
        full = np.zeros((0, len(vector)))
        start = len(machine.scalars)
        place = {}
        for motion in machine.motions:
            place[motion] = slice(start, start + len(content.tables.motions[motion].position))
            start = place[motion].stop
        for motion in motions:
            rows = np.zeros((len(position[motion.axis]), len(vector)))
            own = content.tables.motions[motion].position
            rows[:, place[motion]] = hat_matrix(own, position[motion.axis])
            full = np.vstack([full, rows])
        full = np.vstack([full, np.eye(len(vector))[[machine.scalars.index(n) for n in scalars]]])
        values.append(full @ vector)
        covariances.append(full @ covariance @ full.T)
    common = Common(machine, position, {}, (), motions)
    return AxisSeries(tuple(runs), common, np.array(values), np.array(covariances), scalars)
