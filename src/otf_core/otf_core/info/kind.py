# SPDX-License-Identifier: Apache-2.0
"""A kind of file: how it is known, and what it says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Explained:
    """What a file says.

    Attributes
    ----------
    rows : tuple of (str, str)
        What is looked at, and what it is; for people.
    facts : mapping of str to plain data
        For programs; SI units unless a name says otherwise.
    """

    rows: tuple[tuple[str, str], ...]
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Kind:
    """A kind of file or folder.

    Attributes
    ----------
    name : str
    what : str
        What it is good for, one sentence.
    is_one : callable
        Path to bool.
    explain : callable
        Path to Explained.
    """

    name: str
    what: str
    is_one: Callable[[Path], bool]
    explain: Callable[[Path], Explained]


def begins(path: Path, *starts: str) -> bool:
    """Tell whether the first line of a text file that is no comment begins so."""
    try:
        with path.open(encoding='utf-8-sig') as file:
            lines = (line for line in file if line.strip() and not line.startswith('#'))
            return next(lines, '').startswith(starts)
    except (OSError, UnicodeDecodeError):
        return False
