# SPDX-License-Identifier: Apache-2.0
"""Points in CSV: header ``x,y,z`` (further columns ignored), metres."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import shown
from otf_core.files.writing import unreadable, write_text


def read_points_csv(path: str | Path) -> NDArray[np.float64]:
    """Read points.

    Returns
    -------
    ndarray, shape (n, 3), m

    Raises
    ------
    ConfigError
        Names file, line and column of what is wrong.
    """
    try:
        with open(path, newline='', encoding='utf-8-sig') as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise unreadable(path, error) from None
    except (UnicodeDecodeError, csv.Error):
        raise ConfigError(f'{path}: not a CSV text file') from None
    header = [h.strip() for h in rows[0]] if rows else []
    if not {'x', 'y', 'z'} <= set(header):
        got = shown(','.join(header))
        raise ConfigError(f'{path}: line 1: expected the header x,y,z, got {got}')
    places = [header.index(k) for k in 'xyz']
    points = []
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            points.append([float(row[k]) for k in places])
        except (ValueError, IndexError):
            raise ConfigError(
                f'{path}: line {number}: expected three numbers, got {shown(row)}'
            ) from None
        if not np.all(np.isfinite(points[-1])):
            raise ConfigError(f'{path}: line {number}: not finite')
    if not points:
        raise ConfigError(f'{path}: holds no points')
    return np.array(points)


def begins_with(path: str | Path, header: str) -> bool:
    """Tell whether the first line of a file is this header."""
    try:
        with open(path, 'rb') as file:
            return file.read(len(header) + 1) == f'{header}\n'.encode()
    except OSError:
        return False


def tidy(value: float) -> float:
    """A length as it is written: to 1e-12 m, without the noise of sums and without -0.0."""
    return round(float(value), 12) + 0.0


def write_csv(
    path: str | Path,
    header: str,
    columns: NDArray[np.float64],
    flags: NDArray[np.bool_] | None = None,
) -> None:
    """Write numbers with full precision under a comma-separated header, whole or not at all.

    Parameters
    ----------
    path : str or Path
    header : str
    columns : ndarray, shape (n, columns)
    flags : ndarray of bool, shape (n,), optional
        A last column of 1 and 0.
    """
    rows = [','.join(map(repr, row)) for row in columns.tolist()]
    if flags is not None:
        rows = [f'{row},{int(flag)}' for row, flag in zip(rows, flags, strict=True)]
    write_text(path, '\n'.join([header, *rows]) + '\n')
