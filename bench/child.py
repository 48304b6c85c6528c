# SPDX-License-Identifier: Apache-2.0
"""Whole processes measured from outside: wall time, processor time, peak memory.

Peak memory is that of the operating system (``wait4``). A child counts what its parent held when
it was started, so the benches that use this hold nothing themselves.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KIB = 1 if sys.platform == 'darwin' else 1024
"""Bytes in the unit of ru_maxrss."""


@dataclass(frozen=True)
class Cost:
    """Wall and processor time in s, peak memory in bytes, what was printed."""

    wall: float
    processor: float
    peak: int
    text: str


def core_on_path(tree: Path = ROOT) -> dict[str, str]:
    """Environment in which a child imports otf_core from a source tree."""
    places = [str(tree / 'src/otf_core'), os.environ.get('PYTHONPATH', '')]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, places))}


def measured(words: Sequence[str | Path], environment: Mapping[str, str] | None = None) -> Cost:
    """Run Python with these words to its end; SystemExit with its last lines if it fails."""
    command = [sys.executable, *map(str, words)]
    start = time.perf_counter()
    child = subprocess.Popen(
        command,
        env=environment or core_on_path(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    text = child.stdout.read()
    _, status, used = os.wait4(child.pid, 0)
    wall = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        lines = '\n'.join(text.splitlines()[-12:])
        raise SystemExit(f'{" ".join(command)}\nended with {child.returncode}:\n{lines}')
    return Cost(wall, used.ru_utime + used.ru_stime, used.ru_maxrss * KIB, text)


def spread(values: Sequence[float], form: str = '.2f') -> str:
    """Smallest value, and the median in brackets."""
    return f'{min(values):{form}} ({statistics.median(values):{form}})'


def circumstances() -> str:
    """What else the machine did: cores and load."""
    return f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}'
