# SPDX-License-Identifier: Apache-2.0
"""Backend for anything that sends points as lines; see docs/trackers.md."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace

import numpy as np

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError, InputError
from otf_core.model.observation import Samples
from otf_tracker_driver.backends.base import CommonConfig, Flow, Health
from otf_tracker_driver.backends.lines import (
    JSON,
    LATEST,
    LONGEST,
    Description,
    Lines,
    Transport,
    Unreadable,
    holds_one_object,
    open_source,
    read_description,
    read_point,
)
from otf_tracker_driver.backends.live import LiveBackend
from otf_tracker_driver.clock import REPEATED

BY_HOST = (
    'WARNING: stamped on arrival, as its description declares: batches and delays of the network '
    'are in the stamps'
)
WAIT = 0.1
"""s"""
FIRST_PAUSE, LONGEST_PAUSE = 0.2, 2.0
"""s; between attempts to connect again, doubled each time."""
SILENT_FOR, WRONG_FOR = 3.0, 1.0
"""s; lines without a point are said to be wrong if no other has come for so long."""
MANY, FEW = 100, 0.05
"""If more than this share of so many points is left out, or goes back in time, it is trouble."""
NO_ROOM = 'datagrams that came while there was no room'


@dataclass(frozen=True)
class StreamConfig(Parameters):
    """Which source."""

    source: str = parameter(
        '', 'description of the source (YAML): address, columns, units, stamps; required'
    )


class Stream(LiveBackend):
    """Streams points that come as lines of text or JSON."""

    parameters = StreamConfig
    own: StreamConfig
    _how: Description
    _transport: Transport

    def __init__(self, common: CommonConfig, own: StreamConfig) -> None:
        super().__init__(common, own)
        self.points = self._back = self._next_example = 0
        self._begun, self._stamp_before = (0, 0), -int(LATEST)
        self._warning = self._owed = ''
        self._last_point = 0.0

    def connect(self) -> str:
        """Read the description and open the source."""
        if not self.own.source:
            raise ConfigError('parameter stream.source: missing; name the description to read')
        self._how = read_description(self.own.source)
        self.read(self._how, open_source(self._how.source, self._how.peer))
        return f'{self._how.format} lines from {self.source} ({self.own.source})'

    def read(self, how: Description, transport: Transport) -> None:
        """Begin to read an open source."""
        self._how, self._transport, self.source = how, transport, str(how.source)
        self.remark = BY_HOST if how.stamp is None else ''
        self.connected, self.connections = True, 1
        self.begin_work()

    @property
    def trouble(self) -> str:
        """What is wrong with the stream just now; empty if nothing."""
        return super().trouble or self._warning

    @property
    def health(self) -> Health:
        """How the source and its clock are."""
        by_host = bool(self.remark)
        if self.connected and self._transport.dropped:
            self.left_out[NO_ROOM] = self._transport.dropped
        health = super().health
        return replace(health, by_host=by_host, clock=None if by_host else health.clock)

    # What follows runs in the thread.

    def work(self) -> None:
        """Read the source, and open it again whenever it is lost."""
        pause = FIRST_PAUSE
        while not self.ended.is_set():
            try:
                self._read()
            except OSError as error:
                self.connected, reason = False, f'{self.source}: {error.strerror or error}'
                self.break_off(reason)
                self.hinder(Flow.NO_CONNECTION, f'{reason}; connecting again')
            self._transport.close()
            while not self.connected and not self.ended.wait(pause):
                pause = min(2 * pause, LONGEST_PAUSE)
                try:
                    self._transport = open_source(self._how.source, self._how.peer)
                except InputError as error:
                    self.hinder(Flow.NO_CONNECTION, f'{error}; connecting again')
                    continue
                pause, self.restarts = FIRST_PAUSE, self.restarts + 1
                self.hinder(Flow.SILENT, f'{self.source}: open again, points are awaited')
                self.connected, self.connections = True, self.connections + 1

    def _read(self) -> None:
        """Read until the source is lost or the thread shall end."""
        # a source that is told to start is silent before, as a rule
        self._lines = Lines(self._transport.cuts_in and not self._how.start)
        started = 0
        while not self.ended.is_set():
            wanted = self.wanted
            if wanted != started:
                if started:
                    self._tell(self._how.stop)
                started = wanted
                self._begin()
            chunk = self._transport.receive(WAIT)
            if not wanted:  # but remember where a line begins: it may end within the stream
                for _ in self._lines.feed(self._whole(chunk or b'')):
                    pass
                continue
            if chunk is not None:
                if self._owed:
                    self._tell(self._owed)
                self._take(chunk)
            if self.silence.beat() > SILENT_FOR:
                partial = 'bytes arrive, but no end of line (LF or CR)'
                silent = partial if self._lines.partial else 'sends nothing; is it on?'
                self.hinder(Flow.SILENT, f'{self.source}: {silent}')
        if started:
            with contextlib.suppress(OSError):
                self._tell(self._how.stop)

    def _begin(self) -> None:
        """Begin a stream, or go on with it after a loss."""
        self.begin()
        self._begun = self.points, self.stamper.dropped
        self._back, self._stamp_before = 0, -int(LATEST)
        self._last_point, self._warning = time.monotonic(), ''
        if self.served:
            self._tell(self._how.start)

    def _tell(self, text: str) -> None:
        """Send a text; later if it is not known yet to whom."""
        self._owed = '' if not text or self._transport.send(text.encode()) else text

    def _whole(self, chunk: bytes) -> bytes:
        """A datagram ends a line, and is a single one in JSON."""
        if not self._transport.datagrams:
            return chunk
        if self._how.format == JSON and chunk.count(b'\n') and holds_one_object(chunk):
            chunk = b' '.join(chunk.split())
        return chunk + b'\n'

    def _take(self, chunk: bytes) -> None:
        arrival_ns = self.host_clock.now_ns() - self._transport.age_ns
        stamps, xyz, wrong, too_long = [], [], '', self._lines.too_long
        for line in self._lines.feed(self._whole(chunk)):
            self.silence.heard()
            try:
                stamp, point = read_point(line, self._how)
                stamps.append(arrival_ns if stamp is None else stamp)
                xyz.append(point)
            except Unreadable as error:
                self.unreadable += 1
                wrong = f'{error} in line {line[:80]!r}'
        if self._lines.too_long > too_long:
            self.silence.heard()
            self.unreadable += self._lines.too_long - too_long
            wrong = wrong or f'line of more than {LONGEST} bytes'
        now = time.monotonic()
        if xyz:
            self.points += len(xyz)
            self._stamp(np.array(stamps, np.int64), np.array(xyz), arrival_ns)
            self._last_point, self._next_example = now, 0
            self._warning = self._repeating()
        elif (
            wrong and now - self._last_point >= WRONG_FOR and self.unreadable >= self._next_example
        ):
            self._next_example = 2 * self.unreadable
            self.hinder(Flow.SILENT, f'{self.source}: {wrong}; check the description')

    def _repeating(self) -> str:
        """State that times repeat, or go back and forth; empty if they do not."""
        points, repeated = self.points - self._begun[0], self.stamper.dropped - self._begun[1]
        if points < MANY or max(repeated, self._back) <= FEW * points:
            return ''
        if self._back > FEW * points:
            return (
                f'{self.source}: times go back again and again; do two sources send here, or is '
                f'stamp in the description another column?'
            )
        return (
            f'{self.source}: points are left out, since their time is not later than that of the '
            f'point before; check stamp and time in the description'
        )

    def _stamp(self, stamps: np.ndarray, xyz: np.ndarray, arrival_ns: int) -> None:
        if self._how.stamp is None:
            first = max(arrival_ns, self._last_ns + 1)
            self.hand_on([Samples(first + np.arange(len(xyz), dtype=np.int64), xyz)])
            return
        steps = np.diff(stamps, prepend=self._stamp_before)
        self._back += int(np.count_nonzero(steps < -REPEATED))
        self._stamp_before = int(stamps[-1])
        self.measured(stamps, xyz, arrival_ns)
