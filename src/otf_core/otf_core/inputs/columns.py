# SPDX-License-Identifier: Apache-2.0
"""Which column of a table is what, and in which unit: as named in its head, or on request."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from otf_core.errors import ConfigError, InputError
from otf_core.inputs.text_table import TextTable, is_value, split

LENGTHS = {'m': 0, 'dm': -1, 'cm': -2, 'mm': -3, 'um': -6, 'µm': -6, 'μm': -6}
TIMES = {
    's': 0, 'sec': 0, 'secs': 0, 'second': 0, 'seconds': 0, 'ms': -3, 'msec': -3,
    'us': -6, 'usec': -6, 'µs': -6, 'ns': -9, 'nsec': -9, 'nsecs': -9, 'nanosec': -9,
}  # fmt: skip
"""Units and the power of ten that takes them to m and s."""
OTHER_LENGTHS = ('in', 'inch', 'inches', 'mil', 'mils', 'ft', 'foot', 'feet', 'nm', 'km')
OTHERS = (*OTHER_LENGTHS, 'deg', 'gon', 'rad', 'min', 'minute', 'minutes', 'h', 'hour', 'hours')
"""Units that a head may state and nothing is read in: refused, never taken for another."""
UNIT = re.compile(r'^(?P<name>.*?)\s*[\[({<]\s*(?P<unit>[^\])}>]*)\s*[\])}>]\s*$')
SUFFIX = re.compile(r'^(?P<name>.+)_(?P<unit>m|mm|cm|um|s|sec|ms|us|ns)$')
NO_POINT = re.compile(r'rot|quat|orient|cov|std|dif|dev|err|sigma|^u[-_ ]|^r[xyz]$|nominal')
POINT = re.compile(
    r'^(?:.*[._:/\s-])?(?P<axis>[xyz])(?:[_ ]?(?:t|coord(?:inate)?|pos(?:ition)?))?$'
)
TIME = re.compile(
    r'^(?:.*[._:/\s])?(?:t|time|zeit|timestamp|time ?stamp|stamp|datetime|date ?time|utc|uhrzeit|'
    r'secs?|nsecs?|nanosec|seconds|sekunden)$'
)
FIXED = {'dval1': 'x', 'dval2': 'y', 'dval3': 'z'}
"""Names in results of a tracker controller (emScon: Cartesian, right-handed)."""
AXES_WITH_UNIT = re.compile(
    rf'\bx\b.*\by\b.*\bz\b.*[\[(]\s*({"|".join((*LENGTHS, *OTHER_LENGTHS))})\s*[\])]', re.I
)


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes
    ----------
    place : int
        From 0.
    unit : str or None
        None: not stated.
    name : str
        As in the file, for messages.
    """

    place: int
    unit: str | None
    name: str


@dataclass(frozen=True)
class Columns:
    """Columns of a recording.

    Attributes
    ----------
    point : tuple of 3 Column
        x, y, z.
    time : tuple of Column
        Several are added up (s and ns); none: not recorded.
    """

    point: tuple[Column, Column, Column]
    time: tuple[Column, ...]


def _parted(text: str) -> tuple[str, str | None]:
    """Name and unit of a heading."""
    text = text.strip().lstrip('%').strip()
    match = UNIT.match(text) or SUFFIX.match(text)
    if match is None:
        return text.lower(), None
    unit = match['unit'].strip()
    if not match['name'].strip():
        return unit.lower(), None
    return match['name'].strip().lower(), unit.lower() if _is_unit(unit) else None


def _is_unit(text: str) -> bool:
    return text.lower() in (*LENGTHS, *TIMES, *OTHERS)


def _what(name: str) -> str | None:
    """'x', 'y', 'z', 'time' or None for a heading without its unit."""
    if name in FIXED:
        return FIXED[name]
    if NO_POINT.search(name):
        return None
    match = POINT.match(name)
    if match:
        return match['axis']
    return 'time' if TIME.match(name) else None


def _unit_of_time(name: str) -> str | None:
    last = re.split(r'[._:/\s]', name)[-1]
    return last if last in TIMES else None


def columns_of(headings: Sequence[str]) -> Columns | None:
    """Columns by their headings; None if they do not name a point."""
    found: dict[str, list[Column]] = {}
    for place, heading in enumerate(headings):
        name, unit = _parted(heading)
        what = _what(name)
        if what is None:
            continue
        stated = unit or (_unit_of_time(name) if what == 'time' else None)
        if what == 'time' and stated in LENGTHS:
            stated = None
        found.setdefault(what, []).append(Column(place, stated, heading.strip()))
    if not all(axis in found for axis in 'xyz'):
        return None
    return Columns((found['x'][0], found['y'][0], found['z'][0]), _times(found.get('time', [])))


def _times(found: list[Column]) -> tuple[Column, ...]:
    """The best time: of the measurement rather than of its reception; s and ns together."""
    stamps = [c for c in found if 'stamp' in c.name.lower()] or found
    whole = [c for c in stamps if c.unit == 's' or (c.unit or '').startswith('sec')]
    parts = [c for c in stamps if (c.unit or '').startswith(('ns', 'nano'))]
    if whole and parts and len(stamps) > 1:
        return whole[0], parts[0]
    return tuple(stamps[:1])


