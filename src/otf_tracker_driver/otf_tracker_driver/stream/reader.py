# SPDX-License-Identifier: Apache-2.0
"""Reads a source in a thread of its own, stamps its points, connects again when it is lost."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque

import numpy as np

from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_tracker_driver.clock.stamper import REPEATED, HostClock, Stamper
from otf_tracker_driver.health import Gap
from otf_tracker_driver.stream.description import JSON, Description
from otf_tracker_driver.stream.lines import (
    LATEST,
    LONGEST,
    Lines,
    Unreadable,
    as_arrays,
    holds_one_object,
    read_point,
)
from otf_tracker_driver.stream.transport import Transport, opened

WAIT = 0.1
"""s"""
FIRST_PAUSE, LONGEST_PAUSE = 0.2, 2.0
"""s; between attempts to connect again, doubled each time."""
SILENT_FOR = 3.0
"""s"""
WRONG_FOR = 1.0
"""s; lines without a point are said to be wrong if no other has come for so long."""
MANY, FEW = 100, 0.05
"""If more than this share of so many points is left out, or goes back in time, it is trouble."""
MOST_HELD = 100_000
"""Chunks that wait to be fetched; the oldest are lost beyond."""
MOST_GAPS = 1000
ENDED_WITHIN = 6.0
"""s"""


class Reader:
    """Owns a transport; every method returns at once.

    Parameters
    ----------
    how : Description
    transport : Transport
        Open.

    Attributes
    ----------
    trouble : str
        What hinders just now; empty if nothing.
    points, unreadable : int
        Lines that held a point, and lines that did not.
    connected : bool
    connections, interruptions : int
        Times that the source was opened, and lost while it streamed.
    gaps : tuple of Gap
        The latest of them that have ended.
    """

    def __init__(self, how: Description, transport: Transport) -> None:
        self._how, self._transport = how, transport
        self._clock, self._stamper, self._lines = HostClock(), Stamper(), Lines()
        self._samples: deque[Samples] = deque(maxlen=MOST_HELD)
        self._last_ns = self._begun_points = self._begun_repeated = 0
        self._back, self._stamp_before = 0, -int(LATEST)
        self._streams = self._wanted = self._told = 0
        self._ended = threading.Event()
        self.trouble = ''
        self.points = self.unreadable = self.interruptions = 0
        self.connected, self.connections = True, 1
        self.gaps: tuple[Gap, ...] = ()
        self._lost = self._owed = ''
        self._heard = self._last_point = 0.0
        self._next_example = 0
        self._defect: Exception | None = None
        self._thread = threading.Thread(target=self._work, name='stream', daemon=True)
        self._thread.start()

    @property
    def source(self) -> str:
        """Address of the source."""
        return str(self._how.source)

    @property
    def by_host(self) -> bool:
        """True if points are stamped on arrival."""
        return self._how.stamp is None

    @property
    def repeated(self) -> int:
        """Points left out because their time had been there."""
        return self._stamper.dropped

    @property
    def stamper(self) -> Stamper:
        """What is known of the clock of the source."""
        return self._stamper

    def stream(self, on: bool) -> None:
        """Start or stop a stream; what was not fetched of the one before is forgotten."""
        self._wanted = 0
        if on:
            self._samples.clear()
            self._last_ns, self._lost = 0, ''
            self._streams += 1
            self._wanted = self._streams

    def fetch(self) -> list[Samples]:
        """Samples that have come since the last call; RuntimeError if a defect has ended this."""
        if self._defect:
            raise RuntimeError(f'{self._how.source} is not read any more') from self._defect
        parts = []
        while self._samples:
            parts.append(self._samples.popleft())
        return parts

    def close(self) -> None:
        """End the thread and close the source."""
        self._ended.set()
        self._thread.join(ENDED_WITHIN)

    def _work(self) -> None:
        try:
            self._keep_reading()
        except Exception as error:  # noqa: BLE001 - fetch raises it
            self._defect = error

    def _keep_reading(self) -> None:
        pause = FIRST_PAUSE
        while not self._ended.is_set():
            try:
                self._read()
            except OSError as error:
                self._lose(f'{self._how.source}: {error.strerror or error}')
            self._transport.close()
            while not self._ended.wait(pause):
                pause = min(2 * pause, LONGEST_PAUSE)
                try:
                    self._transport = opened(self._how.source, self._how.peer)
                except InputError as error:
                    self.trouble = f'{error}; connecting again'
                    continue
                self.trouble, pause = '', FIRST_PAUSE
                self.connected, self.connections = True, self.connections + 1
                break
            else:
                return

    def _lose(self, reason: str) -> None:
        """Note that the source is lost."""
        self.connected = False
        self.trouble = f'{reason}; connecting again'
        self._hand_on(self._stamper.flush())
        if self._wanted and self._last_ns and not self._lost:
            self.interruptions += 1
            self._lost = reason

    def _read(self) -> None:
        """Read until the source is lost or the reader ends."""
        # a source that is told to start is silent before, as a rule
        self._lines, told = Lines(self._transport.cuts_in and not self._how.start), 0
        while not self._ended.is_set():
            wanted = self._wanted
            if wanted != told:
                if told:
                    self._tell(self._how.stop)
                self._begin(wanted)
                told = wanted
            chunk = self._transport.receive(WAIT)
            if not wanted:
                self._pass_by(chunk)
                continue
            if chunk is not None:
                if self._owed:
                    self._tell(self._owed)
                self._take(chunk)
            if time.monotonic() - self._heard > SILENT_FOR:
                self.trouble = self._silent()
        if told:
            with contextlib.suppress(OSError):
                self._tell(self._how.stop)

    def _begin(self, wanted: int) -> None:
        """Begin a stream, or go on with it after a loss; 0: none."""
        self._told = wanted
        self._stamper.restart()  # what waits belongs to the stream before
        self._begun_points, self._begun_repeated = self.points, self.repeated
        self._back, self._stamp_before = 0, -int(LATEST)
        if wanted:
            self._tell(self._how.start)
        self._heard = self._last_point = time.monotonic()

    def _tell(self, text: str) -> None:
        """Send a text; later if it is not known yet to whom."""
        self._owed = '' if not text or self._transport.send(text.encode()) else text

    def _pass_by(self, chunk: bytes | None) -> None:
        """Leave lines out, but remember where one begins: it may end within the stream."""
        for _ in self._lines.feed(self._whole(chunk or b'')):
            pass

    def _whole(self, chunk: bytes) -> bytes:
        """A datagram ends a line, and is a single one in JSON."""
        if not self._transport.datagrams:
            return chunk
        if self._how.format == JSON and chunk.count(b'\n') and holds_one_object(chunk):
            chunk = b' '.join(chunk.split())
        return chunk + b'\n'

    def _take(self, chunk: bytes) -> None:
        arrival_ns = self._clock.now_ns() - self._transport.age_ns
        points, wrong, too_long = [], '', self._lines.too_long
        for line in self._lines.feed(self._whole(chunk)):
            self._heard = time.monotonic()
            try:
                points.append(read_point(line, self._how))
            except Unreadable as error:
                self.unreadable += 1
                wrong = f'{error} in line {line[:80]!r}'
        if self._lines.too_long > too_long:
            self._heard = time.monotonic()
            self.unreadable += self._lines.too_long - too_long
            wrong = wrong or f'line of more than {LONGEST} bytes'
        if points:
            self.points += len(points)
            self._stamp(*as_arrays(points, arrival_ns), arrival_ns)
            self._last_point, self._next_example = self._heard, 0
            self.trouble = self._repeating()
        elif wrong:
            self._say(wrong)

    def _say(self, wrong: str) -> None:
        """Say why lines are none, by an example; another one once twice as many have come."""
        if time.monotonic() - self._last_point < WRONG_FOR or self.unreadable < self._next_example:
            return
        self._next_example = 2 * self.unreadable
        self.trouble = f'{self._how.source}: {wrong}; check the description'

    def _silent(self) -> str:
        if self._lines.partial:
            return f'{self._how.source}: no end of a line (LF or CR) for {SILENT_FOR:.0f} s'
        return f'{self._how.source}: nothing for {SILENT_FOR:.0f} s; is it sending?'

    def _repeating(self) -> str:
        """Say that times repeat, or go back and forth; empty if they do not."""
        points, repeated = self.points - self._begun_points, self.repeated - self._begun_repeated
        if points < MANY or max(repeated, self._back) <= FEW * points:
            return ''
        if self._back > FEW * points:
            return (
                f'{self._how.source}: times go back again and again; do two sources send here, '
                f'or is stamp in the description another column?'
            )
        return (
            f'{self._how.source}: points are left out, as their time is not later than that '
            f'before; check stamp and time in the description'
        )

    def _stamp(self, stamps: np.ndarray, xyz: np.ndarray, arrival_ns: int) -> None:
        if self._how.stamp is not None:
            steps = np.diff(stamps, prepend=self._stamp_before)
            self._back += int(np.count_nonzero(steps < -REPEATED))
            self._stamp_before = int(stamps[-1])
            self._hand_on(self._stamper.take(stamps, xyz, arrival_ns))
            return
        first = max(arrival_ns, self._last_ns + 1)
        self._hand_on([Samples(first + np.arange(len(xyz), dtype=np.int64), xyz)])

    def _hand_on(self, parts: list[Samples]) -> None:
        if self._told != self._wanted:
            return
        for part in parts:
            if self._lost:
                gap = Gap(self._last_ns, int(part.stamp_ns[0]), self._lost)
                self.gaps, self._lost = (*self.gaps[-MOST_GAPS:], gap), ''
            self._last_ns = int(part.stamp_ns[-1])
            self._samples.append(part)
