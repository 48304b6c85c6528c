# SPDX-License-Identifier: Apache-2.0
"""What the benches share: Markdown tables, lists of options, processes measured from outside.

Peak memory is that of the operating system (``wait4``). A child counts what its parent held when
it was started, so the benches that use this hold nothing themselves.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def heading(titles: Sequence[str]) -> str:
    """First two lines of a table; the first column to the left, the others to the right."""
    return f'{row(titles)}\n|---|{"---:|" * (len(titles) - 1)}'


def row(cells: Iterable[Any]) -> str:
    """One line of a table."""
    return f'| {" | ".join(map(str, cells))} |'


def texts(line: str) -> tuple[str, ...]:
    """Split a list given with commas."""
    return tuple(part.strip() for part in line.split(',') if part.strip())


def numbers(line: str) -> tuple[float, ...]:
    """Split a list of numbers given with commas."""
    return tuple(map(float, texts(line)))


@dataclass(frozen=True)
class Cost:
    """Wall and processor time in s, peak memory in MB, what was printed."""

    wall: float
    processor: float
    peak: float
    text: str


def core_on_path(tree: Path = ROOT) -> dict[str, str]:
    """Environment in which a child imports otf_core from a source tree."""
    return {**os.environ, 'PYTHONPATH': str(tree / 'src/otf_core')}


def measured(words: Sequence[str | Path]) -> Cost:
    """Run Python with these words to its end; SystemExit with its last lines if it fails."""
    command, start = [sys.executable, *map(str, words)], time.perf_counter()
    child = subprocess.Popen(command, env=core_on_path(), text=True, stdout=subprocess.PIPE,
                             stderr=subprocess.STDOUT)  # fmt: skip
    text = child.stdout.read() if child.stdout else ''
    _, status, used = os.wait4(child.pid, 0)
    wall = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 4, 5):
        lines = '\n'.join(text.splitlines()[-12:])
        raise SystemExit(f'{" ".join(command)}\nended with {child.returncode}:\n{lines}')
    return Cost(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, text)
