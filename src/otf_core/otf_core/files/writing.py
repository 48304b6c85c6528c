# SPDX-License-Identifier: Apache-2.0
"""Files that are either whole or not there: written beside the final name, then renamed."""

from __future__ import annotations

import errno
import os
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError, OtfError

FULL = (errno.ENOSPC, errno.EDQUOT)
DISK_FULL = 'the disk is full'


class DiskFull(ConfigError):
    """A file does not fit on its disk."""


def unwritable(path: str | Path, error: OSError) -> ConfigError:
    """Error about a file that cannot be written."""
    kind = DiskFull if error.errno in FULL else ConfigError
    return kind(f'{path}: cannot be written ({error.strerror or error})')


def write_if_possible(
    missing: dict[str, str] | None, name: str, write: Callable[[], object]
) -> bool:
    """Write a file; where the disk is full or the program fails leave it out and state why.

    The tables are worth more than a page about them, so an error of ours in one file costs no
    other.

    Parameters
    ----------
    missing : dict of str to str, or None
        Takes the name and why it is missing; None: it may not be missing.

    Returns
    -------
    bool
        Whether it is there.

    Raises
    ------
    ConfigError
        If it cannot be written for another reason.
    """
    try:
        write()
    except DiskFull:
        if missing is None:
            raise
        missing[name] = DISK_FULL
        return False
    except OtfError:
        raise
    except Exception as error:  # whatever fails, the other files are written
        if missing is None:
            raise
        missing[name] = internal_error(error)
        return False
    return True


def internal_error(error: BaseException) -> str:
    """State an error of the program itself in one line, with its place in the source."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f'{Path(place.filename).name}:{place.lineno}'
    return f'internal error: {type(error).__name__}: {error} ({where})'


def unreadable(path: str | Path, error: OSError) -> ConfigError:
    """Error about a file that cannot be read; names one of nearly the same name, if there is."""
    path, hint = Path(path), ''
    if isinstance(error, FileNotFoundError) and path.parent.is_dir():
        near = get_close_matches(path.name, (p.name for p in path.parent.iterdir()), 1)
        hint = f'; did you mean {path.parent / near[0]}?' if near else ''
    elif isinstance(error, IsADirectoryError):
        hint = '; name the file in it'
    return ConfigError(f'{path}: cannot be read ({error.strerror}){hint}')


def refuse_pipe(path: str | Path) -> None:
    """Refuse, as a ConfigError, a pipe: what is looked at before it is read would be lost."""
    if Path(path).is_fifo():
        raise ConfigError(f'{path}: is a pipe, which can be read only once; give a file')


def ensure_folder(folder: str | Path) -> Path:
    """Make a folder with its parents; ConfigError if that is not possible."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f'{folder}: cannot be created as a folder ({error.strerror})') from None
    return folder


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside ``path``; it takes the final name if the block succeeds."""
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(
            prefix=f'.{path.stem}-', suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        os.chmod(name, 0o644)
    except OSError as error:
        raise unwritable(path, error) from None
    try:
        yield Path(name)
        os.replace(name, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        Path(name).unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding='utf-8', newline='\n')  # the same bytes on Windows


# Numbers to CSV, with full precision; reading is ``text_table``.


def ends_head(path: str | Path, tail: str) -> bool:
    """Return whether the first line of a file ends with these columns."""
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
    columns : ndarray, shape (n, columns)
        What is not a number is an empty field.
    flags : ndarray of bool, shape (n,), optional
        A last column of 1 and 0.
    """
    rows = [','.join(repr(v) if v == v else '' for v in row) for row in columns.tolist()]
    if flags is not None:
        rows = [f'{row},{int(flag)}' for row, flag in zip(rows, flags, strict=True)]
    write_text(path, '\n'.join([header, *rows]) + '\n')
