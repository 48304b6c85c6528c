# SPDX-License-Identifier: Apache-2.0
"""Direct measurement of error motions (paper 2.3): six errors along each axis, several runs.

An instrument measures along one line per linear axis, rotary axes at zero, so its translations
hold the rotations of the axis times the lever of that line (Abbe). With the measured rotations the
lever is taken off: t = measured - r x L. Of a rotary axis the readings are its error motions at
its centre, as they stand.

CSV layout, one row a reading::

    # point Y: 0.3,,-0.2
    # target_offset: 0.0,0.0,-0.15
    axis,run,direction,position_m,EX_m,EY_m,EZ_m,EA_rad,EB_rad,EC_rad
    X,1,forward,0.0,0.0,0.0,0.0,0.0,0.0,0.0

``direction`` is forward or backward. Units stand in the header, as in every text table;
positions of rotary axes are angles, in a file of their own. Columns of errors the instrument lacks
may be left out. Comment lines state where it was done: ``point A`` the positions of the linear
axes, m, and ``target_offset`` the measured point, m, as in machine.yaml; left out, mid-range and
the machine's, with a remark. ``u_length_scale`` is the standard uncertainty of the instrument's
length unit, m/m; 0 if left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened
from otf_core.files.text_table import (
    ANGLES,
    LENGTHS,
    TextTable,
    fault_words,
    is_comment,
    read_lines,
    read_text_table,
    split_heading,
)
from otf_core.model.chain import Sight
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError

MAX_ERROR = 0.01
"""Of the travel, rad; no machine has larger errors."""
TWO_WAYS = ('forward', 'backward')
FURTHEST_TARGET = 5.0
"""m; a target is nearer to the spindle."""
TARGET_OFFSET, LENGTH_SCALE = 'target_offset', 'u_length_scale'
SAME_PLACE = 5e-5
"""m and rad; readings this close belong to one position."""
LARGEST_SCALE = 1e-3
"""m/m; no length unit of an instrument is known to less."""
_COMMENT = re.compile(
    r'(point[ _]*[XYZ]|target[ _]*offset|u[ _]*length[ _]*scale)\s*[:=]\s*(.*)', re.IGNORECASE
)


@dataclass(frozen=True)
class AxisReadings:
    """Readings along one axis.

    Attributes
    ----------
    position : ndarray, shape (k,), m or rad
        Positions, ascending.
    value : ndarray, shape (r, 2, k, 6), m and rad
        Runs, forward and backward, positions, errors X Y Z A B C; nan where not measured.
    point : ndarray, shape (a,), m and rad
        Positions of all axes; that of the measured axis counts for nothing.
    """

    position: Array
    value: Array
    point: Array

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which of the six errors were measured, shape (6,)."""
        return np.asarray(np.isfinite(self.value).any(axis=(0, 1, 2)))


@dataclass(frozen=True)
class DirectMeasurement:
    """A direct measurement of a machine: readings of the axes that were measured.

    Attributes
    ----------
    axes : mapping of axis name to AxisReadings
    target_offset : ndarray, shape (3,), m, or None
        Measured point; None if it is the machine's.
    u_length_scale : float
        m/m, standard uncertainty of the instrument's length unit.
    remarks : tuple of str
        What was assumed, and comments.
    """

    axes: Mapping[str, AxisReadings]
    target_offset: Array | None = None
    u_length_scale: float = 0.0
    remarks: tuple[str, ...] = ()


def _relative_to_own_mean(rows: Array) -> Array:
    """Take the offset of every run off: where an instrument is set to zero is no error."""
    offset = rows.mean(axis=(1, 2), keepdims=True)
    return np.asarray(rows - offset + offset.mean())


