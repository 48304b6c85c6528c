# SPDX-License-Identifier: Apache-2.0
"""Which columns of a table are the point and the time, and in which units."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened
from otf_core.files.text_table import (
    LENGTHS,
    OTHERS,
    TextTable,
    fields_of,
    is_unit,
    is_value,
    read_text_table,
    split_heading,
)
from otf_core.files.text_times import LONG_TIMES, TIMES

# Words of headings: which coordinate, and whether measured, nominal or no position at all.
#
# English and German, as exports of tracker and coordinate measuring software, controllers and ROS
# have them.

AXES = ('x', 'y', 'z')
MEASURED = (
    'meas', 'measured', 'measurement', 'act', 'actual', 'actuals', 'observed', 'ist', 'istwert',
    'gemessen', 'messwert',
)  # fmt: skip
NOMINAL = (
    'nom', 'nominal', 'nominals', 'nenn', 'nennwert', 'cmd', 'command', 'commanded', 'soll',
    'sollwert', 'set', 'setpoint', 'demand', 'ref', 'reference', 'theoretical', 'programmed',
    'planned', 'desired', 'goal', 'design', 'cad',
)  # fmt: skip
NO_POSITION = (
    'rot', 'rotation', 'quat', 'quaternion', 'orientation', 'euler', 'angle', 'angular', 'winkel',
    'u', 'unc', 'uncertainty', 'cov', 'covariance', 'std', 'sigma', 'rms', 'd', 'dev', 'deviation',
    'abweichung', 'delta', 'diff', 'err', 'error', 'residual', 'corr', 'correction', 'vel',
    'velocity', 'speed', 'twist', 'acc', 'acceleration', 'force', 'torque', 'normal', 'tol',
    'offset',
)  # fmt: skip
POSITION = (
    'pos', 'position', 'point', 'points', 'punkt', 'lage', 'coord', 'coordinate', 'coordinates',
    'koordinate', 'translation', 'location', 'pose', 'p', 't', 'field', 'xyz',
)  # fmt: skip
"""Words that add nothing to a coordinate."""
CAMEL = re.compile(r'(?<=[a-z])(?=[A-Z])|(?<=[XYZ])(?=[A-Z][a-z])')
WORD = re.compile(r'[^\W\d_]+|\d+')
GLUED = frozenset((*MEASURED, *NOMINAL, *POSITION))


@dataclass(frozen=True)
class Coordinate:
    """What a heading says of a coordinate.

    Attributes
    ----------
    axis : str
        'x', 'y' or 'z'.
    words : tuple of str
        The others of the heading; the same for the three of a point.
    role : str
        'measured', 'nominal', 'none' (no position) or '' (not stated).
    """

    axis: str
    words: tuple[str, ...]
    role: str


def words_of(heading: str) -> list[str]:
    """Words of a heading, in lower case; parts of CamelCase apart."""
    return WORD.findall(CAMEL.sub(' ', heading).lower())


def coordinate_of(heading: str) -> Coordinate | None:
    """What a heading, without its unit, says of a coordinate; None if it names none."""
    words = words_of(heading)
    axis, others = '', list[str]()
    for word in reversed(words):  # the last letter is the axis: 'axis x of y'
        found, rest = '', [word]
        if not axis:
            for letter, more in ((word[:1], word[1:]), (word[-1:], word[:-1])):
                if letter in AXES and (not more or more in GLUED):  # 'x', 'xist', 'tx'
                    found, rest = letter, [more] if more else []
        axis = axis or found
        others = rest + others
    if not axis:
        return None
    role = next(
        (
            role
            for role, known in (
                ('none', NO_POSITION),
                ('nominal', NOMINAL),
                ('measured', MEASURED),
            )
            if set(others) & set(known)
        ),
        '',
    )
    return Coordinate(axis, tuple(others), role)


# Which columns of a table are the point and the time, and in which units.
#
# A head may offer several points: nominal and measured, command and actual, two targets. The
# measured one is taken where words say which it is never because it
# stands first. Polar coordinates are taken where no Cartesian ones are named.

TIME_WORDS = (
    't', 'time', 'zeit', 'timestamp', 'stamp', 'datetime', 'utc', 'uhrzeit', 'zeitstempel', 'sec',
    'secs', 'nsec', 'nsecs', 'nanosec', 'seconds', 'ms', 'date', 'datum',
)  # fmt: skip
DATE_WORDS = ('date', 'datum')
OTHER_TIMES = ('exposure', 'integration', 'dead', 'delay', 'dwell', 'sampling', 'interval')
AXES_WITH_UNIT = re.compile(r'\bx\b.*\by\b.*\bz\b.*[\[(]\s*([^\s\])]+)\s*[\])]', re.IGNORECASE)
OTHER_AXES = re.compile(r'AXES\s*=\s*(CYLINDRIC\w*|SPHERIC\w*|POLAR)', re.IGNORECASE)
POLAR = {
    'hz': 'hz', 'horizontalangle': 'hz', 'horizontaldirection': 'hz', 'horizontalwinkel': 'hz',
    'richtung': 'hz', 'az': 'az', 'azimuth': 'az', 'azimut': 'az',
    'v': 'v', 'verticalangle': 'v', 'vertikalwinkel': 'v', 'zenith': 'zenith',
    'zenithangle': 'zenith', 'zenit': 'zenith', 'zenitwinkel': 'zenith',
    'el': 'el', 'elevation': 'el', 'elevationangle': 'el', 'd': 'd', 'dist': 'd', 'distance': 'd',
    'range': 'd', 'slopedistance': 'd', 'distanz': 'd', 'strecke': 'd',
}  # fmt: skip
"""Horizontal direction (hz clockwise, az counter-clockwise), vertical angle, slope distance."""
SUGGESTED = {1.0: 'm', 1e-1: 'dm', 1e-2: 'cm', 1e-3: 'mm', 1e-6: 'um', 0.0254: 'inch'}


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
        x, y, z; or direction, vertical angle, distance.
    time : tuple of Column
        Several are added up (s and ns); none: not recorded.
    polar : str
        Empty: Cartesian. Else two words: 'hz' or 'az', and 'v', 'zenith' or 'el'.
    remarks : tuple of str
        What was taken for what, and why, where the head leaves a choice.
    """

    point: tuple[Column, Column, Column]
    time: tuple[Column, ...]
    polar: str = ''
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class PointColumns:
    """A point that a head names."""

    point: tuple[Column, Column, Column]
    role: str

    @property
    def words(self) -> str:
        """Its columns, for messages."""
        places = ', '.join(str(c.place + 1) for c in self.point)
        return f'columns {places} ({", ".join(c.name for c in self.point)})'


