# SPDX-License-Identifier: Apache-2.0
"""Exports of trackers as text: a table of samples to stamps and points, as a bag gives them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.bags.bag_reading import Reading, ReceivedPoints
from otf_core.bags.rosbag2_metadata import PATH, POINT, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.files.strict_yaml import value_text
from otf_core.files.text_table import (
    ANGLES,
    LENGTHS,
    NUMBER,
    NumberColumn,
    TextTable,
    fault_words,
    known_lengths,
    reason_counts,
)
from otf_core.files.text_times import TIMES, TimeTextError, read_times
from otf_core.inputs.columns import (
    Column,
    Columns,
    columns_option,
    counts_rows,
    find_columns,
    read_table,
)

# The unit of length follows from the size of the track where the file does not say it.

SUFFIXES = ('.csv', '.txt', '.tsv', '.asc', '.dat', '.xyz', '.pts', '.log')
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


class TextReading(Reading):
    """A table of samples.

    Parameters
    ----------
    columns : str, optional
        What stands in the columns, see ``columns.find_columns``.
    rate : float, optional
        Hz; of samples without a time.
    time_format : str, optional
        Form of the times, see ``text_times.read_times``.

    Raises
    ------
    ConfigError
        If it cannot be read, or what is given does not suit it.
    InputError
        If it is not a table of samples; names the line.
    """

    def __init__(
        self,
        source: str | Path,
        columns: str | None = None,
        rate: float | None = None,
        time_format: str | None = None,
    ) -> None:
        super().__init__(source, replace(POINT, name='samples'), PATH)
        table = read_table(source, named=columns is None)
        columns_found = find_columns(table, columns)
        chosen = _chosen(table, columns_found, time_format)
        self._xyz, unit, factor = _points(chosen, columns_found)
        self._stamp_ns, time_words = _stamps(chosen, columns_found, rate, time_format)
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
        self.said = [
            f'{len(self._xyz)} samples; {_what(columns_found)} from {place} in {unit}'
            f'{", with decimal commas" if chosen.commas else ""}; {time_words}',
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
    commas : bool
        Numbers have decimal commas.
    """

    where: str
    lines: Sequence[int]
    point: list[NumberColumn]
    time: list[list[str]]
    faults: dict[int, str]
    width: int
    commas: bool


def _chosen(table: TextTable, columns: Columns, time_format: str | None) -> _Chosen:
    """Columns of the samples, without the lines that are none; InputError if these are many."""
    decimal = [] if time_format else [c for c in columns.time if _is_decimal(table, c)]
    read, commas = table.numbers({c.place: c.name for c in (*columns.point, *decimal)})
    bad: dict[int, str] = {}
    for column in reversed(read):
        bad |= column.faults
    times: list[Sequence[str]] = []
    for c in columns.time:
        texts = table.columns[c.place]
        times.append(read[3 + decimal.index(c)].texts if c in decimal else texts)
        for row, text in enumerate(() if c in decimal else texts):
            if not any(map(str.isdigit, text)):
                bad.setdefault(row, f'{c.name} is {value_text(text) if text else "empty"}')
    faults = dict(table.faults) | {table.lines[row]: reason for row, reason in bad.items()}
    refuse_many(table, faults, len(table.lines) - len(bad))
    rows = [row for row in range(len(table.lines)) if row not in bad]
    point = [NumberColumn([c.texts[row] for row in rows], c.values[rows]) for c in read[:3]]
    return _Chosen(
        table.where,
        [table.lines[row] for row in rows],
        point,
        [[texts[row] for row in rows] for texts in times],
        faults,
        table.width,
        commas,
    )


def _is_decimal(table: TextTable, column: Column) -> bool:
    """Return whether a column holds numbers, not times of day."""
    first = [text for text in table.columns[column.place] if any(map(str.isdigit, text))][:9]
    return sum(1 for text in first if NUMBER.match(text)) > len(first) // 2


def refuse_many(table: TextTable, faults: Mapping[int, str], usable: int) -> None:
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
    unit, words = length_unit(chosen.where, units.pop(), values)
    return values * LENGTHS[unit], words, LENGTHS[unit]


def length_unit(where: str, stated: str | None, values: Array) -> tuple[str, str]:
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
    unit, words = length_unit(where, along.unit, values[:, 2])
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
    chosen: _Chosen, columns: Columns, rate: float | None, time_format: str | None
) -> tuple[NDArray[np.int64], str]:
    """Stamps, and in words where they come from."""
    where, time = chosen.where, columns.time
    option = f'--columns {columns_option(chosen.width, columns.point, time, "-")}'
    if not time:
        if rate is None or time_format is not None:
            beside = ''.join(f'; {remark}' for remark in columns.remarks if 'counts' in remark)
            raise InputError(
                f'{where}: has no column of times{beside}; state the rate of the tracker, '
                f'e.g. --rate 1000 (Hz), or name the column (--columns)'
            )
        step = 1e9 / rate
        count = len(chosen.lines)
        return np.rint(step * np.arange(count)).astype(np.int64), f'{rate:g} Hz as stated'
    if rate is not None:
        raise ConfigError(
            f'--rate: {where} holds times ({time[0].name}); leave --rate out, or the column of '
            f'times ({option})'
        )
    given, units = chosen.time, [c.unit for c in time]
    if len(time) > 1 and not set(units) <= set(TIMES):  # date and time of day
        given, units = [list(map(' '.join, zip(*given, strict=True)))], [None]
    if units == [None] and time_format is None and counts_rows(given[0]):
        raise InputError(
            f'{where}: {time[0].name} counts the lines ({", ".join(given[0][:3])}) and is not a '
            f'time; leave it out and state the rate of the tracker: {option} --rate 1000 (Hz); or '
            f'state its unit, as in time_ms'
        )
    total = np.zeros(len(chosen.lines), np.int64)
    words = []
    for column, unit, texts in zip(time, units, given, strict=False):
        try:
            stamps, read_as = read_times(texts, unit, time_format)
        except TimeTextError as error:
            line = '' if error.row is None else f'line {chosen.lines[error.row]}: '
            ways = [
                f'--columns {columns_option(chosen.width, columns.point, time, f"time_{u}")}'
                for u in error.units
            ]
            cure = f'; state it: {" or ".join(ways)}' if ways else ''
            raise InputError(f'{where}: {line}{column.name}: {error}{cure}') from None
        total += stamps
        words.append(f'{column.name} in {read_as}')
    if len(total) > 1 and not np.ptp(total):
        raise InputError(
            f'{where}: {words[0]}: all {len(total)} times are {value_text(given[0][0])}; export '
            f'the time of measurement with all its digits, or leave the column out ({option}) and '
            f'state the rate (--rate)'
        )
    return total, f'time from {" and ".join(words)}'