def motion_readings(measurement: DirectMeasurement, machine: Machine) -> dict[ErrorMotion, Array]:
    """Return each measured error motion with the Abbe lever taken off, shape (r, 2, k).

    Raises
    ------
    InputError
        If a translation was measured on a lever but a rotation that acts on it was not.
    """
    offset = measurement.target_offset
    at = machine if offset is None else replace(machine, target_offset=offset)
    by_motion: dict[ErrorMotion, Array] = {}
    for axis, readings in measurement.axes.items():
        q = np.tile(readings.point, (len(readings.position), 1))
        q[:, machine.column(axis)] = readings.position
        value = readings.value.copy()
        six = Sight.of_tool(at).at(q).motions[axis]
        for k in range(3, 6) if not machine.axes[axis].rotary else ():
            lever = six[:, :, k]
            if readings.measured[k]:
                value[..., :3] -= readings.value[..., k, None] * lever
            elif np.abs(lever).max() > 1e-3:
                raise InputError(
                    f'axis {axis}: E{DIRECTIONS[k]}{axis} was not measured, but acts on the '
                    f'measured point over {1e3 * np.abs(lever).max():.0f} mm'
                )
        for letter, column, known in zip(
            DIRECTIONS, np.moveaxis(value, -1, 0), readings.measured, strict=True
        ):
            if known:
                by_motion[ErrorMotion(letter, axis)] = _relative_to_own_mean(column)
    return by_motion


def _standard_uncertainty(rows: Array) -> float:
    """Of the means of readings (r, 2, k): scatter of the runs, pooled over positions."""
    both = rows.mean(axis=1)
    if len(both) < 2:
        return 0.0
    places = both.shape[1]  # each run has lost its mean over them
    variance = both.var(axis=0, ddof=1).mean() * places / max(places - 1, 1)
    return float(np.sqrt(variance / len(both)))


def tables_of_measurement(
    measurement: DirectMeasurement, machine: Machine
) -> tuple[ErrorTables, Array]:
    """Error tables of the means of a direct measurement; scalars and what lacks are zero.

    Returns
    -------
    tables : ErrorTables
        Of the measured point; what was not measured is not identifiable.
    covariance : ndarray, shape (m, m)
        Of scalars and nodes: scatter of the runs, and the length unit that all positions of an
        axis share.
    """
    motions = motion_readings(measurement, machine)
    tables: dict[str, MotionTable] = {}
    blocks = [np.zeros((len(machine.scalars),) * 2)]
    for name in machine.motions:
        rows, axis = motions.get(name), machine.axes[name.axis]
        if rows is None:
            none = np.zeros(2)
            tables[name] = MotionTable(np.array([axis.min, axis.max]), none, none, False)
            blocks.append(np.zeros((2, 2)))
            continue
        position = measurement.axes[name.axis].position
        block = np.eye(len(position)) * _standard_uncertainty(rows) ** 2
        if name.is_positioning and name.is_translation:
            travel = measurement.u_length_scale * (position - position[0])
            block += np.outer(travel, travel)
        tables[name] = MotionTable(position, rows.mean(axis=(0, 1)), np.sqrt(np.diag(block)))
        blocks.append(block)
    if measurement.target_offset is not None:
        machine = replace(machine, target_offset=measurement.target_offset)
    squareness = {k: ScalarError() for k in machine.squareness}
    location = {k: ScalarError(identifiable=False) for k in machine.location}
    return ErrorTables(machine, tables, squareness, location), block_diag(*blocks)


# The file.


def _columns(header: Sequence[str], where: str) -> dict[str, tuple[int, float]]:
    """Place and factor to SI of the columns of numbers."""
    places = {}
    for place, name in enumerate(header):
        what, unit = split_heading(name)
        if what != 'position' and what[1:] not in DIRECTIONS:
            continue
        units = ANGLES if what[1:] in 'ABC' else LENGTHS
        if what == 'position':
            units = {**LENGTHS, **ANGLES}
        if unit not in units:
            raise ConfigError(f'{where}: {name}: unit not known; possible: {", ".join(units)}')
        places[what] = (place, units[unit])
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
            f'{where}: run {runs[bad[0]]}, {TWO_WAYS[bad[1]]}, position {position[bad[2]]:g}: '
            f'{seen[bad]} readings; every run needs one forward and one backward at each '
            f'of two or more positions'
        )
    partly = np.isnan(value).any(axis=(0, 1, 2)) & ~np.isnan(value).all(axis=(0, 1, 2))
    if partly.any():
        raise ConfigError(f'{where}: E{DIRECTIONS[int(partly.argmax())]}: readings are missing')
    return position, value


