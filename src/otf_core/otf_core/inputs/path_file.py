# SPDX-License-Identifier: Apache-2.0
"""A path from a file: plan.json of otf plan, the NC program that was driven, or corner points.

Of a machine with rotary axes: its plan.json, or a CSV of axis positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened
from otf_core.files.strict_yaml import read_json
from otf_core.files.text_table import LENGTHS, TextTable, fault_words, known_lengths
from otf_core.files.writing import refuse_pipe
from otf_core.inputs.columns import Columns, named_columns, read_table, unnamed_words
from otf_core.inputs.nc_program import is_program, read_program
from otf_core.model.axis_path import AxisPath
from otf_core.model.motions import AXES, LETTERS, ROTARY
from otf_core.model.plan import Part, Plan

# Reads what ``otf plan`` wrote: plan.json (``otf-plan/2``) with parts, feeds and dwells.

SCHEMA = 'otf-plan/2'
MAX_HEADER = 10_000
"""Characters of a first line that are read to see what a file is."""


ROTARY_WORDS = (
    'holds positions of rotary axes, but a machine with three linear axes is expected: do the '
    'files belong together?'
)


@dataclass(frozen=True)
class PlanFile:
    """Content of a plan.json.

    Attributes
    ----------
    link : str
        On what the tracker stands.
    tracker_place : ndarray, shape (3,), m
        Beam origin in the frame of that link that the forecast assumed.
    """

    plan: Plan
    link: str
    tracker_place: Array


def looks_like_json(path: str | Path) -> bool:
    """Return whether a file starts as a JSON object; False if it cannot be read.

    Raises
    ------
    ConfigError
        If it is a pipe.
    """
    refuse_pipe(path)
    try:
        with open(path, 'rb') as file:
            return file.read(64).lstrip(b'\xef\xbb\xbf \t\r\n').startswith(b'{')
    except OSError:
        return False


def _numbers(data: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Array:
    """Array of a shape, -1 standing for any length; ConfigError names the key."""
    words = ' x '.join('n' if n < 0 else str(n) for n in shape)
    words = f'{words} finite numbers' if shape else 'a finite number'
    try:
        values = np.array(data[key], dtype=float)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ConfigError(f'{where}: {key}: expected {words}') from None
    fits = values.ndim == len(shape) and all(
        wanted in (-1, n) for wanted, n in zip(shape, values.shape, strict=True)
    )
    if not fits or not np.all(np.isfinite(values)):
        raise ConfigError(f'{where}: {key}: expected {words}')
    return values


def read_plan(path: str | Path) -> PlanFile:
    """Read a plan.json.

    Raises
    ------
    ConfigError
        Names the file and what is wrong with it.
    """
    data, where = read_json(path), str(path)
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise ConfigError(f"{where}: not a plan; expected the schema '{SCHEMA}' of otf plan")
    axes, parts, assumed = (data.get(key) for key in ('axes', 'parts', 'assumed'))
    if not isinstance(axes, list) or not isinstance(parts, list) or not parts:
        raise ConfigError(f'{where}: axes, parts: expected lists as otf plan writes them')
    read = []
    for k, entry in enumerate(parts, start=1):
        here = f'{where}: parts: {k}'
        if not isinstance(entry, Mapping) or not isinstance(entry.get('target'), str):
            raise ConfigError(f'{here}: target: missing')
        positions = _numbers(entry, 'positions', (-1, len(axes)), here)
        feed = _numbers(entry, 'feed', (len(positions) - 1,), here)
        dwell = _numbers(entry, 'dwell', (len(positions),), here)
        try:
            drive = AxisPath(tuple(map(str, axes)), positions, entry['target'])
            read.append(Part(drive, feed, dwell, str(entry.get('words', ''))))
        except InputError as error:
            raise ConfigError(f'{here}: {error}') from None
    if not isinstance(assumed, Mapping) or not isinstance(assumed.get('tracker_link'), str):
        raise ConfigError(f'{where}: assumed: tracker_link: missing')
    place = _numbers(assumed, 'tracker_place', (3,), f'{where}: assumed')
    return PlanFile(Plan(tuple(read)), assumed['tracker_link'], place)


# Points from a text: CSV in m with the header x,y,z, or any table that says what it holds.


def read_points(name: str | Path) -> tuple[Array, str]:
    """Points (n, 3), m, and what the text was read as; empty for a plain CSV.

    Separator, decimal comma, case and units of the head are found out; m where it states none.
    Of a nominal and a measured point the nominal one is taken. Every line has to be a point.

    Raises
    ------
    ConfigError
        If the file cannot be read, names no points, or a line is none.
    """
    try:
        table = read_table(name)
        if _are_axes({n.strip().lower() for n in table.names or ()}):
            raise ConfigError(f'{name}: {ROTARY_WORDS}')
        columns = named_columns(table, nominal=True)
        if columns is None:
            raise ConfigError(
                f'{unnamed_words(table)}; write there what they are, as in x_mm,y_mm,z_mm'
            )
        if columns.polar:
            raise ConfigError(f'{name}: holds polar coordinates; expected x, y, z')
        return _points(table, columns)
    except InputError as error:
        raise ConfigError(f'{error} (expected the header x,y,z, in m, or with units)') from None


def holds_axis_positions(name: str | Path) -> bool:
    """Return whether a file is a plan.json or a CSV of axis positions, not of points.

    A CSV is one if it has rotary axes or names targets.
    """
    if looks_like_json(name):
        return not read_plan(name).plan.is_plain
    try:
        with open(name, encoding='utf-8-sig') as file:
            head = {word.strip().lower() for word in file.readline(MAX_HEADER).split(',')}
    except (OSError, UnicodeDecodeError):
        return False
    return _are_axes(head) or (head == {'target', *map(str.lower, AXES)})


def _are_axes(names: Set[str]) -> bool:
    """Return whether names of columns are letters of axes, rotary ones among them."""
    linear = {a.lower() for a in AXES}
    rotary = {a.lower() for a in ROTARY}
    return linear < names and bool(names & rotary) and names <= linear | rotary | {'target'}


def read_axis_paths(name: str | Path, axes: Sequence[str] = ()) -> list[AxisPath]:
    """Parts of a run: a plan.json, or a CSV of axis positions.

    The header holds the letters of the axes. A column ``target`` names the reflector in view;
    where it changes, another part begins.

    Parameters
    ----------
    axes : sequence of str, optional
        Axes of the machine; otherwise those that the file names.

    Raises
    ------
    ConfigError
        If the file cannot be read, has another header, or a line is no position.
    """
    if looks_like_json(name):
        return [part.path for part in read_plan(name).plan.parts]
    letters, positions, targets = _axis_rows(name, axes, target=True)
    if not targets:
        return [AxisPath(letters, positions)]
    ends = [0, *(k for k in range(1, len(targets)) if targets[k] != targets[k - 1]), len(targets)]
    return [AxisPath(letters, positions[a:b], targets[a]) for a, b in pairwise(ends)]


def read_positions(name: str | Path, axes: Sequence[str]) -> Array:
    """Axis positions (n, k), m and rad, of a CSV with the letters of the axes as its header.

    Raises
    ------
    ConfigError
        If the file cannot be read, has another header, or a line is no position.
    """
    return _axis_rows(name, axes)[1]


def _axis_rows(
    name: str | Path, axes: Sequence[str], *, target: bool = False
) -> tuple[tuple[str, ...], Array, list[str]]:
    """Letters, positions (n, k) and, if there may be such a column, targets of a CSV."""
    try:
        lines = Path(name).read_text(encoding='utf-8-sig').splitlines() or ['']
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f'{name}: cannot be read ({error})') from None
    head = [word.strip().lower() for word in lines[0].split(',')]
    letters = tuple(axes) or tuple(a for a in LETTERS if a.lower() in head)
    named = ['target'] if target and 'target' in head else []
    if sorted(head) != sorted([*map(str.lower, letters), *named]):
        raise ConfigError(
            f'{name}: has the header {shortened(",".join(head), 60)!r}; expected '
            f'{",".join(letters).lower()}, in m and rad'
        )
    order = [head.index(a.lower()) for a in letters]
    rows, targets = [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = line.split(',')
        try:
            values = [float(cells[k]) for k in order] if len(cells) == len(head) else []
        except ValueError:
            values = []
        if not values or not np.all(np.isfinite(values)):
            raise ConfigError(
                f'{name}: line {number}: expected {len(order)} numbers, got '
                f'{shortened(line, 60)!r}'
            )
        rows.append(values)
        targets += [cells[head.index(word)].strip() for word in named]
    if not rows:
        raise ConfigError(f'{name}: holds no positions')
    return letters, np.array(rows), targets


def _points(table: TextTable, columns: Columns) -> tuple[Array, str]:
    read, commas = table.numbers({c.place: c.name for c in columns.point})
    faults = dict(table.faults)
    for column in reversed(read):
        faults |= {table.lines[row]: reason for row, reason in column.faults.items()}
    if faults:
        raise ConfigError(
            f'{table.where}: line {min(faults)}: expected numbers like the other lines: '
            f'{fault_words(faults)}; every line has to be a point'
        )
    stated = {c.unit for c in columns.point}
    if len(stated) > 1 or not stated <= {*LENGTHS, None}:
        given = ' and '.join(sorted(map(repr, stated)))
        raise ConfigError(f'{table.where}: x, y, z are in {given}; expected {known_lengths()}')
    unit = stated.pop()
    points = np.stack([c.values for c in read], axis=1)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise ConfigError(f'{table.where}: line {table.lines[bad[0]]}: not finite numbers')
    names = [c.name for c in columns.point]
    if unit is None and not commas and names == ['x', 'y', 'z'] and table.separator == ',':
        return points, ''
    words = f'{table.where}: x, y, z from {", ".join(names)} in {unit or "m"}'
    words += ', with decimal commas' if commas else ''
    words += ''.join(f'; {remark}' for remark in columns.remarks)
    return points * LENGTHS[unit or 'm'], words


def read_path(name: str | Path) -> tuple[Array, str]:
    """Corner points of a path, shape (n, 3), m, and what the file was read as.

    A text of points holds x, y, z in m, or in the unit that its head states. The words are empty
    for a plan and for a plain CSV.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not a plan, holds a line that is not a point, or is an NC
        program that drives otherwise than along lines and arcs of X, Y, Z.
    InputError
        If the text holds no points.
    """
    if looks_like_json(name):
        plan = read_plan(name).plan
        if not plan.is_plain:
            raise ConfigError(f'{name}: {ROTARY_WORDS}')
        return plan.parts[0].path.points, ''
    if is_program(name):
        program = read_program(name)
        return program.points, f'{name}: {program.said}'
    return read_points(name)
