# SPDX-License-Identifier: Apache-2.0
"""What the command line prints, and its exit codes: results on stdout, messages on stderr."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from otf_core.errors import OtfError
from otf_core.files.message_text import with_micro_sign
from otf_core.live.stages import Progress, TimeLeft, approximate_time, of_whole

if TYPE_CHECKING:
    from pathlib import Path

    from otf_core.documents import ResultDocument
    from otf_core.files.output_folder import OutputFolder


QUALITY_GATE_FAILED = 4
LIMIT_NOT_PROVEN = 5
LONGEST_MESSAGE = 1000
BULKY = ('covariance', 'covariance_run', 'covariance_change')
"""Keys of a result that stay in its file."""


class OutputFull(OtfError):
    """Standard output takes no more."""


def typeset_units(text: str, stream: TextIO) -> str:
    """Text with um and urad as µm and µrad on a terminal that has the sign.

    Pipes and files get the ASCII that other programs look for.
    """
    if not stream.isatty():
        return text
    proper = with_micro_sign(text).replace(' +/- ', ' \N{PLUS-MINUS SIGN} ')
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


def note(text: str) -> None:
    """Print a line beside the result: progress, warnings, errors."""
    own_line('')
    print(typeset_units(text, sys.stderr), file=sys.stderr, flush=True)


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
def log_to_stderr() -> Iterator[None]:
    """Print what the core logs to stderr: how inputs were read, what was left out."""
    import logging

    class Noted(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            note(f'otf: {record.getMessage()}')

    handler, logger = Noted(), logging.getLogger('otf_core')
    level = logger.level
    logger.setLevel(logging.INFO)
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
        With ``json``.
    words : str
    data : mapping
        The object.
    """
    if arguments.json:
        note(words)
        say(json.dumps({'verb': arguments.verb, **data}, indent=1, allow_nan=False))
    else:
        say(typeset_units(words, sys.stdout))


def finish(
    arguments: argparse.Namespace,
    out: OutputFolder,
    document: ResultDocument,
    write: Callable[[Path], list[Path]] | None = None,
) -> int:
    """Write a result into its folder, print it, and return the exit code that it states.

    Parameters
    ----------
    write : callable(folder), optional
        Writes what stands in the folder; page and file of the document if not given.
    """
    from otf_core.reports.pages import summary_of, write_document

    with progress_of('writing'), out.filled(arguments.verb) as folder:
        files = write(folder) if write else write_document(document, folder)
    if out.missing:
        note(f'otf: warning: {out.missing_words}')
    data: dict[str, Any] = {}
    if arguments.json:
        data = {k: v for k, v in document.to_dict().items() if k not in BULKY}
        data |= {'out': arguments.out, 'files': _places(files, arguments.out)}
    answer(arguments, summary_of(document) + report_files(files, arguments.out), data)
    return document.exit_code


def _places(files: Sequence[Path], folder: str) -> list[str]:
    """Names of files as they stand in a folder, or in the one in which they were prepared."""
    if not files:
        return []
    own = all(f.is_relative_to(folder) for f in files)
    root = folder if own else os.path.commonpath([f.parent for f in files])
    return [str(f.relative_to(root)) for f in files]


def report_files(files: Sequence[Path], folder: str) -> str:
    """State which files were written, and which page of them to open."""
    places = _places(files, folder)
    page = next((place for place in places if place.endswith('.html')), '')
    first = f'\nopen {os.path.join(folder, page)}' if page else ''
    return f'\nwritten: {", ".join(places)} in {folder}{first}'


# What a long job is doing and how long it will take, on stderr.
#
# On a terminal it is one line that is written anew every second, from two seconds on; elsewhere,
# where nobody waits, a line a stage from ten seconds on.

SILENT = {True: 2.0, False: 10.0}
"""s; jobs that end sooner show nothing, on a terminal and elsewhere."""
TICK = 1.0
"""s"""


class _Line:
    """The line of a job."""

    def __init__(self, stage: str, on_terminal: bool) -> None:
        self._began = time.monotonic()
        self._stage, self._share, self._told = stage, 0.0, ''
        self._left = TimeLeft()
        self._on_terminal = on_terminal
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._ticking = threading.Thread(target=self._tick, daemon=True)

    def tell(self, stage: str, share: float) -> None:
        """Take what is being done, and the share of the whole that is done."""
        with self._lock:
            self._stage, self._share = stage, share
        if not self._on_terminal:
            self._show()

    def start(self) -> None:
        """Begin to show."""
        self._ticking.start()

    def end(self) -> None:
        """Take the line away."""
        self._over.set()
        self._ticking.join()
        if self._on_terminal:
            own_line('')

    def _tick(self) -> None:
        while not self._over.wait(TICK):
            self._show()

    def _show(self) -> None:
        now = time.monotonic()
        passed = now - self._began
        if passed < SILENT[self._on_terminal]:
            return
        with self._lock:
            stage, share = self._stage, self._share
        if not self._on_terminal:
            if stage != self._told:
                self._told = stage
                note(f'otf: {stage} ...')
            return
        words = f'{stage}  {passed:.0f} s'
        time_left = self._left.estimate('job', share, now)
        if share > 0:
            words += f'  {100 * share:.0f} %'
        if approximate_time(time_left):
            words += f'  {approximate_time(time_left)}'
        own_line(words[: shutil.get_terminal_size().columns - 1])


@contextmanager
def progress_of(
    stage: str, spans: Mapping[str, tuple[float, float]] | None = None
) -> Iterator[Progress]:
    """Show a job while it lasts.

    Parameters
    ----------
    stage : str
        What is done as long as nobody says otherwise.
    spans : mapping of stage to (begin, end), optional
        Shares of the time, see ``live.stages``.

    Yields
    ------
    callable(stage, share of the stage)
    """
    line = _Line(stage, sys.stderr.isatty())
    line.start()
    try:
        yield of_whole(spans or {}, line.tell)
    finally:
        line.end()
