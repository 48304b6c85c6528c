# SPDX-License-Identifier: Apache-2.0
"""Journal: what arrives is written to disk at once, a bag per run, by a thread of its own.

A chunk is written and synchronised (fdatasync) every 0.2 s, so a killed process or a power cut
costs what came since: 0.2 s and the time the disk takes for one chunk. While the disk refuses,
what has come is kept and tried again; nothing here ever waits for the disk but the thread.
"""

from __future__ import annotations

import fcntl
import os
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.cdr import encode_points
from otf_core.bags.journal_file import Rows, one_message
from otf_core.bags.journal_run import (
    RECORDING,
    Definitions,
    JournalRun,
    Recorded,
    set_state,
    take_up,
    unfinished,
)
from otf_core.bags.topics import POINT, Topic
from otf_core.errors import ConfigError

PERIOD = 0.2
"""s; a chunk is written so often."""
MOST = 1 << 26
"""Bytes kept while the disk refuses; what comes beyond is not journalled, and counted."""
LOCK = '.lock'


@dataclass(frozen=True)
class _End:
    """A run ends with a state; ``run`` is None where it was ended before."""

    folder: Path
    run: JournalRun | None
    state: str


class Journal:
    """Runs below one directory, written one after another.

    Parameters
    ----------
    directory : Path
        Made if it is not there.
    texts : mapping of str to str
        Message definitions of types that are not part of ROS 2 itself.
    beside : sequence of Topic
        Further topics.

    Attributes
    ----------
    directory : Path
    trouble : str
        Why what arrives is not on the disk at present; empty if it is.

    Raises
    ------
    ConfigError
        If the directory cannot be written, or another journal is kept there.
    """

    def __init__(
        self, directory: Path, texts: Mapping[str, str], beside: Sequence[Topic] = ()
    ) -> None:
        self.directory = directory
        self._lock = _locked(directory)
        self._definitions = Definitions(texts, tuple(beside))
        self._run: JournalRun | None = None
        self._latched: dict[Topic, bytes] = {}
        self._items: list[tuple[JournalRun, Rows] | _End] = []
        self._pending, self._missed = 0, 0
        self._clock = time.time_ns() - time.monotonic_ns()
        self._wake, self._closing = threading.Condition(), False
        self.trouble = ''
        self._thread = threading.Thread(target=self._work, name='journal', daemon=True)
        self._thread.start()

    @property
    def folder(self) -> Path | None:
        """Folder of the present run; None before its first sample."""
        return self._run.folder if self._run else None

    def points(
        self,
        stamp_ns: NDArray[np.int64],
        xyz: NDArray[np.float64],
        frame: str,
        topic: Topic = POINT,
    ) -> None:
        """Take points of one frame as they arrived; the first begin a run.

        Parameters
        ----------
        stamp_ns : ndarray of int64, shape (n,), ns
        xyz : ndarray of float64, shape (n, 3), m
        frame : str
        topic : Topic
        """
        run = self._run or self._begin()
        self._put(run, Rows(topic, encode_points(stamp_ns, xyz, frame), self._now()))

    def message(self, topic: Topic, data: bytes) -> None:
        """Take a serialized message that stays valid: it is part of every run from now on."""
        self._latched[topic] = data
        if self._run:
            self._put(self._run, one_message(topic, data, self._now()))

    def event(self, topic: Topic, data: bytes) -> None:
        """Take a serialized message of what has happened: it is part of this run only."""
        if self._run:
            self._put(self._run, one_message(topic, data, self._now()))

    def end(self, state: str) -> Path | None:
        """End the present run, if there is one, and say what became of it; return its folder."""
        run, self._run = self._run, None
        if run is None:
            return None
        self._append(_End(run.folder, run, state))
        return run.folder

    def settle(self, folder: Path, state: str) -> None:
        """Say what became of a run, which ends if it is the present one."""
        if self._run and self._run.folder == folder:
            self.end(state)
        else:
            self._append(_End(folder, None, state))

    def take_up(self, within: float) -> tuple[Recorded | None, list[Path]]:
        """Go on with the newest unfinished run, if it was written lately.

        Parameters
        ----------
        within : float
            s; longer ago it is not the running measurement.

        Returns
        -------
        recorded : Recorded or None
        left : list of Path
            Other unfinished runs.

        Raises
        ------
        InputError
            If it cannot be read.
        """
        folders = unfinished(self.directory)
        if not folders:
            return None, []
        newest = max(p.stat().st_mtime for p in folders[-1].iterdir())
        if time.time() - newest > within:
            return None, folders
        recorded = take_up(folders[-1], self._definitions)
        self._run = recorded.run
        self._clock = max(self._clock, recorded.end_ns + 1 - time.monotonic_ns())
        return recorded, folders[:-1]

    def close(self) -> None:
        """Write what has come; a run that has not ended can be taken up."""
        if self._run:
            self.end(RECORDING)
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        os.close(self._lock)

    def _begin(self) -> JournalRun:
        name = f'{datetime.now(timezone.utc):%Y%m%dT%H%M%S.%fZ}'
        self._run = run = JournalRun(self.directory / name, self._definitions)
        for topic, data in self._latched.items():
            self._put(run, one_message(topic, data, self._now()))
        return run

    def _now(self) -> int:
        """Time of arrival, ns: the clock of the system, but never back."""
        return self._clock + time.monotonic_ns()

    def _put(self, run: JournalRun, rows: Rows) -> None:
        if self._pending > MOST:
            self._missed += len(rows.data)
            return
        self._append((run, rows))

    def _append(self, item: tuple[JournalRun, Rows] | _End) -> None:
        with self._wake:
            self._items.append(item)
            if not isinstance(item, _End):
                self._pending += item[1].data.nbytes

    def _work(self) -> None:
        waiting: list[tuple[JournalRun, Rows] | _End] = []
        closing = False
        while not closing:
            with self._wake:
                self._wake.wait_for(lambda: self._closing, PERIOD)
                closing, items, self._items = self._closing, self._items, []
            waiting += items
            try:
                self._write(waiting)
                self.trouble = ''
            except OSError as error:
                self.trouble = (
                    f'{self.directory}: the journal cannot be written '
                    f'({error.strerror or error}); the samples are in memory'
                )
            if self._missed:
                self.trouble += f'; {self._missed} messages are not in the journal'

    def _write(self, waiting: list[tuple[JournalRun, Rows] | _End]) -> None:
        """Write what waits, run by run, and take it off the list."""
        while waiting:
            first = waiting[0]
            if isinstance(first, _End):
                if first.run:
                    first.run.close(first.state)
                else:
                    with suppress(FileNotFoundError):  # removed by somebody
                        set_state(first.folder, first.state)
                del waiting[0]
                continue
            run, rows = first[0], []
            for item in waiting:
                if isinstance(item, _End) or item[0] is not run:
                    break
                rows.append(item[1])
            run.append(rows)
            del waiting[: len(rows)]
            with self._wake:
                self._pending -= sum(r.data.nbytes for r in rows)


def _locked(directory: Path) -> int:
    """Open the lock of a directory; ConfigError if another process holds it."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise ConfigError(
            f'{directory}: the journal cannot be kept there ({error.strerror}); '
            f'correct output_directory or journal_directory'
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(lock, 20, 0).decode(errors='replace').strip()
        os.close(lock)
        raise ConfigError(
            f'{directory}: another calibrator (process {holder or "unknown"}) keeps its journal '
            f'there; give this one another journal_directory or output_directory'
        ) from None
    os.ftruncate(lock, 0)
    os.pwrite(lock, f'{os.getpid()}\n'.encode(), 0)
    return lock
