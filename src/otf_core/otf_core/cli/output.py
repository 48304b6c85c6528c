# SPDX-License-Identifier: Apache-2.0
"""What the command line prints, and its exit codes."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from otf_core.errors import OtfError

if TYPE_CHECKING:
    from pathlib import Path

QUALITY_GATE_FAILED = 4


LONGEST_MESSAGE = 1000


class OutputFull(OtfError):
    """Standard output takes no more."""


def say(text: str) -> None:
    """Print a line of the result."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        # what is still buffered would fail once more at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OutputFull(
            f'standard output cannot be written ({error.strerror}); all files are in place'
        ) from None


def bounded(text: str) -> str:
    """Cut the middle out of a message that nobody would read."""
    if len(text) <= LONGEST_MESSAGE:
        return text
    half = LONGEST_MESSAGE // 2
    return f'{text[:half]} ... {text[-half:]}'


def note(text: str) -> None:
    """Print a line beside the result: progress, warnings, errors."""
    print(text, file=sys.stderr, flush=True)


def listed(files: Sequence[Path], folder: str) -> str:
    """Say which files were written."""
    places = (f.relative_to(folder) if f.is_relative_to(folder) else f.name for f in files)
    return f'\nwritten: {", ".join(map(str, places))} in {folder}'
