# SPDX-License-Identifier: Apache-2.0
"""Which columns of a table are the point and the time, and in which units."""

from __future__ import annotations

import re
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from otf_core.errors import ConfigError, InputError
from otf_core.files.message_text import shortened
from otf_core.files.text_dialect import is_missing, is_value
from otf_core.files.text_moments import ORDERS
from otf_core.files.text_table import (
    LENGTHS,
    LONG_TIMES,
    OTHERS,
    TIMES,
    TextTable,
    is_unit,
    read_text_table,
    split_heading,
)

# Words of headings: which coordinate, and whether measured, nominal or no position at all.
#
# English, German, French, Italian, Spanish and Chinese, as exports of tracker and coordinate
# measuring software, controllers and ROS have them.

AXES = ('x', 'y', 'z')
MEASURED = (
    'meas', 'measured', 'measure', 'measurement', 'act', 'actual', 'actuals', 'real', 'observed',
    'ist', 'istwert', 'istposition', 'istkoordinate', 'gemessen', 'messwert', 'messung', 'mess',
    'messpunkt', 'mesure', 'mesures', 'mesuree', 'mesurees', 'reel', 'reelle', 'mes',
    'misurato', 'misurata', 'misurati', 'misura', 'effettivo', 'effettiva', 'reale', 'mis',
    'medido', 'medida', 'medidos', 'medidas', 'medicion', 'med',
    '实测', '实测值', '测量', '测量值', '实际', '实际值', '测点', '實測', '測量', '實際',
)  # fmt: skip
NOMINAL = (
    'nom', 'nominal', 'nominals', 'nominell', 'nominale', 'nominaux', 'nenn', 'nennwert',
    'cmd', 'command', 'commanded', 'commands', 'commande', 'consigne', 'comando', 'comandato',
    'comandado', 'consigna', 'soll', 'sollwert', 'sollposition', 'sollkoordinate', 'vorgabe',
    'set', 'setpoint', 'demand', 'demanded', 'ref', 'reference', 'referenz', 'riferimento',
    'referencia', 'theo', 'theoretical', 'theorique', 'theoretisch', 'teorico', 'teorica', 'theor',
    'ideal', 'programmed', 'prog', 'programmiert', 'planned', 'plan', 'desired', 'des', 'goal',
    'expected', 'design', 'cad', 'master', 'impostato',
    '理论', '理论值', '名义', '名义值', '标称', '标称值', '指令', '指令值', '设定', '设定值',
    '目标值', '理論', '名義', '標稱',
)  # fmt: skip
NO_POSITION = (
    'rot', 'rotation', 'rotations', 'quat', 'quaternion', 'orientation', 'orient',
    'drehung', 'euler',
    'rotazione', 'rotacion', 'giro', 'winkel', 'angle', 'angular', 'turn', 'rpy',
    'cov', 'covariance', 'std', 'stdev', 'sigma', 'rms', 'unc', 'uncertainty', 'unsicherheit',
    'incertitude', 'incertezza', 'incertidumbre', 'dif', 'diff', 'difference', 'differenz', 'dev',
    'deviation', 'abw', 'abweichung', 'ecart', 'scarto', 'deviazione', 'desviacion', 'delta',
    'err', 'error', 'errors', 'fehler', 'erreur', 'errore', 'residual', 'res', 'corr',
    'correction',
    'vel', 'velocity', 'speed', 'geschwindigkeit', 'vitesse', 'velocita', 'velocidad', 'twist',
    'linear', 'acc', 'accel', 'acceleration', 'beschleunigung', 'accelerazione', 'aceleracion',
    'force', 'kraft', 'torque', 'gyro', 'mag', 'normal', 'normale', 'vector', 'tol', 'tolerance',
    'toleranz', 'offset', 'temp', 'temperature', 'weight', 'scale', 'current', 'load',
    '旋转', '角度', '速度', '加速度', '偏差', '误差', '公差', '不确定度', '法向',
)  # fmt: skip
POSITION = (
    'pos', 'position', 'positions', 'posizione', 'posicion', 'lage', 'point', 'points', 'punkt',
    'coord', 'coordinate', 'coordinates', 'koordinate', 'koordinaten', 'coordonnee', 'coordinata',
    'coordenada', 'translation', 'trans', 'location', 'pose', 'p', 't', 'field', 'cartesian',
    'kartesisch', 'xyz', 'axis', 'achse', 'axe', '位置', '坐标', '坐标值', '座標',
)  # fmt: skip
"""Words that add nothing to a coordinate."""
LETTERS = {'r': 'no', 'q': 'no', 'v': 'no', 'a': 'no', 'd': 'no', 'u': 'no', 's': 'no', 'w': 'no',
           'f': 'no', 'n': 'no', 'o': 'no', 'm': 'no', 'p': 'is', 't': 'is'}  # fmt: skip