def find_columns(table: TextTable, wanted: str | None) -> Columns:
    """Find the columns of a table.

    Parameters
    ----------
    table : TextTable
    wanted : str, optional
        What stands in the columns, in their order, e.g. ``time_s,-,x_mm,y_mm,z_mm``.

    Raises
    ------
    ConfigError
        If ``wanted`` does not suit the table.
    InputError
        If the head names no point; says what it holds.
    """
    if wanted is not None:
        return _wanted(table, wanted)
    found = named_columns(table)
    if found is None:
        raise InputError(
            f'{unnamed_words(table)}; name them with --columns, e.g. --columns '
            f'time_s,x_mm,y_mm,z_mm (a - leaves a column out)'
        )
    return found


def named_columns(table: TextTable) -> Columns | None:
    """Columns by the head of a table or as they stand there; None if neither names a point."""
    labels = _labels_between(table)
    if labels is not None:
        return labels
    count = len(table.rows[0])
    for k in reversed(range(len(table.head))):
        for delimiter in (table.delimiter, '\t', ';', ',', None):
            headings = split(table.head[k], delimiter)
            found = columns_of(headings) if len(headings) >= FEWEST_NAMED else None
            if found is not None and all(c.place < count for c in (*found.point, *found.time)):
                below = [split(line, delimiter) for line in table.head[k + 1 :]]
                return _with_unit_of_head(_with_units_below(found, below), table)
    return _unnamed(table)


FEWEST_NAMED = 3


def _with_units_below(found: Columns, below: Sequence[Sequence[str]]) -> Columns:
    """Take units from a line of their own under the names: 's;mm;mm;mm'."""
    columns = (*found.point, *found.time)
    for fields in below:
        texts = [fields[c.place].strip('[]() ') if c.place < len(fields) else '' for c in columns]
        if all(map(_is_unit, texts[:3])) and not any(c.unit for c in found.point):
            given = [
                replace(c, unit=text.lower()) if c.unit is None and _is_unit(text) else c
                for c, text in zip(columns, texts, strict=True)
            ]
            return Columns((given[0], given[1], given[2]), tuple(given[3:]))
    return found


def _with_unit_of_head(found: Columns, table: TextTable) -> Columns:
    """Take the unit of the point from a line such as 'AXES = CARTESIAN: X Y Z (mm)'."""
    stated = [m[1].lower() for line in table.head if (m := AXES_WITH_UNIT.search(line))]
    if not stated or any(c.unit for c in found.point):
        return found
    x, y, z = (Column(c.place, stated[0], c.name) for c in found.point)
    return Columns((x, y, z), found.time)


def _labels_between(table: TextTable) -> Columns | None:
    """Columns of lines such as 'X,1790.8,Y,10463.5,Z,1527.3,Time(sec),7.2'."""
    row, last = table.rows[0], table.rows[-1]
    labelled = ['' for _ in row]
    for place, field in enumerate(row[:-1]):
        if field == last[place] and not is_value(field) and is_value(row[place + 1]):
            labelled[place + 1] = field
    return columns_of(labelled)


def _unnamed(table: TextTable) -> Columns | None:
    """Columns of a table without names: x y z, or time x y z."""
    count = len(table.rows[0])
    named = bool(table.head) and len(split(table.head[-1], table.delimiter)) == count
    if named or count not in (3, 4) or not all(map(is_value, table.rows[0])):
        return None
    names = [f'column {k + 1}' for k in range(count)]
    x, y, z = (Column(k, None, names[k]) for k in range(count - 3, count))
    return Columns((x, y, z), (Column(0, None, names[0]),) if count == 4 else ())


def unnamed_words(table: TextTable) -> str:
    """Say that nothing names the point of a table, and what stands there instead."""
    shown = ' | '.join(table.head[-1:]) or 'nothing'
    return (
        f'{table.where}: line {table.lines[0]} has {len(table.rows[0])} columns, and the head '
        f'names no x, y, z (it says: {shown[:100]})'
    )


def _wanted(table: TextTable, wanted: str) -> Columns:
    headings, count = wanted.split(','), len(table.rows[0])
    if len(headings) > count:
        raise ConfigError(
            f'--columns: names {len(headings)} columns, but line {table.lines[0]} of '
            f'{table.where} has {count}'
        )
    times = [Column(k, _parted(h)[1], h.strip()) for k, h in enumerate(headings)
             if _what(_parted(h)[0]) == 'time']  # fmt: skip
    for heading in headings:
        name = _parted(heading)[0]
        if name not in ('-', '') and _what(name) is None:
            raise ConfigError(
                f'--columns: {heading.strip()!r} is unknown; possible: time, x, y, z, with units '
                f'as in time_s or x_mm, and - for others'
            )
    found = columns_of(headings)
    if found is None:
        raise ConfigError(f'--columns: {wanted!r} does not name x, y and z')
    return Columns(found.point, tuple(times))
