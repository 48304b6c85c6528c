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
from otf_tracker_driver.health import Flow, Gap, Hindrance
from otf_tracker_driver.silence import Silence
from otf_tracker_driver.stream.description import JSON, Description
from otf_tracker_driver.stream.lines import (
    LATEST,
    LONGEST,
    Lines,
    Unreadable,
    holds_one_object,
    read_point,
    to_arrays,
)
from otf_tracker_driver.stream.transport import Transport, open_source

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
"""Chunks that wait to be fetched; the oldest are left out beyond."""
NOT_FETCHED, NO_ROOM = 'not fetched in time', 'datagrams that came while there was no room'
MOST_GAPS = 1000
ENDED_WITHIN = 6.0
"""s"""


class Reader:
    """Owns a transport; every method returns at once.

    Parameters
    ----------
    transport : Transport
        Open.

    Attributes
    ----------
    hindrance : Hindrance or None
        What keeps points from flowing just now.
    points, unreadable : int
        Lines that held a point, and lines that did not.
    not_fetched : int
        Points that nobody fetched in time.
    connections, interruptions : int
        Times that the source was opened; that the stream broke off and went on.
    gaps : tuple of Gap
        The latest of them that have ended.
    """

    def __init__(self, how: Description, transport: Transport) -> None:
        self._how, self._transport = how, transport
        self._clock, self._stamper, self._lines = HostClock(), Stamper(), Lines()
        self._samples: deque[Samples] = deque()
        self._last_ns = self._begun_points = self._begun_repeated = 0
        self._back, self._stamp_before = 0, -int(LATEST)
        self._streams = self._wanted = self._told = 0
        self._ended = threading.Event()
        self.hindrance: Hindrance | None = None
        self._warning = ''
        self._since, self._opened = time.monotonic(), 0
        self.points = self.unreadable = self.interruptions = self.not_fetched = 0
        self.connected, self.connections = True, 1
        self.gaps: tuple[Gap, ...] = ()
        self._lost = self._owed = ''
        self._silence, self._last_point = Silence(), 0.0
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
    def trouble(self) -> str:
        """What is wrong just now; empty if nothing."""
        return (self.hindrance.trouble if self.hindrance else '') or self._warning

    @property
    def repeated(self) -> int:
        """Points left out because their time had been there."""
        return self._stamper.dropped

    @property
    def left_out(self) -> dict[str, int]:
        """What else was left out, by reason."""
        counts = {NOT_FETCHED: self.not_fetched, NO_ROOM: self._transport.dropped}
        return {reason: count for reason, count in counts.items() if count}

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
            self._since, self._opened = time.monotonic(), 0
            self._hinder(Flow.STARTING, f'{self._how.source}: waiting for the first points')
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
        except Exception as error:  # noqa: BLE001 - a defect in the thread, which fetch raises
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
                    self._transport = open_source(self._how.source, self._how.peer)
                except InputError as error:
                    self._hinder(Flow.NO_CONNECTION, f'{error}; connecting again')
                    continue
                pause, self._opened = FIRST_PAUSE, self._opened + 1
                self._hinder(Flow.SILENT, f'{self._how.source}: open again, points are awaited')
                self.connected, self.connections = True, self.connections + 1
                break
            else:
                return

    def _lose(self, reason: str) -> None:
        """Note that the source is lost."""
        self.connected = False
        self._hand_on(self._stamper.flush())
        self._hinder(Flow.NO_CONNECTION, f'{reason}; connecting again')
        if self._wanted and self._last_ns and not self._lost:
            self._lost = reason

    def _hinder(self, kind: Flow, text: str) -> None:
        """Note what keeps points from flowing."""
        self.hindrance = Hindrance(kind, text, self._since, self._opened)

    def _read(self) -> None:
        """Read until the source is lost or the reader ends."""
        # a source that is told to start is silent before, as a rule
        self._lines, started = Lines(self._transport.cuts_in and not self._how.start), 0
        while not self._ended.is_set():
            wanted = self._wanted
            if wanted != started:
                if started:
                    self._tell(self._how.stop)
                self._begin(wanted)
                started = wanted
            chunk = self._transport.receive(WAIT)
            if not wanted:
                self._pass_by(chunk)
                continue
            if chunk is not None:
                if self._owed:
                    self._tell(self._owed)
                self._take(chunk)
            if self._silence.beat() > SILENT_FOR:
                self._hinder(Flow.SILENT, self._silent())
        if started:
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
        self._silence.heard()
        self._last_point, self._warning = time.monotonic(), ''

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
            self._silence.heard()
            try:
                points.append(read_point(line, self._how))
            except Unreadable as error:
                self.unreadable += 1
                wrong = f'{error} in line {line[:80]!r}'
        if self._lines.too_long > too_long:
            self._silence.heard()
            self.unreadable += self._lines.too_long - too_long
            wrong = wrong or f'line of more than {LONGEST} bytes'
        if points:
            self.points += len(points)
            self._stamp(*to_arrays(points, arrival_ns), arrival_ns)
            self._last_point, self._next_example = time.monotonic(), 0
            self._warning = self._repeating()
        elif wrong:
            self._say(wrong)

    def _say(self, wrong: str) -> None:
        """State why lines are none, by an example; another one once twice as many have come."""
        if time.monotonic() - self._last_point < WRONG_FOR or self.unreadable < self._next_example:
            return
        self._next_example = 2 * self.unreadable
        text = f'{self._how.source}: {wrong}; check the description'
        self._hinder(Flow.SILENT, text)

    def _silent(self) -> str:
        if self._lines.partial:
            return f'{self._how.source}: bytes arrive, but no end of line (LF or CR)'
        return f'{self._how.source} sends nothing; is it on?'

    def _repeating(self) -> str:
        """State that times repeat, or go back and forth; empty if they do not."""
        points, repeated = self.points - self._begun_points, self.repeated - self._begun_repeated
        if points < MANY or max(repeated, self._back) <= FEW * points:
            return ''
        if self._back > FEW * points:
            return (
                f'{self._how.source}: times go back again and again; do two sources send here, '
                f'or is stamp in the description another column?'
            )
        return (
            f'{self._how.source}: points are left out, since their time is not later than that '
            f'of the point before; check stamp and time in the description'
        )

    def _stamp(self, stamps: np.ndarray, xyz: np.ndarray, arrival_ns: int) -> None:
        if self._how.stamp is not None:
            steps = np.diff(stamps, prepend=self._stamp_before)
            self._back += int(np.count_nonzero(steps < -REPEATED))
            self._stamp_before = int(stamps[-1])
            self._hand_on(self._stamper.take(stamps, xyz, arrival_ns))
            if self._stamper.waiting and not self._stamper.clock.settled:
                text = f'{self._how.source}: points wait until its clock is known'
                self._hinder(Flow.WAITING_FOR_CLOCK, text)
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
                self.interruptions += 1
            self._last_ns = int(part.stamp_ns[-1])
            self.hindrance, self._since, self._opened = None, time.monotonic(), 0
            if len(self._samples) == MOST_HELD:
                self.not_fetched += len(self._samples.popleft())
            self._samples.append(part)
