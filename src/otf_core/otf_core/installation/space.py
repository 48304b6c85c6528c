# SPDX-License-Identifier: Apache-2.0
"""Room for results, temporary files and the work itself."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from otf_core.installation.state import ERROR, OK, WARNING, State

LITTLE, LEAST = 2e9, 1e8
"""Bytes: a day of bags; a single run with its results."""
MEMORY = 2e9
"""Bytes; a diagnosis takes up to two thirds of it."""


def check() -> Iterator[State]:
    """Ask the folder here, that of temporary files, and memory."""
    for name, folder in (('here', Path.cwd()), ('temporary files', Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        found = f'{free / 1e9:.1f} GB free for {name} ({folder})'
        if not os.access(folder, os.W_OK):
            yield State('disk', WARNING, f'{folder} cannot be written', 'give --out elsewhere')
        elif free < LITTLE:
            severity = ERROR if free < LEAST else WARNING
            yield State('disk', severity, found, 'make room, or set TMPDIR to another disk')
        else:
            yield State('disk', OK, found)
    size = _memory()
    if size is None:
        return
    found = f'{size / 1e9:.1f} GB, {os.cpu_count()} processors'
    few = 'close other programs; a diagnosis of long runs may need more'
    yield State('memory', OK, found) if size >= MEMORY else State('memory', WARNING, found, few)


def _memory() -> float | None:
    """Bytes of this computer; None where the system does not say."""
    try:
        return float(os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES'))
    except (AttributeError, ValueError, OSError):
        return None
