# SPDX-License-Identifier: Apache-2.0
"""CSV of direct measurements; the layout is described in ``direct_measurement``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.files.text_table import (
    TextTable,
    fault_words,
    is_comment,
    read_lines,
    read_text_table,
)
from otf_core.model.direct_measurement import AxisReadings, DirectMeasurement
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS

LENGTH = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}
ANGLE = {'rad': 1.0, 'urad': 1e-6, 'arcsec': np.pi / 648000}
MAX_ERROR = 0.01
"""Of the travel, rad; no machine has larger errors."""
TWO_WAYS = ('forward', 'backward')
SAME_PLACE = 5e-5
"""m; readings this close belong to one position."""
_COMMENT = re.compile(r'(point [XYZ]|target_offset|u_length_scale)\s*:\s*(.*)')
_COLUMN = re.compile(r'(position|E[XYZABC])_(\w+)')


def _columns(header: Sequence[str], where: str) -> dict[str, tuple[int, float]]:
    """Place and factor to SI of the columns of numbers."""
    places = {}
    for place, name in enumerate(header):
        match = _COLUMN.fullmatch(name)
        if match is None:
            continue
        units = ANGLE if match[1][1] in 'ABC' else LENGTH
        if match[2] not in units:
            raise ConfigError(f'{where}: {name}: unit not known; possible: {", ".join(units)}')
        places[match[1]] = (place, units[match[2]])
    lacking = [n for n in ('axis', 'run', 'direction') if n not in header]
    lacking += [] if 'position' in places else ['position_m']
    if lacking or len(places) < 2:
        raise ConfigError(
            f'{where}: header: {lacking[0] if lacking else "EX_m"}: missing; expected '
            f'axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad'
        )
    return places


def _readings(
    table: TextTable, header: Sequence[str], columns: Mapping[str, tuple[int, float]]
) -> list[tuple[str, str, str, list[float]]]:
    """Axis, run, direction and numbers, SI, of every line; an empty error was not measured."""
    read, _ = table.numbers({place: header[place] for place, _ in columns.values()})
    numbers = np.full((len(table.lines), 1 + len(DIRECTIONS)), np.nan)
    named = ('position', *(f'E{d}' for d in DIRECTIONS))
    for (name, (place, factor)), column in zip(columns.items(), read, strict=True):
        for row, fault in column.faults.items():
            if name == 'position' or table.row(row)[place]:
                raise ConfigError(
                    f'{table.where}: line {table.lines[row]}: expected a reading, but {fault}'
                )
        numbers[:, named.index(name)] = column.values * factor
    axis, run, way = (table.columns[header.index(n)] for n in ('axis', 'run', 'direction'))
    for row, line in enumerate(table.lines):
        where = f'{table.where}: line {line}'
        if way[row] not in TWO_WAYS:
            raise ConfigError(f'{where}: direction: {way[row]!r}; possible: forward, backward')
        if not np.isfinite(numbers[row, 0]) or np.any(np.isinf(numbers[row])):
            raise ConfigError(f'{where}: position and errors have to be finite')
    return list(zip(axis, run, way, numbers.tolist(), strict=True))


def _grid(rows: Sequence[tuple[str, str, list[float]]], where: str) -> tuple[Array, Array]:
    """Arrange readings of one axis: positions (k,) and values (r, 2, k, 6)."""
    place = np.sort([numbers[0] for _, _, numbers in rows])
    position = place[np.concatenate([[True], np.diff(place) > SAME_PLACE])]
    runs = sorted({run for run, _, _ in rows})
    value = np.full((len(runs), 2, len(position), 6), np.nan)
    seen = np.zeros(value.shape[:3], dtype=int)
    for run, way, numbers in rows:
        k = int(np.searchsorted(position, numbers[0] + 1e-9, side='right')) - 1
        target = (runs.index(run), TWO_WAYS.index(way), max(k, 0))
        value[target] = numbers[1:]
        seen[target] += 1
    if len(position) < 2 or np.any(seen != 1):
        bad = tuple(np.argwhere(seen != 1)[0].tolist()) if np.any(seen != 1) else (0, 0, 0)
        raise ConfigError(
            f'{where}: run {runs[bad[0]]}, {TWO_WAYS[bad[1]]}, position {position[bad[2]]:g} m: '
            f'{seen[bad]} readings; every run needs one forward and one backward at each '
            f'of two or more positions'
        )
    partly = np.isnan(value).any(axis=(0, 1, 2)) & ~np.isnan(value).all(axis=(0, 1, 2))
    if partly.any():
        raise ConfigError(f'{where}: E{DIRECTIONS[int(partly.argmax())]}: readings are missing')
    return position, value


def _comment(line: str, where: str) -> tuple[str, Array] | None:
    match = _COMMENT.fullmatch(line)
    if match is None:
        return None
    parts, size = match[2].split(','), 1 if match[1] == 'u_length_scale' else 3
    try:
        values = np.array([float(p) if p.strip() else np.nan for p in parts])
    except ValueError:
        values = np.zeros(0)
    blank = match[1].startswith('point') and not np.any(np.isinf(values))
    if values.size != size or not (blank or np.all(np.isfinite(values))):
        raise ConfigError(f'{where}: {match[1]}: expected {size} numbers, got {match[2]!r}')
    return match[1], values


def _table(path: str | Path) -> tuple[TextTable, tuple[str, ...]]:
    """The table of a file in which every line is a reading, and its header."""
    try:
        table = read_text_table(path, lambda fields: {'axis', 'direction'} <= set(fields))
    except InputError as error:
        lines = enumerate(read_lines(path), start=1)
        first = next(((n, t) for n, t in lines if t.strip() and not is_comment(t)), None)
        if first is None:
            raise ConfigError(f'{path}: holds no readings') from None
        _columns([cell.strip() for cell in first[1].split(',')], f'{path}: line {first[0]}')
        raise ConfigError(str(error)) from None
    if table.names is None:
        _columns(table.row(0), f'{path}: line {table.lines[0]}')
        raise ConfigError(f'{path}: has no header line')
    if table.faults:
        line = min(table.faults)
        raise ConfigError(f'{path}: line {line}: expected a reading; {fault_words(table.faults)}')
    return table, table.names


def _check_size(
    numbers: Sequence[float], machine: Machine, where: str, header: Sequence[str]
) -> None:
    """Refuse errors that no machine has: they are in another unit."""
    size = float(np.max(machine.upper - machine.lower))
    moved, turned = np.nanmax(np.abs([*numbers[1:4], 0.0])), np.nanmax(np.abs([*numbers[4:], 0.0]))
    if moved > MAX_ERROR * size or turned > MAX_ERROR:
        what = f'{moved:g} m' if moved > MAX_ERROR * size else f'{turned:g} rad'
        raise ConfigError(
            f'{where}: an error of {what} is implausible for a machine of {size:g} m; state its '
            f'unit in the header ({",".join(header)}), as in EX_um or EA_urad'
        )


def read_direct_csv(path: str | Path, machine: Machine) -> DirectMeasurement:
    """Read a direct measurement.

    Raises
    ------
    ConfigError
        Names file, line and what is wrong.
    """
    table, header = _table(path)
    columns = _columns(header, f'{path}: line {table.head_line}')
    stated: dict[str, Array] = {}
    notes = []
    for number, text in table.comments.items():
        known = _comment(text, f'{path}: line {number}')
        if known is None:
            notes.append(text)
        else:
            stated[known[0]] = known[1]
    rows: dict[str, list[tuple[str, str, list[float]]]] = {}
    readings = _readings(table, header, columns)
    for line, (axis, run, way, numbers) in zip(table.lines, readings, strict=True):
        if axis not in machine.axes:
            possible = ', '.join(machine.axis_names)
            raise ConfigError(f'{path}: line {line}: axis: {axis!r}; possible: {possible}')
        _check_size(numbers, machine, f'{path}: line {line}', header)
        rows.setdefault(axis, []).append((run, way, numbers))
    middle = 0.5 * (machine.lower + machine.upper)
    axes = {}
    for axis, own_rows in rows.items():
        point = stated.get(f'point {axis}', middle)
        point = np.where(np.isnan(point), middle, point)
        axes[axis] = AxisReadings(*_grid(own_rows, f'{path}: axis {axis}'), point)
    scale = float(stated.get('u_length_scale', np.zeros(1))[0])
    return DirectMeasurement(axes, stated.get('target_offset'), scale, '; '.join(notes))
