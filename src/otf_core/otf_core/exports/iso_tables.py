# SPDX-License-Identifier: Apache-2.0
"""Tables of other systems read: Etalon exchange format and ISG CSV.

Form, units and names as ``iso_names`` writes them, with its sources. What these formats leave open
is taken for this, and said: values are errors (actual minus nominal) unless ``sign`` is
'correction'; they hold at the ``target_offset`` of machine.yaml; between grid points straight
lines, outside the value of the last one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.exports.iso_names import value_unit
from otf_core.exports.terms import control_unit
from otf_core.files.message_text import shortened
from otf_core.files.text_table import read_lines
from otf_core.model.machine import Machine
from otf_core.model.motions import is_motion
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError

ERROR, CORRECTION = SIGNS = ('error', 'correction')
BLOCK = re.compile(r'\[\s*(\w+)\s*\]$')
OWN_SIGN = 'sign: values are {}s'
"""In the comments of files that otf wrote."""
CENTRE = re.compile(r'P([XYZ])([ABC])$')
"""Constants of ISG CSV that repeat where an axis turns."""
SAME_CENTRE = 1e-6
"""m; centres of rotation in file and machine.yaml that differ by less are one."""


@dataclass(frozen=True)
class IsoTables:
    """What a file holds, in its own units.

    Attributes
    ----------
    scalars : mapping of name to float
    motions : mapping of name to (argument, value), each of shape (k,)
    """

    scalars: Mapping[str, float]
    motions: Mapping[str, tuple[Array, Array]]


def holds_iso_tables(path: str | Path) -> bool:
    """Return whether a text is in one of both formats, by its first lines."""
    first = [line for _, line in _lines(read_lines(path))][:1]
    words = first[0].split() if first else []
    return bool(words) and (
        BLOCK.match(first[0]) is not None
        or any(is_motion(word) for word in words)
        or all(re.match(r'(?:[XYZABC]0[XYZABC]|P[XYZ][ABC])$', word) for word in words)
    )


def read_iso_tables(
    path: str | Path, machine: Machine, sign: str | None = None
) -> tuple[ErrorTables, tuple[str, ...]]:
    """Read error tables of a machine, without uncertainties.

    Parameters
    ----------
    sign : 'error' or 'correction', optional
        What the values are; errors if not given.

    Returns
    -------
    tables : ErrorTables
        Motions that the file does not hold are not identifiable.
    remarks : tuple of str
        What was taken for what.

    Raises
    ------
    ConfigError
        Names the line that is no part of such a file, or the error that is none of the machine.
    """
    text = read_lines(path)
    lines = list(_lines(text))
    etalon = any(BLOCK.match(line) for _, line in lines)
    held = _etalon(path, lines) if etalon else _isg(path, lines)
    stated = next((s for s in SIGNS if OWN_SIGN.format(s) in '\n'.join(text)), None)
    if sign and stated and sign != stated:
        raise ConfigError(f'{path}: --sign {sign}: the file states that its values are {stated}s')
    sign = sign or stated
    factor = -1.0 if sign == CORRECTION else 1.0
    known = {*machine.scalars, *map(str, machine.motions)}
    for name in (*held.scalars, *held.motions):
        if (name in held.motions) != is_motion(name):
            raise ConfigError(
                f'{path}: {name}: an error motion is a table over its axis, a squareness or '
                f'location error one number'
            )
        if centre := CENTRE.match(name):
            _check_centre(path, machine, centre[2], centre[1], held.scalars[name])
        elif name not in known:
            raise ConfigError(
                f'{path}: {name} is no error of {machine.name} with the chain {machine.chain}; '
                f'does the file belong to this machine?'
            )
    motions: dict[str, MotionTable] = {}
    for motion in machine.motions:
        axis, seen = machine.axes[motion.axis], motion in held.motions
        ends = np.array([axis.min, axis.max])
        if seen:
            argument, own = held.motions[motion]
            ends = argument / control_unit(machine, motion.axis)
            outside = float(np.maximum(axis.min - ends, ends - axis.max).max())
            if outside > axis.max - axis.min:
                raise ConfigError(
                    f'{path}: {motion}: reaches {outside:.4g} {axis.unit} beyond axis '
                    f'{motion.axis}; arguments are in mm, of rotary axes in degrees'
                )
        value = factor * own / value_unit(motion) if seen else np.zeros(2)
        motions[motion] = MotionTable(ends, value, np.zeros(len(ends)), seen)
    scalars = {
        name: ScalarError(
            factor * held.scalars.get(name, 0.0) / value_unit(name),
            identifiable=name in held.scalars,
        )
        for name in machine.scalars
    }
    words = [
        f'values are read as {sign or ERROR}s'
        + ('' if sign else ' (actual minus nominal), which the format does not state: '
           '--sign correction reads them as corrections'),
        'they hold at the target_offset of machine.yaml; the format states no uncertainty',
    ]  # fmt: skip
    if missing := [str(n) for n in known if n not in held.scalars and n not in held.motions]:
        words.append(f'not in the file: {", ".join(sorted(missing))}')
    square, location = (
        {name: scalars[name] for name in own} for own in (machine.squareness, machine.location)
    )
    return ErrorTables(machine, motions, square, location), tuple(words)


def _lines(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Numbers and texts of the lines that are no comments; a line ``#`` begins a block."""
    for number, line in enumerate(lines, start=1):
        text = line.partition('//')[0].strip()
        if text:
            yield number, text


