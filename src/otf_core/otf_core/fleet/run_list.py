# SPDX-License-Identifier: Apache-2.0
"""The list of a fleet: CSV with the header ``name,bag,machine``, a line per run."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from otf_core.errors import ConfigError
from otf_core.files.writing import unreadable

HEADER = ['name', 'bag', 'machine']
NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,99}')
TAKEN = ('fleet.json', 'fleet.html', 'manifest.json')
"""Names in the folder of results that no run may have."""


@dataclass(frozen=True)
class ListedRun:
    """One line: name of the run and of its folder, bag, machine.yaml."""

    name: str
    bag: Path
    machine: Path


def read_list(path: str | Path) -> list[ListedRun]:
    """Read a list of runs.

    Relative paths are looked for beside the list, then where the command runs.

    Raises
    ------
    ConfigError
        Names file, line and what is wrong. Bags that are missing are no mistake of the list: such
        a run fails alone.
    """
    path = Path(path)
    try:
        with open(path, newline='', encoding='utf-8-sig') as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise unreadable(path, error) from None
    except (UnicodeDecodeError, csv.Error):
        raise ConfigError(f'{path}: not a CSV text file') from None
    if not rows or [h.strip() for h in rows[0]] != HEADER:
        raise ConfigError(f'{path}: line 1: expected the header {",".join(HEADER)}')
    runs: dict[str, ListedRun] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not any(word.strip() for word in row):
            continue
        words = [word.strip() for word in row]
        if len(words) != len(HEADER) or not all(words):
            raise ConfigError(f'{path}: line {number}: expected name,bag,machine, got {row}')
        name, bag, machine = words
        if not NAME.fullmatch(name) or name in TAKEN:
            raise ConfigError(
                f'{path}: line {number}: {name!r} is no name of a folder; letters, digits, '
                f'dots, dashes and underscores'
            )
        if name in runs:
            raise ConfigError(f'{path}: line {number}: the name {name} appears twice')
        runs[name] = ListedRun(name, _found(path.parent, bag), _found(path.parent, machine))
    if not runs:
        raise ConfigError(f'{path}: lists no runs')
    return list(runs.values())


def _found(folder: Path, word: str) -> Path:
    """Absolute path of what a list names."""
    beside, here = folder / word, Path(word)
    return (here if here.exists() and not beside.exists() else beside).absolute()
