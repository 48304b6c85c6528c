# SPDX-License-Identifier: Apache-2.0
"""Points from a text: CSV in m with the header x,y,z, or any table that says what it holds."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError, InputError
from otf_core.files.csv_points import read_points_csv
from otf_core.files.writing import refuse_pipe
from otf_core.inputs.columns import LENGTHS, named_columns, unnamed_words
from otf_core.inputs.text_table import TextTable, read_text_table

Array = NDArray[np.float64]


def read_points(name: str | Path) -> tuple[Array, str]:
    """Points (n, 3), m, and what the text was read as; empty for a plain CSV.

    Delimiter, decimal comma, case and units of the head are found out; m where it states none.

    Raises
    ------
    ConfigError
        If the file cannot be read, names no points, or a line is none.
    """
    refuse_pipe(name)
    if _is_plain(name):
        return read_points_csv(name), ''
    try:
        table = read_text_table(name)
    except InputError:
        return read_points_csv(name), ''  # says what is expected
    found = named_columns(table)
    if found is None:
        raise ConfigError(
            f'{unnamed_words(table)}; write there what they are, as in x_mm,y_mm,z_mm'
        )
    if table.skipped:
        raise ConfigError(
            f'{name}: line {table.skipped[0]}: expected numbers like the other lines'
        )
    rows = [[_number(table.number(row[c.place])) for c in found.point] for row in table.rows]
    stated = {c.unit for c in found.point} - {None}
    if len(stated) > 1 or not stated <= set(LENGTHS):
        given = ' and '.join(sorted(map(repr, stated)))
        raise ConfigError(f'{name}: x, y, z are in {given}; expected m or mm')
    unit = stated.pop() or 'm' if stated else 'm'
    names = ', '.join(c.name for c in found.point)
    points = _finite(np.array(rows), table)
    return points * 10.0 ** LENGTHS[unit], f'{name}: x, y, z from {names} in {unit}'


def _is_plain(name: str | Path) -> bool:
    try:
        with open(name, encoding='utf-8-sig') as file:
            first = file.readline()
    except (OSError, UnicodeDecodeError):
        return True
    return {'x', 'y', 'z'} <= {field.strip() for field in first.split(',')}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan  # such as a time of day


def _finite(points: Array, table: TextTable) -> Array:
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise ConfigError(f'{table.where}: line {table.lines[bad[0]]}: not finite numbers')
    return points