class AmbiguousPointError(InputError):
    """A head names several points, and nothing says which one was measured."""


def _column(place: int, heading: str) -> Column:
    return Column(place, split_heading(heading)[1], shortened(' '.join(heading.split())))


def offers(headings: Sequence[str]) -> list[PointColumns]:
    """Points that headings name, Cartesian; positions only."""
    points: list[PointColumns] = []
    for fillers in ((), POSITION):
        groups: dict[tuple[tuple[str, ...], str], dict[str, list[Column]]] = defaultdict(
            lambda: defaultdict(list)
        )
        for place, heading in enumerate(headings):
            coordinate = coordinate_of(split_heading(heading)[0])
            if coordinate is not None and coordinate.role != 'none':
                words = tuple(word for word in coordinate.words if word not in fillers)
                groups[words, coordinate.role][coordinate.axis].append(_column(place, heading))
        for (_, role), axes in groups.items():
            for x, y, z in zip(axes['x'], axes['y'], axes['z'], strict=False):
                if x.unit is None and y.unit is None:  # stated once: 'X, Y, Z (mm)'
                    x, y = replace(x, unit=z.unit), replace(y, unit=z.unit)
                points.append(PointColumns((x, y, z), role))
        if points:
            break
    return sorted(points, key=lambda offer: offer.point[0].place)