"""Of rx, qx, vx, dx, ux, ... and of px, tx, xt."""
STEMS = ('abweichung', 'geschwindigkeit', 'unsicherheit', 'deviation', 'velocit', 'orientation')
"""Of compounds that are no position."""
CAMEL = re.compile(r'(?<=[a-zà-ÿ])(?=[A-Z])|(?<=[XYZ])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=[XYZ]\b)')
WORD = re.compile(r'[a-zß]+|\d+|[\u4e00-\u9fff]+')
GLUED = frozenset((*MEASURED, *NOMINAL, *NO_POSITION, *POSITION))


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
    """Words of a heading: lower case, without accents; parts of CamelCase apart."""
    apart = CAMEL.sub(' ', heading)
    plain = unicodedata.normalize('NFKD', apart.lower())
    return WORD.findall(''.join(c for c in plain if not unicodedata.combining(c)))


def coordinate_of(heading: str) -> Coordinate | None:
    """What a heading, without its unit, says of a coordinate; None if it names none."""
    words = words_of(heading)
    axis, others = '', list[str]()
    for word in reversed(words):  # the last letter is the axis: 'axis x of y'
        axes, rest = ('', [word]) if axis else _axis_of(word)
        axis = axis or axes
        others = rest + others
    if not axis:
        return None
    return Coordinate(axis, tuple(others), _role(others))


def _axis_of(word: str) -> tuple[str, list[str]]:
    """Axis in a word, and what else it says: 'tx', 'xist', 'posx'."""
    if word in AXES:
        return word, []
    for axis, rest in ((word[:1], word[1:]), (word[-1:], word[:-1])):
        if axis in AXES and (rest in GLUED or rest in LETTERS):
            if rest in GLUED:
                return axis, [rest]
            if LETTERS[rest] == 'no' and axis == word[-1:]:
                return axis, ['rotation' if rest in 'rqw' else 'deviation']
    return '', [word]


def _role(words: list[str]) -> str:
    if any(w in NO_POSITION or w.startswith(STEMS) or w.endswith(STEMS) for w in words):
        return 'none'
    if words[:1] in (['u'], ['d'], ['s']):
        return 'none'
    if any(w in NOMINAL for w in words):
        return 'nominal'
    return 'measured' if any(w in MEASURED for w in words) else ''


def without_fillers(words: tuple[str, ...]) -> tuple[str, ...]:
    """Words without those that add nothing."""
    return tuple(word for word in words if word not in POSITION)


# Which columns of a table are the point and the time, and in which units.
#
# A head may offer several points: nominal and measured, command and actual, two targets. The
# measured one is taken where words say which it is (see ``heading_words``), never because it
# stands first. Polar coordinates are taken where no Cartesian ones are named.

