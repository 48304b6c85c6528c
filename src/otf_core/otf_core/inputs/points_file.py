# SPDX-License-Identifier: Apache-2.0
"""Points from a text: CSV in m with the header x,y,z, or any table that says what it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError, InputError
from otf_core.files.text_table import TextTable, fault_words
from otf_core.files.units import LENGTHS, known_lengths
from otf_core.inputs.columns import Columns, named_columns, read_table, unnamed_words


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
        found = named_columns(table, nominal=True)
        if found is None:
            raise ConfigError(
                f'{unnamed_words(table)}; write there what they are, as in x_mm,y_mm,z_mm'
            )
        if found.polar:
            raise ConfigError(f'{name}: holds polar coordinates; expected x, y, z')
        return _points(table, found)
    except InputError as error:
        raise ConfigError(f'{error} (expected the header x,y,z, in m, or with units)') from None


def _points(table: TextTable, columns: Columns) -> tuple[Array, str]:
    read = table.numbers({c.place: c.name for c in columns.point})
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
    form = next((f', {c.form}' for c in read if c.form), '')
    names = [c.name for c in columns.point]
    if unit is None and not form and names == ['x', 'y', 'z'] and table.dialect.separator == ',':
        return points, ''
    said = f'{table.where}: x, y, z from {", ".join(names)} in {unit or "m"}{form}'
    said += ''.join(f'; {remark}' for remark in columns.remarks)
    return points * LENGTHS[unit or 'm'], said
