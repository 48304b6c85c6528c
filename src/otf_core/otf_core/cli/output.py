# SPDX-License-Identifier: Apache-2.0
"""What the command line prints, and its exit codes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

QUALITY_GATE_FAILED = 4


def say(text: str) -> None:
    """Print a line of the result."""
    print(text, flush=True)


def note(text: str) -> None:
    """Print a line beside the result: progress, warnings, errors."""
    print(text, file=sys.stderr, flush=True)


def listed(files: Sequence[Path], folder: str) -> str:
    """Say which files were written."""
    places = (f.relative_to(folder) if f.is_relative_to(folder) else f.name for f in files)
    return f'\nwritten: {", ".join(map(str, places))} in {folder}'