TIME_WORDS = (
    't', 'time', 'zeit', 'timestamp', 'stamp', 'datetime', 'utc', 'uhrzeit', 'zeitstempel',
    'messzeit', 'sec', 'secs', 'nsec', 'nsecs', 'nanosec', 'nanosecs', 'seconds', 'sekunden', 'ms',
    'temps', 'heure', 'horodatage', 'tempo', 'ora', 'tiempo', 'hora',
    '时间', '时刻', '时间戳', '時間',
)  # fmt: skip
OTHER_TIMES = ('exposure', 'integration', 'dead', 'delay', 'dwell', 'sampling', 'interval')
FIXED = {'dval1': 'x', 'dval2': 'y', 'dval3': 'z'}
"""Names in results of a tracker controller (emScon: Cartesian, right-handed)."""
AXES_WITH_UNIT = re.compile(r'\bx\b.*\by\b.*\bz\b.*[\[(]\s*([^\s\])]+)\s*[\])]', re.IGNORECASE)
OTHER_AXES = re.compile(r'AXES\s*=\s*(CYLINDRIC\w*|SPHERIC\w*|POLAR)', re.IGNORECASE)
POLAR = {
    'hz': 'hz', 'horizontal': 'hz', 'horizontalangle': 'hz', 'horizontaldirection': 'hz',
    'horizontalwinkel': 'hz', 'richtung': 'hz', '水平角': 'hz',
    'az': 'az', 'azimuth': 'az', 'azimut': 'az', 'azimutal': 'az', '方位角': 'az',
    'v': 'v', 'vertical': 'v', 'verticalangle': 'v', 'vertikalwinkel': 'v', '垂直角': 'v',
    '竖直角': 'v', 'zenith': 'zenith', 'zenithangle': 'zenith', 'zenit': 'zenith',
    'zenitwinkel': 'zenith', 'zenitdistanz': 'zenith', 'zd': 'zenith', 'za': 'zenith',
    '天顶距': 'zenith', '天顶角': 'zenith', 'el': 'el', 'elevation': 'el', 'elevationangle': 'el',
    'hoehenwinkel': 'el', 'hohenwinkel': 'el', 'elevazione': 'el', 'elevacion': 'el',
    '高度角': 'el', '俯仰角': 'el', '仰角': 'el', 'd': 'd', 'dist': 'd', 'distance': 'd',
    'range': 'd', 'slopedistance': 'd', 'sd': 'd', 'r': 'd', 'distanz': 'd',
    'schragdistanz': 'd', 'schraegdistanz': 'd', 'strecke': 'd', 'entfernung': 'd',
    'distanza': 'd', 'distancia': 'd', 'radius': 'd', '距离': 'd', '斜距': 'd',
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
    points = _offers(headings, keep_fillers=True)
    return points or _offers(headings, keep_fillers=False)


def _with_last_unit(offer: PointColumns) -> PointColumns:
    """Take a unit that is stated once, after z, for all three: 'X, Y, Z (mm)'."""
    x, y, z = offer.point
    if x.unit is None and y.unit is None and z.unit is not None:
        return replace(offer, point=(replace(x, unit=z.unit), replace(y, unit=z.unit), z))
    return offer


def _offers(headings: Sequence[str], *, keep_fillers: bool) -> list[PointColumns]:
    groups: dict[tuple[tuple[str, ...], str], dict[str, list[Column]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for place, heading in enumerate(headings):
        name = split_heading(heading)[0]
        if name in FIXED:
            groups[('dval',), ''][FIXED[name]].append(_column(place, heading))
            continue
        coordinate = coordinate_of(_named(heading))
        if coordinate is None or coordinate.role == 'none':
            continue
        words = coordinate.words if keep_fillers else without_fillers(coordinate.words)
        groups[words, coordinate.role][coordinate.axis].append(_column(place, heading))
    points = []
    for (_, role), axes in groups.items():
        count = min(len(axes[axis]) for axis in AXES)
        for k in range(count):
            points.append(PointColumns((axes['x'][k], axes['y'][k], axes['z'][k]), role))
    return sorted(points, key=lambda offer: offer.point[0].place)


def _named(heading: str) -> str:
    """Heading without its unit, in its own case."""
    name, unit = split_heading(heading)
    if unit is None and name != heading.strip().lower().strip('[](){}'):
        return ' '.join(heading.split())
    text = ' '.join(heading.split()).strip('%')
    at = text.lower().find(name)
    return text[at : at + len(name)] if at >= 0 else name


def _polar(headings: Sequence[str]) -> tuple[tuple[Column, Column, Column], str] | None:
    groups: dict[str, list[tuple[str, Column]]] = defaultdict(list)
    kinds = {'hz': 'h', 'az': 'h', 'v': 'v', 'zenith': 'v', 'el': 'v', 'd': 'd'}
    for place, heading in enumerate(headings):
        words = words_of(split_heading(heading)[0])
        what = POLAR.get(''.join(words)) or (POLAR.get(words[-1]) if words else None)
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
    """The best time: of the measurement rather than of its reception; s and ns together."""
    columns = []
    for place, heading in enumerate(headings):
        name, unit = split_heading(heading)
        words = words_of(name.replace('time stamp', 'timestamp').replace('date time', 'datetime'))
        if not words or set(words) & set(OTHER_TIMES) or coordinate_of(name) is not None:
            continue
        if words[-1] not in TIME_WORDS and words[0] not in ('time', 'zeit', 'timestamp'):
            continue
        if not any(unit in known for known in (TIMES, LONG_TIMES, OTHERS, ORDERS)):
            unit = words[-1] if words[-1] in TIMES else None
        columns.append(Column(place, unit, shortened(' '.join(heading.split()))))
    stamps = [c for c in columns if 'stamp' in c.name.lower()] or columns
    whole = [c for c in stamps if TIMES.get(c.unit or '') == 0]
    parts = [c for c in stamps if TIMES.get(c.unit or '') == -9]
    if whole and parts:
        return whole[0], parts[0]
    return tuple(stamps[:1])


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
    offered, time = list(map(_with_last_unit, offers(headings))), _times(headings)
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
    ways = []
    for offer in offered:
        words = ['-'] * len(headings)
        for axis, column in zip(AXES, offer.point, strict=True):
            factor = LENGTHS.get(column.unit or '')
            words[column.place] = axis if factor is None else f'{axis}_{SUGGESTED[factor]}'
        for column in time:
            unit = {0: 's', -3: 'ms', -6: 'us', -9: 'ns'}.get(TIMES.get(column.unit or '', 1))
            words[column.place] = 'time' if unit is None else f'time_{unit}'
        ways.append(f'--columns {",".join(words)}')
    return f'; choose with {" or ".join(ways)}'


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
    labels = _labels_between(table)
    if labels is not None:
        return labels
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
    columns = (*columns_read.point, *columns_read.time)
    if not units or any(c.unit for c in columns_read.point):
        return columns_read
    given = [
        replace(c, unit=units[c.place].lower())
        if c.unit is None and c.place < len(units) and is_unit(units[c.place])
        else c
        for c in columns
    ]
    return replace(columns_read, point=(given[0], given[1], given[2]), time=tuple(given[3:]))


def _with_unit_of_head(columns_read: Columns, table: TextTable) -> Columns:
    """Take the unit of the point from a line such as 'AXES = CARTESIAN: X Y Z (mm)'."""
    stated = [
        m[1].lower() for line in table.head if (m := AXES_WITH_UNIT.search(line)) and is_unit(m[1])
    ]
    stated = [unit for unit in stated if unit in LENGTHS or unit in OTHERS]
    if columns_read.polar or not stated or any(c.unit for c in columns_read.point):
        return columns_read
    x, y, z = (Column(c.place, stated[0], c.name) for c in columns_read.point)
    return replace(columns_read, point=(x, y, z))


def _labels_between(table: TextTable) -> Columns | None:
    """Columns of lines such as 'X,1790.8,Y,10463.5,Z,1527.3,Time(sec),7.2'."""
    row, last = table.row(0), table.row(-1)
    labelled = ['' for _ in row]
    for place, text in enumerate(row[:-1]):
        label = text.rstrip('=: ')
        if label and text == last[place] and not is_value(text) and is_value(row[place + 1]):
            labelled[place + 1] = label
    return columns_of(labelled, table.where)


NUMBER_SHARE = 0.9
"""Of the rows in which a column without a name holds a number."""


def _value_places(table: TextTable) -> list[int]:
    """Columns that hold numbers in most rows."""
    places = []
    for place, column in enumerate(table.columns):
        texts = [text.strip() for text in column[:: max(len(column) // 500, 1)]]
        if sum(is_value(t) or is_missing(t) for t in texts) >= NUMBER_SHARE * len(texts):
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
    named = bool(table.head) and _has_names(table)
    places = _value_places(table)
    if named and not _states_axes(table):
        return None
    clocks = [k for k in places if ':' in table.columns[k][0]]
    numbers = [k for k in places if k not in clocks]
    remarks: tuple[str, ...] = ()
    if len(numbers) == 4 and counts_rows(table.column(numbers[0])):
        remarks = (f'column {numbers[0] + 1} counts the lines and is not a time',)
        numbers = numbers[1:]
    names = [f'column {k + 1}' for k in range(table.width)]
    time: tuple[Column, ...] = ()
    if len(numbers) == 4 and table.width == 4:
        time, numbers = (Column(0, None, names[0]),), numbers[1:]
    elif len(clocks) == 1:
        time = (Column(clocks[0], None, names[clocks[0]]),)
    beside = table.width - len(numbers) - len(time)
    if len(numbers) != 3 or numbers[2] - numbers[0] != 2 or len(clocks) > 1:
        return None
    if beside and not _states_axes(table) and (beside > 1 or numbers[0] == 0):
        return None
    x, y, z = (Column(k, None, names[k]) for k in numbers)
    return Columns((x, y, z), time, '', remarks)


def _states_axes(table: TextTable) -> bool:
    return any(re.search(r'AXES\s*=', line) for line in table.head)


def _has_names(table: TextTable) -> bool:
    """Return whether the last line before the data has as many fields as these, none a number."""
    fields = table.dialect.fields(table.head[-1])
    return len(fields) == table.width and not any(map(is_value, fields))


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
                f'--columns: {heading.strip()!r} is unknown; possible: time, sec, nanosec, x, y, '
                f'z, hz, v, d, az, el, with units as in time_s or x_mm, and - for others'
            )
    try:
        columns = columns_of(headings)
    except AmbiguousPointError:
        raise ConfigError(f'--columns: {wanted!r} names x, y or z more than once') from None
    if columns is None:
        raise ConfigError(f'--columns: {wanted!r} does not name x, y and z')
    return columns


def _is_known(heading: str) -> bool:
    name = split_heading(heading)[0]
    return bool(_times([heading])) or name in POLAR or (
        coordinate_of(name) is not None and len(name) <= MAX_NAME_LETTERS
    )  # fmt: skip


MAX_NAME_LETTERS = 12
"""Letters of a name in --columns."""
