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
from otf_core.documents import Document, ResultDocument, stated
from otf_core.errors import ConfigError, InputError, ShapeError
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
class PlannedPart(Document):
    """A part of the path between two places of the reflector."""

    target: str = stated('name of the reflector')
    feed: Array = stated('of every leg', 'm/s', shape=('m',))
    dwell: Array = stated('at every corner', 's', shape=('n',))
    positions: Array = stated('of the axes at the corners', 'm or rad', shape=('n', 'axes'))
    words: str = stated('what is driven', default='')
    duration: float = stated('time it takes', 's', default=0.0)


@dataclass(frozen=True)
class Assumed(Document):
    """What the forecast assumed."""

    tracker_link: str = stated('on what the tracker stands: w, the table, or b, the bed')
    tracker_place: Array = stated('origin of the beam in its frame', 'm', shape=(3,))
    noise: Mapping[str, Any] = stated('noise of single samples, as noise.json', factory=dict)
    rate: float = stated('of the samples', 'Hz', default=0.0)
    acceleration: float = stated('of the drives', 'm/s^2', default=0.0)


@dataclass(frozen=True)
class PlanFile(ResultDocument):
    """What is driven by a plan.json."""

    axes: tuple[str, ...] = stated('columns of positions')
    parts: tuple[PlannedPart, ...] = stated('in driving order')
    assumed: Assumed = stated('by the forecast')

    @property
    def plan(self) -> Plan:
        """The plan.

        Raises
        ------
        InputError
            Names the part whose numbers do not belong together.
        """
        read = []
        for k, own in enumerate(self.parts, start=1):
            try:
                drive = AxisPath(self.axes, own.positions, own.target)
                read.append(Part(drive, own.feed, own.dwell, own.words))
            except (InputError, ShapeError) as error:
                raise InputError(f'parts: {k}: {error}') from None
        return Plan(tuple(read))


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


def read_plan(path: str | Path) -> tuple[PlanFile, Plan]:
    """Read a plan.json.

    Raises
    ------
    ConfigError
        Names the file and what is wrong with it.
    """
    data, where = read_json(path), str(path)
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise ConfigError(f"{where}: not a plan; expected the schema '{SCHEMA}' of otf plan")
    try:
        file = PlanFile.from_dict(data, where)
    except InputError as error:
        raise ConfigError(str(error)) from None
    try:
        if not file.parts:
            raise InputError('parts: none')
        return file, file.plan
    except InputError as error:
        raise ConfigError(f'{where}: {error}') from None


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
        return not read_plan(name)[1].is_plain
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
        return [part.path for part in read_plan(name)[1].parts]
    letters, positions, targets = _axis_rows(name, axes, target=True)
    if not targets:
        return [AxisPath(letters, positions)]
    ends = [0, *(k for k in range(1, len(targets)) if targets[k] != targets[k - 1]), len(targets)]
    return [AxisPath(letters, positions[a:b], targets[a]) for a, b in pairwise(ends)]


def read_target_points(file: str | Path, names: Sequence[str]) -> tuple[Array, str]:
    """Read points (n, m) of a file, a column each for these, and what its text was read as."""
    return (read_positions(file, names), '') if len(names) > 3 else read_points(file)


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
        plan = read_plan(name)[1]
        if not plan.is_plain:
            raise ConfigError(f'{name}: {ROTARY_WORDS}')
        return plan.parts[0].path.points, ''
    if is_program(name):
        program = read_program(name)
        return program.points, f'{name}: {program.said}'
    return read_points(name)
