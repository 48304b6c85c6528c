# SPDX-License-Identifier: Apache-2.0
"""Numbers to CSV, with full precision; reading is ``text_table``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.files.writing import write_text


def begins_with(path: str | Path, header: str) -> bool:
    """Tell whether the first line of a file is this header."""
    try:
        with open(path, 'rb') as file:
            return file.read(len(header) + 1) == f'{header}\n'.encode()
    except OSError:
        return False


def ends_head(path: str | Path, tail: str) -> bool:
    """Tell whether the first line of a file ends with these columns."""
    try:
        with open(path, 'rb') as file:
            return file.readline(1000).rstrip(b'\n').endswith(tail.encode())
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