def _numbers(path: str | Path, number: int, text: str) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if not values or not np.all(np.isfinite(values)):
        raise ConfigError(f'{path}: line {number}: expected numbers, got {shortened(text, 60)!r}')
    return values


def _table(path: str | Path, name: str, rows: list[list[float]]) -> tuple[Array, Array]:
    """Arguments and values of a motion, ascending."""
    if not rows or any(len(row) != 2 for row in rows):
        raise ConfigError(f'{path}: {name}: expected lines of an argument and a value')
    argument, value = np.array(sorted(rows)).T
    if np.any(np.diff(argument) <= 0.0):
        raise ConfigError(f'{path}: {name}: an argument stands there twice')
    return argument, value


def _etalon(path: str | Path, lines: list[tuple[int, str]]) -> IsoTables:
    scalars: dict[str, float] = {}
    motions: dict[str, tuple[Array, Array]] = {}
    name, rows = '', list[list[float]]()
    inside = False
    for number, text in lines:
        here = f'{path}: line {number}'
        key, _, given = (part.strip() for part in text.partition('='))
        if block := BLOCK.match(text):
            name = block[1]
            if name in scalars or name in motions or inside:
                raise ConfigError(f'{here}: [{name}] begins within a block or for a second time')
        elif inside and text == '}':
            motions[name], inside = _table(path, name, rows), False
        elif inside:
            rows.append(_numbers(path, number, text))
        elif key == 'VALUE' and name:
            values = _numbers(path, number, given)
            if len(values) > 1:
                raise ConfigError(f'{here}: expected one number, got {shortened(given, 60)!r}')
            scalars[name] = values[0]
        elif key == 'Gridpoints' and given == '{' and name:
            rows, inside = [], True
        else:
            raise ConfigError(
                f'{here}: {shortened(text, 60)!r} is neither [NAME], VALUE = number nor '
                f'Gridpoints = {{ ... }}'
            )
    if inside:
        raise ConfigError(f'{path}: the table of {name} has no end; is the file whole?')
    return IsoTables(scalars, motions)


def _isg(path: str | Path, lines: list[tuple[int, str]]) -> IsoTables:
    scalars: dict[str, float] = {}
    motions: dict[str, tuple[Array, Array]] = {}
    blocks: list[list[tuple[int, str]]] = [[]]
    for line in lines:
        if line[1] == '#':
            blocks.append([])
        else:
            blocks[-1].append(line)
    for block in filter(None, blocks):
        (number, head), *rest = block
        names = head.split()
        rows = [_numbers(path, k, text) for k, text in rest]
        for (k, _), row in zip(rest, rows, strict=True):
            if len(row) != len(names):
                raise ConfigError(f'{path}: line {k}: {len(row)} numbers under {len(names)} names')
        arguments = [name for name in names if len(name) == 1]
        if not arguments and len(rows) == 1:
            scalars |= dict(zip(names, rows[0], strict=True))
        elif len(arguments) == 1 and names[0] == arguments[0]:
            for k, name in enumerate(names[1:], start=1):
                if name in motions or name[-1] != names[0]:
                    raise ConfigError(
                        f'{path}: line {number}: {name} over {names[0]}: error motions are tables '
                        f'over their own axis, each one once'
                    )
                motions[name] = _table(path, name, [[row[0], row[k]] for row in rows])
        else:
            raise ConfigError(
                f'{path}: line {number}: a table over {", ".join(arguments) or "no axis"} is not '
                f'read; error motions are tables over their own axis'
            )
    return IsoTables(scalars, motions)


def _check_centre(path: str | Path, machine: Machine, axis: str, along: str, value: float) -> None:
    """Refuse a centre of rotation that is not that of machine.yaml."""
    spec = machine.axes.get(axis)
    own = None if spec is None else spec.centre['XYZ'.index(along)]
    if own is None or abs(1e-3 * value - own) > SAME_CENTRE:
        raise ConfigError(
            f'{path}: P{along}{axis} = {value:g} mm is not the centre of {axis} in machine.yaml'
        )