def _comment(line: str, where: str, linear: int) -> tuple[str, Array] | None:
    match = _COMMENT.fullmatch(line.strip())
    if match is None:
        return None
    parts = match[2].split(',')
    letters = re.sub('[ _]', '', match[1]).lower()
    name = {'targetoffset': TARGET_OFFSET, 'ulengthscale': LENGTH_SCALE}.get(letters)
    size = 3 if name == TARGET_OFFSET else 1 if name else linear
    name = name or f'point {letters[-1].upper()}'
    try:
        values = np.array([float(p) if p.strip() else np.nan for p in parts])
    except ValueError:
        values = np.zeros(0)
    blank = name not in (TARGET_OFFSET, LENGTH_SCALE) and not np.any(np.isinf(values))
    if values.size != size or not (blank or np.all(np.isfinite(values))):
        raise ConfigError(f'{where}: {name}: expected {size} numbers, got {match[2]!r}')
    if name == LENGTH_SCALE and values[0] > LARGEST_SCALE:
        raise ConfigError(
            f'{where}: {name}: {values[0]:g} m/m is {100 * values[0]:g} % of every length; is it '
            f'in ppm? write {1e-6 * values[0]:g}'
        )
    return name, values


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
    travels = [axis.max - axis.min for axis in machine.axes.values() if not axis.rotary]
    size = max(travels, default=1.0)
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
    turning = split_heading(header[columns['position'][0]])[1] in ANGLES
    linear = len(machine.axis_names) - len(machine.rotary_names)
    stated: dict[str, Array] = {}
    remarks: list[str] = []
    for number, text in table.comments.items():
        known = _comment(text, f'{path}: line {number}', linear)
        if known is None:
            remarks.append(f'line {number} says nothing to otf: {shortened(text, 60)!r}')
        else:
            stated[known[0]] = known[1]
    rows: dict[str, list[tuple[str, str, list[float]]]] = {}
    readings = _readings(table, header, columns)
    for line, (axis, run, way, numbers) in zip(table.lines, readings, strict=True):
        if axis not in machine.axes:
            possible = ', '.join(machine.axis_names)
            raise ConfigError(f'{path}: line {line}: axis: {axis!r}; possible: {possible}')
        if machine.axes[axis].rotary != turning:
            unit = 'm' if turning else 'deg'
            raise ConfigError(
                f'{path}: line {line}: axis {axis}: rotary and linear axes need a file each; its '
                f'positions belong in a column position_{unit}'
            )
        _check_size(numbers, machine, f'{path}: line {line}', header)
        rows.setdefault(axis, []).append((run, way, numbers))
    middle = 0.5 * (machine.lower + machine.upper)[:linear]
    axes = {}
    for axis, own_rows in rows.items():
        given = f'point {axis}' in stated
        if not given and linear > 1 and not turning:
            remarks.append(f'no line "# point {axis}: ...": measured in the middle of the ranges')
        point = stated.get(f'point {axis}', middle)
        point = np.where(np.isnan(point), middle, point)
        _check_inside(machine, point, f'{path}: point {axis}')
        point = np.append(point, np.zeros(len(machine.rotary_names)))
        axes[axis] = AxisReadings(*_grid(own_rows, f'{path}: axis {axis}'), point)
    offset = stated.get(TARGET_OFFSET)
    if offset is not None and np.abs(offset).max() > FURTHEST_TARGET:
        raise ConfigError(f'{path}: {TARGET_OFFSET}: {offset.tolist()} m; is it in mm?')
    scale = float(stated.get(LENGTH_SCALE, np.zeros(1))[0])
    return DirectMeasurement(axes, offset, scale, tuple(remarks))


def _check_inside(machine: Machine, point: Array, where: str) -> None:
    """Refuse a place outside of the ranges of the linear axes."""
    linear = len(point)
    out = np.maximum(machine.lower[:linear] - point, point - machine.upper[:linear])
    if out.max() > 1e-3:
        axis = machine.axis_names[int(out.argmax())]
        raise ConfigError(
            f'{where}: lies {out.max():g} m outside the range of axis {axis}; is it in mm?'
        )
