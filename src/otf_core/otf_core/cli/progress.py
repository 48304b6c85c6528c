# SPDX-License-Identifier: Apache-2.0
"""What a long job is doing and how long it will take, on stderr.

On a terminal it is one line that is written anew every second, from two seconds on; elsewhere,
where nobody waits, a line a stage from ten seconds on.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from otf_core.cli.output import note, own_line
from otf_core.live.stages import Progress, of_whole
from otf_core.live.time_left import TimeLeft, about

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
        left = self._left.estimate('job', share, now)
        if share > 0:
            words += f'  {100 * share:.0f} %'
        if about(left):
            words += f'  {about(left)}'
        own_line(words[: shutil.get_terminal_size().columns - 1])


@contextmanager
def progress_of(
    arguments: argparse.Namespace,
    stage: str,
    spans: Mapping[str, tuple[float, float]] | None = None,
) -> Iterator[Progress]:
    """Show a job while it lasts.

    Parameters
    ----------
    arguments : Namespace
        With ``quiet``: nothing is shown.
    stage : str
        What is done as long as nobody says otherwise.
    spans : mapping of stage to (begin, end), optional
        Shares of the time, see ``live.stages``.

    Yields
    ------
    callable(stage, share of the stage)
    """
    if arguments.quiet:
        yield lambda stage, share: None
        return
    line = _Line(stage, sys.stderr.isatty())
    line.start()
    try:
        yield of_whole(spans or {}, line.tell)
    finally:
        line.end()