def _polar(headings: Sequence[str]) -> tuple[tuple[Column, Column, Column], str] | None:
    groups: dict[str, list[tuple[str, Column]]] = defaultdict(list)
    kinds = {'hz': 'h', 'az': 'h', 'v': 'v', 'zenith': 'v', 'el': 'v', 'd': 'd'}
    for place, heading in enumerate(headings):
        words = [w for w in words_of(split_heading(heading)[0]) if w not in MEASURED]
        what = POLAR.get(''.join(words))
        if what is None and words and 'horizontal' not in words:  # nor a horizontal distance
            what = POLAR.get(words[-1])
        if what is not None:
            groups[kinds[what]].append((what, _column(place, heading)))
    if any(len(groups[kind]) != 1 for kind in 'hvd'):
        return None
    (h, across), (v, up), (_, along) = (groups[kind][0] for kind in 'hvd')
    return (across, up, along), f'{h} {v}'


def names_point(headings: Sequence[str]) -> bool:
    """Return whether headings name a point."""
    return bool(offers(headings)) or _polar(headings) is not None


def read_table(path: str | Path, *, named: bool = True) -> TextTable:
    """Read a table of points; ``named``: its head, if there is one, says what the columns are."""
    return read_text_table(path, names_point if named else None)


def _times(headings: Sequence[str]) -> tuple[Column, ...]:
    """The best time: of the measurement rather than of its reception; s and ns, date and time."""
    columns = []
    for place, heading in enumerate(headings):
        name, unit = split_heading(heading)
        words = words_of(name)
        if not words or set(words) & set(OTHER_TIMES) or coordinate_of(name) is not None:
            continue
        if words[-1] not in TIME_WORDS and words[0] not in ('time', 'zeit', 'timestamp'):
            continue
        if not any(unit in known for known in (TIMES, LONG_TIMES, OTHERS)):
            unit = words[-1] if words[-1] in TIMES else None
        columns.append(Column(place, unit, shortened(' '.join(heading.split()))))
    columns = [c for c in columns if 'stamp' in c.name.lower()] or columns
    whole = [c for c in columns if TIMES.get(c.unit or '') == 0]
    parts = [c for c in columns if TIMES.get(c.unit or '') == -9]
    if whole and parts:
        return whole[0], parts[0]
    dates = [c for c in columns if words_of(c.name)[-1] in DATE_WORDS]
    times = [c for c in columns if c not in dates]
    if dates and times and times[0].unit is None:
        return dates[0], times[0]
    return tuple((times or dates)[:1])


def columns_of(
    headings: Sequence[str], where: str = '', *, nominal: bool = False
) -> Columns | None:
    """Columns by their headings; None if they do not name a point.

    Parameters
    ----------
    where : str
        File, for messages.
    nominal : bool
        The nominal one of several points is wanted, as for a path; else the measured one.

    Raises
    ------
    AmbiguousPointError
        If words do not say which point is wanted; names both.
    """
    offered, time = offers(headings), _times(headings)
    if not offered:
        polar = _polar(headings)
        return None if polar is None else Columns(polar[0], time, polar[1])
    wanted, unwanted = ('nominal', 'measured') if nominal else ('measured', 'nominal')
    chosen = [o for o in offered if o.role == wanted] or [o for o in offered if o.role == '']
    if nominal and not chosen:
        chosen = offered
    if len(chosen) == 1:
        rest = [o for o in offered if o is not chosen[0]]
        words = '; '.join(f'not {o.words}, {o.role or "whose role is not stated"}' for o in rest)
        remarks = (f'the {wanted} point is {chosen[0].words}; {words}',) if rest else ()
        return Columns(chosen[0].point, time, '', remarks)
    if not chosen:
        raise AmbiguousPointError(
            f'{where}: the header names {unwanted} positions only: {offered[0].words}; export the '
            f'measured ones{_choice(headings, offered, time, nominal)}'
        )
    points = ' and '.join(o.words for o in offered)
    raise AmbiguousPointError(
        f'{where}: the header names {len(offered)} points: {points}; nothing states which was '
        f'{"planned" if nominal else "measured"}{_choice(headings, offered, time, nominal)}'
    )


def _choice(
    headings: Sequence[str], offered: Sequence[PointColumns], time: Sequence[Column], nominal: bool
) -> str:
    """State how to choose: options that work as they stand."""
    if nominal:
        return '; delete the columns of the others, or name the right ones x_mm, y_mm, z_mm'
    ways = [columns_option(len(headings), offer.point, time) for offer in offered]
    return f'; choose with --columns {" or --columns ".join(ways)}'


