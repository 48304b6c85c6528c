# SPDX-License-Identifier: Apache-2.0
"""Exports of trackers as text: a table of samples to stamps and points, as a bag gives them.

What the file does not say is found out and said: the unit of length from the size of the track,
the unit of time from the speed that follows from it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_reading import Received
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.columns import LENGTHS, TIMES, Column, Columns, find_columns
from otf_core.inputs.moments import clocks_ns, decimals_ns, is_clock, since_first
from otf_core.inputs.text_table import TextTable, read_text_table

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

SUFFIXES = ('.csv', '.txt', '.tsv', '.asc', '.dat', '.xyz', '.pts', '.log')
LARGE = 60.0
"""Farther from the tracker is no metre: the range of trackers ends there."""
USUAL_SPEED = 0.15
"""m/s, of machine tools that are measured."""
RATES = (0.5, 1e4)
"""Hz, that samples may have."""
GUESSED = ('s', 'ms', 'us', 'ns')
FAST = 75.0
"""Percentile of the speeds that is taken for that of the machine."""


def is_text(source: str | Path) -> bool:
    """Tell whether a recording is a text file, by its name."""
    return Path(source).suffix.lower() in SUFFIXES and Path(source).is_file()


class TextReading:
    """A table of samples; the same face as ``bags.bag.BagReading``.

    Parameters
    ----------
    source : str or Path
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
    remarks : list of str
        What was left out.
    said : list of str
        How the file was read.
    foreign : Counter of str
        Empty.

    Raises
    ------
    ConfigError
        If it cannot be read, or what is given does not suit it.
    InputError
        If it is no table of samples; names the line.
    """

    def __init__(
        self, source: str | Path, columns: str | None = None, rate: float | None = None
    ) -> None:
        self.point: Topic = replace(POINT, name='samples')  # as messages call them
        self.path: Topic | None = PATH
        self.topics: dict[str, str] = {}
        self.paths: list[Array] = []
        self.remarks: list[str] = []
        self.foreign: Counter[str] = Counter()
        self._where = str(source)
        table = read_text_table(source)
        found = find_columns(table, columns)
        self._xyz, unit = _points(table, found)
        self._stamp_ns, time_words = _stamps(table, found, self._xyz, rate)
        if table.skipped:
            self.remarks.append(
                f'skipped {len(table.skipped)} lines that are no samples, the first is line '
                f'{table.skipped[0]}'
            )
        place = ', '.join(c.name for c in found.point)
        self.said = [f'{len(self._xyz)} samples; x, y, z from {place} in {unit}; {time_words}']

    def require(self, *wanted: Topic) -> None:
        """Refuse a table without a path."""
        if any(topic.name == PATH.name for topic in wanted) and not self.paths:
            raise InputError(
                f'{self._where}: is a table of samples without a path; give the path beside it: '
                f'--path plan.json, or a CSV of its corner points x,y,z'
            )

    def received(self) -> Received:
        """Return the points in the order of the file."""
        return Received(self._stamp_ns, self._xyz, self._stamp_ns)


def _numbers(table: TextTable, column: Column) -> Array:
    texts = [table.number(row[column.place]) for row in table.rows]
    try:
        return np.array(texts, dtype=np.float64)
    except ValueError:
        for number, text in zip(table.lines, texts, strict=True):
            try:
                float(text)
            except ValueError:
                raise InputError(
                    f'{table.where}: line {number}: {column.name}: {text!r} is no number'
                ) from None
        raise


def _points(table: TextTable, columns: Columns) -> tuple[Array, str]:
    """Points (n, 3), m, and the unit in words."""
    xyz = np.stack([_numbers(table, c) for c in columns.point], axis=1)
    units = {c.unit for c in columns.point}
    if len(units) > 1:
        raise InputError(f'{table.where}: x, y, z are in different units: {units}')
    stated = units.pop()
    if stated is not None and stated not in LENGTHS:
        raise InputError(
            f'{table.where}: {stated!r} is no unit of length that is read; possible: {_known()}'
        )
    unit = stated or ('mm' if np.nanmax(np.abs(xyz), initial=0.0) > LARGE else 'm')
    xyz *= 10.0 ** LENGTHS[unit]
    return xyz, unit if stated else f'{unit} (not stated, by their size)'


def _known() -> str:
    return ', '.join(name for name in LENGTHS if name.isascii())


def _stamps(
    table: TextTable, columns: Columns, xyz: Array, rate: float | None
) -> tuple[Stamps, str]:
    """Stamps, and in words where they come from."""
    if not columns.time:
        if rate is None:
            raise InputError(
                f'{table.where}: has no column of times; state the rate of the tracker, e.g. '
                f'--rate 1000 (Hz), or name the column (--columns)'
            )
        step = 1e9 / rate
        return np.rint(step * np.arange(len(xyz))).astype(np.int64), f'{rate:g} Hz as stated'
    if rate is not None:
        raise ConfigError(
            f'--rate: {table.where} holds times ({columns.time[0].name}); leave --rate out, or '
            f'the column of times (--columns, a - in its place)'
        )
    total = np.zeros(len(xyz), np.int64)
    words = []
    for column in columns.time:
        stamps, unit = _stamps_of(table, column, xyz, alone=len(columns.time) == 1)
        total += stamps
        words.append(f'{column.name} in {unit}')
    if len(total) > 1 and not total.any():
        raise InputError(
            f'{table.where}: {words[0]}: all {len(total)} times are zero; export the time of '
            f'measurement, or leave the column out (--columns) and state the rate (--rate)'
        )
    return total, f'time from {" and ".join(words)}'


def _stamps_of(table: TextTable, column: Column, xyz: Array, *, alone: bool) -> tuple[Stamps, str]:
    texts = [row[column.place] for row in table.rows]
    try:
        if is_clock(texts[0]):
            return clocks_ns(texts), 'hours, minutes, seconds'
        numbers = [table.number(text) for text in texts]
        if column.unit in TIMES:
            return decimals_ns(numbers, TIMES[column.unit]), column.unit or ''
        if column.unit is not None:
            raise InputError(
                f'{table.where}: {column.name}: {column.unit!r} is no unit of time that is read; '
                f'possible: {", ".join(GUESSED)}'
            )
        unit = _guessed(since_first(numbers), xyz) if alone else 's'
        return decimals_ns(numbers, TIMES[unit]), f'{unit} (not stated, by the speed)'
    except ValueError as error:
        pairs = zip(table.lines, texts, strict=True)
        line = next((n for n, text in pairs if not _is_time(table.number(text))), 0)
        raise InputError(f'{table.where}: line {line}: {column.name}: {error}') from None


def _is_time(text: str) -> bool:
    try:
        _ = clocks_ns([text]) if is_clock(text) else decimals_ns([text], 0)
    except ValueError:
        return False
    return True


def _guessed(times: Array, xyz: Array) -> str:
    """Unit of times, less the first, that makes the machine as fast as machines are."""
    step = np.diff(times)
    usual = float(np.median(step)) if len(step) else 0.0
    if usual <= 0:
        return 's'
    moved = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    speed = float(np.percentile(moved[step > 0] / step[step > 0], FAST))
    fits: Sequence[str] = [
        u for u in GUESSED if RATES[0] <= 1.0 / (usual * 10.0 ** TIMES[u]) <= RATES[1]
    ]
    if not fits or speed <= 0:
        return fits[0] if fits else 's'
    return min(fits, key=lambda u: abs(np.log(speed / 10.0 ** TIMES[u] / USUAL_SPEED)))
