# SPDX-License-Identifier: Apache-2.0
"""Exports of trackers as text: a table of samples to stamps and points, as a bag gives them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.bags.bag_reading import ReceivedPoints
from otf_core.bags.rosbag2_metadata import PATH, POINT, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import value_text
from otf_core.files.text_dialect import NOT_FINITE, NumberColumn, is_missing, is_number
from otf_core.files.text_moments import (
    GLUED,
    ORDERS,
    SECOND_NS,
    ColumnTimes,
    MomentError,
    joined_without_zeros,
    read_moments,
    zeros_words,
)
from otf_core.files.text_table import (
    ANGLES,
    LENGTHS,
    LONG_TIMES,
    TIMES,
    TextTable,
    fault_words,
    known_lengths,
    reason_counts,
)
from otf_core.inputs.columns import (
    SUGGESTED,
    Column,
    Columns,
    counts_rows,
    find_columns,
    read_table,
)
from otf_core.model.axis_path import AxisPath

# A column of times to int64 nanoseconds, without a detour over float64: numbers or moments.
#
# Numbers are counts of a unit that is stated, or follows from the speed of the machine; days of a
# spreadsheet; or dates and times of day that are written as one number. Moments: ``text_moments``.

Stamps = NDArray[np.int64]

USUAL_SPEED = 0.15
"""m/s, of machine tools that are measured."""
RATES = (0.5, 1e4)
"""Hz, that samples may have."""
GUESSED = ('s', 'ms', 'us', 'ns', 'days')
SECONDS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9, 'days': 86400.0}
SPEED_PERCENTILE = 75.0
"""Percentile of the speeds that is taken for that of the machine."""
TOO_LARGE = 'a time does not fit into 64 bits of nanoseconds'
SPREADSHEET, MATLAB = (36_526, 54_789), (730_486, 748_749)
"""Days that spreadsheets (since 1899-12-30) and MATLAB count from 2000 to 2050."""
SPREADSHEET_1970, MATLAB_1970 = 25_569, 719_529


def is_decimal(text: str) -> bool:
    """Return whether a text is a decimal number."""
    try:
        return Decimal(text).is_finite()
    except InvalidOperation:
        return False


def read_times(texts: Sequence[str], unit: str | None, xyz: Array, *, alone: bool) -> ColumnTimes:
    """Times of a column.

    Parameters
    ----------
    unit : str or None
        As stated; of dates their order.
    xyz : ndarray, shape (n, 3), m
        Points measured then, from which a unit that is not stated follows.
    alone : bool
        No other column is added to it.

    Raises
    ------
    MomentError
        If one is not a time, or they can be read in two ways; says which and how.
    InputError
        If the unit is none of time.
    """
    if texts and not is_decimal(texts[0]):
        return _as_seen(read_moments(texts, unit if unit in ORDERS else None), xyz)
    if unit in TIMES:
        return _decimals(texts, TIMES[unit], unit or '')
    if unit in LONG_TIMES:
        return ColumnTimes(scaled_ns(texts, LONG_TIMES[unit]), unit or '')
    if unit is not None and unit not in ORDERS:
        raise InputError(
            f'{unit!r} is not a supported unit of time; possible: s, ms, us, ns, min, h, days'
        )
    written = _written_as_one(texts) if alone else None
    if written is not None:
        return written
    guess = _guessed(subtract_first(texts), xyz) if alone else 's'
    if guess == 'days':
        return _days(texts)
    return _decimals(texts, TIMES[guess], f'{guess} (not stated, by the speed)')


def _decimals(texts: Sequence[str], power: int, words: str) -> ColumnTimes:
    """Numbers of a unit; seconds whose parts have lost their leading zeros are repaired."""
    if power == 0 and all('.' in text for text in texts[:9]):
        parts = [text.partition('.')[::2] for text in texts]
        if all(whole.isdigit() and (part.isdigit() or not part) for whole, part in parts):
            seconds = np.array([int(whole) for whole, _ in parts], dtype=object) * SECOND_NS
            if max(seconds) < 2**62:
                whole_ns = seconds.astype(np.int64)
                repaired = joined_without_zeros(whole_ns, [part for _, part in parts])
                if repaired is not None:
                    return ColumnTimes(repaired[0], f'{words}{zeros_words(repaired[1])}')
    return ColumnTimes(decimals_ns(texts, power), words)


def _written_as_one(texts: Sequence[str]) -> ColumnTimes | None:
    """Dates and times of day, or times of day, that are written as one number; None: not so."""
    if all(GLUED.fullmatch(text) for text in texts):
        return read_moments(texts)
    parts = [text.partition('.')[::2] for text in texts]
    if not all(len(whole) in (5, 6) and whole.isdigit() for whole, _ in parts):
        return None
    whole_s = np.array([int(whole) for whole, _ in parts], np.int64)
    hours, minutes, seconds = whole_s // 10_000, whole_s // 100 % 100, whole_s % 100
    if hours.max() > 23 or minutes.max() > 59 or seconds.max() > 59:
        return None
    turns = np.diff(whole_s // 100) > 0
    if np.count_nonzero(turns) < 1 or np.any(np.diff(whole_s)[turns] < 100 - FULL_MINUTE):
        return None  # a count of seconds would pass 60 to 99
    if len({len(whole) for whole, _ in parts}) > 1 and whole_s.min() < 10_000 * 9:
        return None
    clock = (3600 * hours + 60 * minutes + seconds) * SECOND_NS
    digits = np.array([int(part[:9].ljust(9, '0')) if part else 0 for _, part in parts], np.int64)
    return ColumnTimes(clock + digits, 'hours, minutes and seconds as one number')


FULL_MINUTE = 60
"""Seconds: where a minute is full, the number of hours, minutes and seconds jumps by 40 more."""


def _days(texts: Sequence[str]) -> ColumnTimes:
    """Days and their parts, with a date where a spreadsheet or MATLAB counts them."""
    first = Decimal(texts[0])
    for (low, high), epoch, name in (
        (SPREADSHEET, SPREADSHEET_1970, 'a spreadsheet'),
        (MATLAB, MATLAB_1970, 'MATLAB'),
    ):
        if low <= first < high:
            return ColumnTimes(scaled_ns(texts, 86_400, epoch), f'days as {name} counts them')
    return ColumnTimes(scaled_ns(texts, 86_400), 'days (not stated, by the speed)')


def _as_seen(moments: ColumnTimes, xyz: Array) -> ColumnTimes:
    """Two numbers with a colon are minutes and seconds, or hours and minutes, by the speed."""
    if not moments.words.startswith('minutes and seconds'):
        return moments
    speed = _speed(1e-9 * (moments.stamp_ns - moments.stamp_ns[0]), xyz)
    if speed > 60.0**0.5 * USUAL_SPEED:
        return ColumnTimes(60 * moments.stamp_ns, 'hours and minutes (not stated, by the speed)')
    return ColumnTimes(moments.stamp_ns, f'{moments.words} (not stated, by the speed)')


def decimals_ns(texts: Sequence[str], power: int) -> Stamps:
    """Decimal numbers to ns, exactly.

    Parameters
    ----------
    power : int
        Of ten, that takes the numbers to s.

    Raises
    ------
    MomentError
        If one is not a number, or too large for int64.
    """
    shift = power + 9
    try:
        return np.array([int(d.scaleb(shift)) for d in _numbers(texts)], dtype=np.int64)
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None


def scaled_ns(texts: Sequence[str], seconds: int, epoch: int = 0) -> Stamps:
    """Decimal numbers, less an epoch, of a unit of several seconds, to the nearest ns."""
    factor = seconds * SECOND_NS
    try:
        return np.array(
            [round((Fraction(d) - epoch) * factor) for d in _numbers(texts)], dtype=np.int64
        )
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None


def subtract_first(texts: Sequence[str]) -> Array:
    """Decimal numbers less the first of them, in their own unit; MomentError if one is none."""
    numbers = _numbers(texts)
    try:
        since = np.array([float(number - numbers[0]) for number in numbers])
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None
    if not np.isfinite(since).all():
        raise MomentError(TOO_LARGE)
    return since


def _numbers(texts: Sequence[str]) -> list[Decimal]:
    numbers = []
    for row, text in enumerate(texts):
        try:
            numbers.append(Decimal(text))
        except InvalidOperation:
            raise MomentError(f'{value_text(text)} is not a time', row) from None
        if not numbers[-1].is_finite():
            raise MomentError(f'{value_text(text)} is not a time', row)
    return numbers


def _speed(times: Array, xyz: Array) -> float:
    """Speed that the fast part of the motion has, m per unit of the times."""
    step = np.diff(times)
    if not np.any(step > 0):
        return 0.0
    moved = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return float(np.percentile(moved[step > 0] / step[step > 0], SPEED_PERCENTILE))


def _guessed(times: Array, xyz: Array) -> str:
    """Unit of times, less the first, that makes the machine as fast as machines are."""
    step = np.diff(times)
    usual = float(np.median(step)) if len(step) else 0.0
    if usual <= 0:
        return 's'
    speed = _speed(times, xyz)
    fits = [u for u in GUESSED if RATES[0] <= 1.0 / (usual * SECONDS[u]) <= RATES[1]]
    if not fits or speed <= 0:
        return fits[0] if fits else 's'
    return min(fits, key=lambda u: abs(np.log(speed / SECONDS[u] / USUAL_SPEED)))


# Exports of trackers as text: a table of samples to stamps and points, as a bag gives them.
#
# What the file does not say is found out and said: the unit of length from the size of the track,
# the unit of time from the speed that follows from it.

SUFFIXES = ('.csv', '.txt', '.tsv', '.asc', '.dat', '.xyz', '.pts', '.log', '.ply')
MAX_LEFT_OUT = 0.1
"""Share of the lines that may be no samples."""
NOISE_SAMPLES = 100
"""From so many on noise can be missed."""
SMALLEST_NOISE = 2e-8
"""m; no tracker has less noise."""
MIN_TRAVEL = 1e-3
"""m; a target that hardly moves says nothing."""
TRACKER_RANGE = 60.0
"""Farther from the tracker is not in metres: the range of trackers ends there."""


def is_text(source: str | Path) -> bool:
    """Return whether a recording is a text file, by its name."""
    return Path(source).suffix.lower() in SUFFIXES and Path(source).is_file()


class TextReading:
    """A table of samples; the same face as ``bags.bag.BagReading``.

    Parameters
    ----------
    columns : str, optional
        What stands in the columns, see ``columns.find_columns``.
    rate : float, optional
        Hz; of samples without a time.

    Attributes
    ----------
    topics : dict of str
        Empty: there are none.
    paths : list of ndarray, shape (n, 3), m
        Empty until one is given.
    axis_paths : list of AxisPath
        Empty.
    remarks : list of str
        What was left out.
    left_out : list of SkippedLines
        Lines that are not samples, by reason.
    said : list of str
        How the file was read.
    foreign : Counter of str
        Empty.

    Raises
    ------
    ConfigError
        If it cannot be read, or what is given does not suit it.
    InputError
        If it is not a table of samples; names the line.
    """

    def __init__(
        self, source: str | Path, columns: str | None = None, rate: float | None = None
    ) -> None:
        self.point: Topic = replace(POINT, name='samples')  # as messages call them
        self.path: Topic | None = PATH
        self.topics: dict[str, str] = {}
        self.paths: list[Array] = []
        self.axis_paths: list[AxisPath] = []
        self.remarks: list[str] = []
        self.foreign: Counter[str] = Counter()
        self._where = str(source)
        table = read_table(source, named=columns is None)
        columns_found = find_columns(table, columns)
        chosen = _chosen(table, columns_found)
        self._xyz, unit, factor = _points(chosen, columns_found)
        self._stamp_ns, time_words = _stamps(chosen, columns_found, self._xyz, rate)
        self.left_out = reason_counts(chosen.faults)
        if chosen.faults:
            self.remarks.append(
                f'left out {len(chosen.faults)} of {len(chosen.lines) + len(chosen.faults)} lines '
                f'that are not samples: {fault_words(chosen.faults)}'
            )
        still = _without_noise(chosen, columns_found, factor, self._xyz)
        if still:
            self.remarks.append(still)
        place = ', '.join(c.name for c in columns_found.point)
        form = ' and '.join(sorted({c.form for c in chosen.point if c.form}))
        self.said = [
            f'{len(self._xyz)} samples; {_what(columns_found)} from {place} in {unit}'
            f'{f", {form}" if form else ""}; {time_words}',
            *columns_found.remarks,
        ]

    def require(self, *wanted: Topic) -> None:
        """Refuse a table without a path."""
        if any(topic.name == PATH.name for topic in wanted) and not self.paths:
            raise InputError(
                f'{self._where}: is a table of samples without a path; give the path beside it: '
                f'--path plan.json, or a CSV of its corner points x,y,z (with rotary axes: of '
                f'axis positions, as target,x,y,z,a,c)'
            )

    def received(self) -> ReceivedPoints:
        """Return the points in the order of the file."""
        return ReceivedPoints(self._stamp_ns, self._xyz, self._stamp_ns)


@dataclass(frozen=True)
class _Chosen:
    """The rows of a table that hold a sample.

    Attributes
    ----------
    time : list of list of str
        Fields of each column of times.
    faults : dict of int to str
        Lines that are left out, and why.
    width : int
        Columns of the table.
    """

    where: str
    lines: Sequence[int]
    point: list[NumberColumn]
    time: list[list[str]]
    faults: dict[int, str]
    width: int


def _chosen(table: TextTable, columns: Columns) -> _Chosen:
    """Columns of the samples, without the lines that are none; InputError if these are many."""
    texts = {c.place: table.column(c.place) for c in columns.time}
    decimal = [c for c in columns.time if _is_decimal(texts[c.place])]
    read = table.numbers({c.place: c.name for c in (*columns.point, *decimal)})
    bad: dict[int, str] = {}
    for column in reversed(read):
        bad |= column.faults
    times = []
    for c in columns.time:
        if c in decimal:
            times.append(read[3 + decimal.index(c)].texts)
            continue
        times.append(texts[c.place])
        for row, text in enumerate(texts[c.place]):
            if not text or is_missing(text):
                bad.setdefault(row, f'{c.name} is {value_text(text) if text else "empty"}')
    faults = dict(table.faults) | {table.lines[row]: reason for row, reason in bad.items()}
    _refuse_many(table, faults, len(table.lines) - len(bad))
    if not bad:
        return _Chosen(table.where, table.lines, read[:3], times, faults, table.width)
    rows = [row for row in range(len(table.lines)) if row not in bad]
    point = [
        NumberColumn([c.texts[row] for row in rows], c.values[rows], {}, c.form) for c in read[:3]
    ]
    return _Chosen(
        table.where,
        [table.lines[row] for row in rows],
        point,
        [[column[row] for row in rows] for column in times],
        faults,
        table.width,
    )


def _is_decimal(texts: Sequence[str]) -> bool:
    """Return whether a column holds numbers, not times of day."""
    there = (text for text in texts if text and not is_missing(text))
    first = list(itertools.islice(there, 9))
    return sum(is_number(text) or text.lower() in NOT_FINITE for text in first) > len(first) // 2


def _refuse_many(table: TextTable, faults: Mapping[int, str], usable: int) -> None:
    """Refuse a table of which many lines are not samples."""
    if len(faults) > MAX_LEFT_OUT * (len(faults) + usable):
        raise InputError(
            f'{table.where}: {len(faults)} of {len(faults) + usable} lines are not samples: '
            f'{fault_words(faults)}; give one table per file, and export the samples that were '
            f'measured only'
        )


def _points(chosen: _Chosen, columns: Columns) -> tuple[Array, str, float]:
    """Points (n, 3), m, the unit in words, and in m."""
    values = np.stack([c.values for c in chosen.point], axis=1)
    if columns.polar:
        return *_from_polar(chosen.where, values, columns), 1.0
    units = {c.unit for c in columns.point}
    if len(units) > 1:
        raise InputError(f'{chosen.where}: x, y, z are in different units: {units}')
    unit, words = _length(chosen.where, units.pop(), values)
    return values * LENGTHS[unit], words, LENGTHS[unit]


def _length(where: str, stated: str | None, values: Array) -> tuple[str, str]:
    """Unit of lengths, and the same in words; by their size if none is stated."""
    if stated is not None and stated not in LENGTHS:
        raise InputError(
            f'{where}: {stated!r} is not a supported unit of length; possible: {known_lengths()}'
        )
    unit = stated or ('mm' if np.nanmax(np.abs(values), initial=0.0) > TRACKER_RANGE else 'm')
    return unit, unit if stated else f'{unit} (not stated, by their size)'


def _what(columns: Columns) -> str:
    return 'direction, vertical angle and distance' if columns.polar else 'x, y, z'


def _from_polar(where: str, values: Array, columns: Columns) -> tuple[Array, str]:
    """Points of direction, vertical angle and slope distance."""
    across, up, along = columns.point
    for column in (across, up):
        if column.unit not in ANGLES:
            what = 'its unit is not stated'
            if column.unit is not None:
                what = f'{column.unit!r} is not a supported unit of angle'
            raise InputError(
                f'{where}: {column.name}: {what}; write deg, gon or rad into the header, as in '
                f'{column.name.split()[0]} [gon]'
            )
    unit, words = _length(where, along.unit, values[:, 2])
    direction = values[:, 0] * ANGLES[across.unit or '']
    vertical = values[:, 1] * ANGLES[up.unit or '']
    sense, kind = columns.polar.split()
    if kind == 'v':
        kind = _vertical_kind(where, vertical, up)
    elevation = np.pi / 2 - vertical if kind == 'zenith' else vertical
    direction = -direction if sense == 'hz' else direction
    length = values[:, 2] * LENGTHS[unit]
    xyz = length[:, None] * np.stack(
        [np.cos(elevation) * np.cos(direction), np.cos(elevation) * np.sin(direction),
         np.sin(elevation)], axis=1,
    )  # fmt: skip
    turn = 'clockwise' if sense == 'hz' else 'counter-clockwise'
    seen = 'zenith angle' if kind == 'zenith' else 'elevation'
    return xyz, f'{across.unit}, {up.unit} and {words}: direction {turn} from above, {seen}'


def _vertical_kind(where: str, vertical: Array, column: Column) -> str:
    """'zenith' or 'el': vertical angles near 90 degrees are zenith angles."""
    finite = vertical[np.isfinite(vertical)]
    if len(finite) and np.all(np.abs(finite - np.pi / 2) < np.pi / 4):
        return 'zenith'
    if len(finite) and np.all(np.abs(finite) < np.pi / 4):
        return 'el'
    raise InputError(
        f'{where}: {column.name} may be a zenith angle or an elevation; name it one of these'
    )


def _without_noise(chosen: _Chosen, columns: Columns, unit: float, xyz: Array) -> str:
    """Words if the points have no noise beyond their rounding, as commanded ones.

    Second differences of points on straight lines at constant feed are those of the rounding.
    """
    if columns.polar or len(xyz) < NOISE_SAMPLES:
        return ''
    size = np.nanmedian(np.abs(np.diff(xyz, n=2, axis=0)), axis=0)
    digits = [max(len(t.partition('.')[2]) for t in c.texts[:NOISE_SAMPLES]) for c in chosen.point]
    step = unit * 10.0 ** -np.array(digits, dtype=float)
    if (
        not np.all(size <= np.maximum(1.01 * step, SMALLEST_NOISE))
        or np.ptp(xyz, axis=0).max() < MIN_TRAVEL
    ):
        return ''
    size_um = max(1e6 * float(step.max()), 1e-6)
    return (
        f'the points have no noise beyond their rounding ({size_um:g} um): commanded or smoothed '
        f'positions give tables that show no errors; export the measured ones'
    )


def _stamps(
    chosen: _Chosen, columns: Columns, xyz: Array, rate: float | None
) -> tuple[Stamps, str]:
    """Stamps, and in words where they come from."""
    if not columns.time:
        if rate is None:
            beside = ''.join(f'; {remark}' for remark in columns.remarks if 'counts' in remark)
            raise InputError(
                f'{chosen.where}: has no column of times{beside}; state the rate of the tracker, '
                f'e.g. --rate 1000 (Hz), or name the column (--columns)'
            )
        step = 1e9 / rate
        return np.rint(step * np.arange(len(xyz))).astype(np.int64), f'{rate:g} Hz as stated'
    if rate is not None:
        raise ConfigError(
            f'--rate: {chosen.where} holds times ({columns.time[0].name}); leave --rate out, or '
            f'the column of times (--columns {_without_time(chosen, columns)})'
        )
    total = np.zeros(len(xyz), np.int64)
    words = []
    for column, texts in zip(columns.time, chosen.time, strict=True):
        stamps, unit = _stamps_of(chosen, columns, column, texts, xyz)
        total += stamps
        words.append(f'{column.name} in {unit}')
    if len(total) > 1 and not total.any():
        raise InputError(
            f'{chosen.where}: {words[0]}: all {len(total)} times are zero; export the time of '
            f'measurement, or leave the column out (--columns '
            f'{_without_time(chosen, columns)}) and state the rate (--rate)'
        )
    return total, f'time from {" and ".join(words)}'


def _without_time(chosen: _Chosen, columns: Columns, time: str = '-') -> str:
    """Columns as --columns takes them, without the times or with another name of them."""
    words = ['-'] * chosen.width
    for column in columns.time:
        words[column.place] = time
    for axis, column in zip('xyz', columns.point, strict=True):
        unit = SUGGESTED.get(LENGTHS.get(column.unit or '', 0.0))
        words[column.place] = axis if unit is None else f'{axis}_{unit}'
    return ','.join(words)


def _stamps_of(
    chosen: _Chosen, columns: Columns, column: Column, texts: list[str], xyz: Array
) -> tuple[Stamps, str]:
    alone = len(columns.time) == 1
    if column.unit is None and alone and counts_rows(texts):
        raise InputError(
            f'{chosen.where}: {column.name} counts the lines ({texts[0]}, {texts[1]}, {texts[2]}) '
            f'and is not a time; leave it out and state the rate of the tracker: --columns '
            f'{_without_time(chosen, columns)} --rate 1000 (Hz); or state its unit, as in time_ms'
        )
    try:
        read = read_times(texts, column.unit, xyz, alone=alone)
    except MomentError as error:
        line = '' if error.row is None else f'line {chosen.lines[error.row]}: '
        ways = [_without_time(chosen, columns, f'time_{order}') for order in error.orders]
        cure = f'; state which: {" or ".join(f"--columns {way}" for way in ways)}' if ways else ''
        raise InputError(f'{chosen.where}: {line}{column.name}: {error}{cure}') from None
    except InputError as error:
        raise InputError(f'{chosen.where}: {column.name}: {error}') from None
    return read.stamp_ns, read.words