def columns_option(
    width: int, point: Sequence[Column], time: Sequence[Column] = (), word: str = ''
) -> str:
    """Columns as --columns takes them; ``word`` takes the place of that of the time."""
    words = ['-'] * width
    for axis, column in zip(AXES, point, strict=True):
        unit = SUGGESTED.get(LENGTHS.get(column.unit or '', 0.0))
        words[column.place] = axis if unit is None else f'{axis}_{unit}'
    for column in time:
        unit = {0: 's', -3: 'ms', -6: 'us', -9: 'ns'}.get(TIMES.get(column.unit or '', 1))
        named = 'date' if words_of(column.name)[-1] in DATE_WORDS else 'time'
        words[column.place] = word or (named if unit is None else f'{named}_{unit}')
    return ','.join(words)


def find_columns(table: TextTable, wanted: str | None, *, nominal: bool = False) -> Columns:
    """Find the columns of a table.

    Parameters
    ----------
    wanted : str, optional
        What stands in the columns, in their order, e.g. ``time_s,-,x_mm,y_mm,z_mm``.
    nominal : bool
        See ``columns_of``.

    Raises
    ------
    ConfigError
        If ``wanted`` does not suit the table.
    InputError
        If the head names no point, or several; says what it holds.
    """
    if wanted is not None:
        return _wanted(table, wanted)
    columns = named_columns(table, nominal=nominal)
    if columns is None:
        raise InputError(
            f'{unnamed_words(table)}; name them with --columns, e.g. --columns '
            f'{_suggestion(table)} (a - leaves a column out)'
        )
    return columns


def named_columns(table: TextTable, *, nominal: bool = False) -> Columns | None:
    """Columns by the head of a table or as they stand there; None if neither names a point."""
    _refuse_other_axes(table)
    if table.names is not None:
        columns = columns_of(table.names, table.where, nominal=nominal)
        if columns is not None:
            return _with_unit_of_head(_with_units_below(columns, table.units), table)
    unnamed = _unnamed(table)
    return None if unnamed is None else _with_unit_of_head(unnamed, table)


def _refuse_other_axes(table: TextTable) -> None:
    for line in table.head:
        match = OTHER_AXES.search(line)
        if match:
            raise InputError(
                f'{table.where}: the header states {match[1].lower()} coordinates '
                f'({shortened(line, 80)!r}); export Cartesian ones'
            )


def _with_units_below(columns_read: Columns, units: Sequence[str]) -> Columns:
    """Take units from a line of their own under the names: 's;mm;mm;mm'."""
    if not units or any(c.unit for c in columns_read.point):
        return columns_read
    given = units_below((*columns_read.point, *columns_read.time), units)
    return replace(columns_read, point=(given[0], given[1], given[2]), time=tuple(given[3:]))


def units_below(columns: Sequence[Column], units: Sequence[str]) -> list[Column]:
    """Columns with the units of a line of their own, where their names state none."""
    return [
        replace(c, unit=units[c.place].lower())
        if c.unit is None and c.place < len(units) and is_unit(units[c.place])
        else c
        for c in columns
    ]


def unit_of_head(table: TextTable) -> str | None:
    """Unit of length that a line before the data states: 'AXES = CARTESIAN: X Y Z (mm)'."""
    stated = (m[1].lower() for line in table.head if (m := AXES_WITH_UNIT.search(line)))
    return next((unit for unit in stated if unit in LENGTHS or unit in OTHERS), None)


def _with_unit_of_head(columns_read: Columns, table: TextTable) -> Columns:
    """Take the unit of the point from a line such as 'AXES = CARTESIAN: X Y Z (mm)'."""
    stated = unit_of_head(table)
    if columns_read.polar or stated is None or any(c.unit for c in columns_read.point):
        return columns_read
    x, y, z = (Column(c.place, stated, c.name) for c in columns_read.point)
    return replace(columns_read, point=(x, y, z))


NUMBER_SHARE = 0.9
"""Of the rows in which a column without a name holds a number."""


