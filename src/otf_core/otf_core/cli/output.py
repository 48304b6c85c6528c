# SPDX-License-Identifier: Apache-2.0
"""What the command line prints, and its exit codes: results on stdout, messages on stderr."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from otf_core.errors import OtfError

if TYPE_CHECKING:
    from pathlib import Path

QUALITY_GATE_FAILED = 4
LIMIT_NOT_PROVEN = 5

UNIT = re.compile(r'(?<![A-Za-z0-9_])u(m|rad)(?![A-Za-z0-9_])')
"""Millionths of m and rad in ASCII."""
LONGEST_MESSAGE = 1000
BULKY = 'covariance'
"""Key of a result that stays in its file."""


class OutputFull(OtfError):
    """Standard output takes no more."""


def as_shown(text: str, stream: TextIO) -> str:
    """Text with um and urad as µm and µrad on a terminal that has the sign.

    Pipes and files get the ASCII that other programs look for.
    """
    if not stream.isatty():
        return text
    proper = UNIT.sub('\N{MICRO SIGN}\\1', text).replace(' +/- ', ' \N{PLUS-MINUS SIGN} ')
    try:
        proper.encode(stream.encoding or 'ascii')
    except (UnicodeEncodeError, LookupError):
        return text
    return proper


def say(text: str) -> None:
    """Print a line of the result as it is."""
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
    own_line('')
    print(as_shown(text, sys.stderr), file=sys.stderr, flush=True)


_shown: list[str] = []
"""The line of a job under way, as it stands on the terminal."""


def own_line(text: str) -> None:
    """Write the line of a job under way in place of the last one; empty: take it away."""
    if not text and not _shown:
        return
    before = _shown.pop() if _shown else ''
    line = f'\r{text.ljust(len(before))}' + ('' if text else '\r')
    print(line, end='', file=sys.stderr, flush=True)
    if text:
        _shown.append(text)


@contextmanager
def logged(*, quiet: bool) -> Iterator[None]:
    """Print what the core logs to stderr: how inputs were read, what was left out."""
    import logging

    class Noted(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            note(f'otf: {record.getMessage()}')

    handler, logger = Noted(), logging.getLogger('otf_core')
    level = logger.level
    logger.setLevel(logging.WARNING if quiet else logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def answer(arguments: argparse.Namespace, words: str, data: Mapping[str, Any]) -> None:
    """Print a result: words, or with --json one object and the words beside it.

    Parameters
    ----------
    arguments : Namespace
        With ``json`` and ``quiet``.
    words : str
        With --quiet they are not printed.
    data : mapping
        The object.
    """
    if arguments.json:
        if not arguments.quiet:
            note(words)
        say(json.dumps({'verb': arguments.verb, **data}, indent=1, allow_nan=False))
    elif not arguments.quiet:
        say(as_shown(words, sys.stdout))


def answer_from(
    arguments: argparse.Namespace, words: str, files: Sequence[Path], main: str, **more: Any
) -> None:
    """Print the result of a verb that wrote files; the object is one of them.

    Parameters
    ----------
    arguments : Namespace
        With ``json``, ``quiet`` and ``out``.
    words : str
        Which files were written is added.
    files : sequence of Path
        As they were written.
    main : str
        Name of the JSON file in the folder that holds the result.
    more
        Further entries of the object.
    """
    data: dict[str, Any] = {}
    if arguments.json:
        from pathlib import Path

        from otf_core.files.json_file import read_json

        data = dict(read_json(Path(arguments.out) / main))
        data.pop(BULKY, None)
        data |= {**more, 'out': arguments.out, 'files': _places(files, arguments.out)}
    answer(arguments, words + listed(files, arguments.out), data)


def _places(files: Sequence[Path], folder: str) -> list[str]:
    """Names of files as they stand in a folder."""
    return [str(f.relative_to(folder)) if f.is_relative_to(folder) else f.name for f in files]


def listed(files: Sequence[Path], folder: str) -> str:
    """Say which files were written."""
    return f'\nwritten: {", ".join(_places(files, folder))} in {folder}'