def _value_places(table: TextTable) -> list[int]:
    """Columns that hold numbers in most rows."""
    places = []
    for place, column in enumerate(table.columns):
        texts = column[:: max(len(column) // 500, 1)]
        if sum(map(is_value, texts)) >= NUMBER_SHARE * len(texts):
            places.append(place)
    return places


def counts_rows(texts: Sequence[str]) -> bool:
    """Return whether a column only counts: 1, 2, 3, with a few left out at most."""
    if len(texts) < CHANCE_ROWS or not all(text.isdigit() for text in texts):
        return False
    numbers = [int(text) for text in texts]
    steps = [after - before for before, after in pairwise(numbers)]
    return min(steps) >= 1 and steps.count(1) >= NUMBER_SHARE * len(steps)


CHANCE_ROWS = 3
"""Rows up to which numbers may count 1, 2, 3 by chance."""


def _unnamed(table: TextTable) -> Columns | None:
    """Columns of a table without names: x y z, time x y z, or names or numbers and x y z."""
    states_axes = any(re.search(r'AXES\s*=', line) for line in table.head)
    last = fields_of(table.head[-1], table.separator) if table.head else []
    if len(last) == table.width and not any(map(is_value, last)) and not states_axes:
        return None  # names, but none of a point
    numbers = _value_places(table)
    clocks = [k for k in range(table.width) if ':' in table.columns[k][0]]
    remarks: tuple[str, ...] = ()
    if len(numbers) == 4 and counts_rows(table.columns[numbers[0]]):
        remarks = (f'column {numbers[0] + 1} counts the lines and is not a time',)
        numbers = numbers[1:]
    if len(numbers) == 4 and table.width == 4:
        clocks, numbers = [0], numbers[1:]
    beside = table.width - len(numbers) - len(clocks)
    if len(numbers) != 3 or numbers[2] - numbers[0] != 2 or len(clocks) > 1:
        return None
    if beside and not states_axes and (beside > 1 or numbers[0] == 0):
        return None
    time, (x, y, z) = (
        [Column(k, None, f'column {k + 1}') for k in places] for places in (clocks, numbers)
    )
    return Columns((x, y, z), tuple(time), '', remarks)


def unnamed_words(table: TextTable) -> str:
    """State that nothing names the point of a table, and what stands there instead."""
    shown = ' | '.join(table.head[-1:]) or 'nothing'
    return (
        f'{table.where}: line {table.lines[0]} has {table.width} columns, and the header '
        f'names no x, y, z (it contains: {shortened(shown, 100)})'
    )


def _suggestion(table: TextTable) -> str:
    """Columns as they may be; a form that is accepted, for the user to correct."""
    places = _value_places(table)
    words = ['-'] * table.width
    names = ('time_s', 'x_mm', 'y_mm', 'z_mm') if len(places) > 3 else ('x_mm', 'y_mm', 'z_mm')
    for word, place in zip(names, places, strict=False):
        words[place] = word
    return ','.join(words)


def _wanted(table: TextTable, wanted: str) -> Columns:
    headings, count = wanted.split(','), table.width
    if len(headings) > count:
        raise ConfigError(
            f'--columns: names {len(headings)} columns, but line {table.lines[0]} of '
            f'{table.where} has {count}'
        )
    for heading in headings:
        if heading.strip(' -') and not _is_known(heading):
            raise ConfigError(
                f'--columns: {heading.strip()!r} is unknown; possible: time, date, sec, nanosec, '
                f'x, y, z, hz, v, d, az, el, with units as in time_s or x_mm, and - for others'
            )
    try:
        columns = columns_of(headings)
    except AmbiguousPointError:
        raise ConfigError(f'--columns: {wanted!r} names x, y or z more than once') from None
    if columns is None:
        raise ConfigError(f'--columns: {wanted!r} does not name x, y and z')
    return columns


def _is_known(heading: str) -> bool:
    name = split_heading(heading)[0].lower()
    named = coordinate_of(name) is not None and len(name) <= MAX_NAME_LETTERS
    return named or name in POLAR or bool(_times([heading]))


MAX_NAME_LETTERS = 12
"""Letters of a name in --columns."""
