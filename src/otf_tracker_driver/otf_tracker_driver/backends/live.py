# SPDX-License-Identifier: Apache-2.0
"""Base of backends whose device is read in a thread: it yields device time, arrival and point.

One stamper maps device times to the host's; what waits for it, why nothing flows, and where the
stream broke off is kept here for all protocols.
"""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from otf_core.config import Parameters
from otf_core.errors import OtfError
from otf_core.model.observation import Samples
from otf_tracker_driver.backends.base import (
    Backend,
    Beam,
    CommonConfig,
    Flow,
    Gap,
    Health,
    Hindrance,
    join_samples,
)
from otf_tracker_driver.clock import HostClock, Stamper

BEAT = 0.25
"""s; longest wait between two looks at what is wanted."""
COUNTED = 2 * BEAT
"""s; a beat that took longer, as the process stood still, counts for this."""
FURTHEST = 200.0
"""m; no tracker measures further."""
MOST_HELD = 100_000
"""Parts that wait to be polled; the oldest are left out beyond."""
MOST_GAPS = 1000
ENDED_WITHIN = 6.0
"""s"""
NOT_FETCHED, REPEATED = 'not fetched in time', 'time had been there'
"""Why samples are left out."""


class Silence:
    """How long nothing was heard, in time in which this process ran and could have heard it.

    A process may stand still for seconds: swapped out, in a paused virtual machine, stopped by a
    debugger, starved by others. What came meanwhile lies in the socket. So time is counted in
    beats, each of which counts for little however long it lasted.

    Attributes
    ----------
    lasted : float, s
        Up to the last beat.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.heard()

    def heard(self) -> None:
        """Note that something came just now."""
        self.lasted, self._beat = 0.0, self._clock()

    def beat(self) -> float:
        """Count the time since the beat before, and return how long the silence has lasted, s."""
        now = self._clock()
        self.lasted += min(now - self._beat, COUNTED)
        self._beat = now
        return self.lasted


class LiveBackend(Backend):
    """A device that is read in a thread, which calls ``begin``, ``measured`` and ``break_off``.

    Attributes
    ----------
    source : str
        What is read, in the words of messages.
    wanted : int
        Number of the stream that is wanted; 0: none.
    served : int
        Number of the stream that the device was started for.
    ended : threading.Event
        Set when the thread shall end.
    left_out : Counter
        Samples that were not handed on, by reason.
    restarts : int
        Times that the measurement was started, or the source opened, again without a sample.
    """

    in_packets = True
    source = ''

    def __init__(self, common: CommonConfig, own: Parameters) -> None:
        super().__init__(common, own)
        self.host_clock, self.stamper, self.silence = HostClock(), Stamper(), Silence()
        self.ended = threading.Event()
        self.wanted = self.served = self._streams = 0
        self.connected, self.beam = False, Beam.UNKNOWN
        self.connections = self.interruptions = self.unreadable = self.restarts = 0
        self.left_out: Counter[str] = Counter()
        self.gaps: tuple[Gap, ...] = ()
        self._hindrance: Hindrance | None = None
        self._since = time.monotonic()
        self._queue: deque[Samples] = deque()
        self._lock = threading.Lock()
        self._broke_off, self._last_ns = '', 0
        self._failure: Exception | None = None
        self._thread: threading.Thread | None = None

    @abstractmethod
    def work(self) -> None:
        """Read the device until ``ended`` is set; an OtfError is raised by ``poll``, too."""

    def begin_work(self) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._work, name=self.source, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self.work()
        except Exception as error:  # noqa: BLE001 - raised where it is asked for
            self._failure = error

    def check(self) -> None:
        """Raise what has ended the thread: an OtfError, or RuntimeError for a defect."""
        if isinstance(self._failure, OtfError):
            raise self._failure
        if self._failure:
            raise RuntimeError(f'{self.source} is not read any more') from self._failure

    def start(self) -> None:
        """Have the device measure; what is left of another stream is forgotten."""
        with self._lock:
            self._queue.clear()
            self._streams += 1
            self.wanted, self._broke_off, self._last_ns = self._streams, '', 0
            self._since, self.restarts = time.monotonic(), 0
            self.hinder(Flow.STARTING, f'{self.source}: the measurement is being started')

    def stop(self) -> None:
        """Have the device stop."""
        self.wanted = 0

    def poll(self) -> Samples:
        """Return what has been stamped since the last call."""
        self.check()
        parts = []
        while self._queue:
            parts.append(self._queue.popleft())
        return join_samples(parts)

    @property
    def finished(self) -> bool:
        """Never true: a device measures until it is stopped."""
        return False

    def disconnect(self) -> None:
        """Stop, and end the thread."""
        self.stop()
        self.ended.set()
        if self._thread:
            self._thread.join(ENDED_WITHIN)

    @property
    def hindrance(self) -> Hindrance | None:
        """What keeps samples from flowing just now."""
        return self._hindrance

    @property
    def health(self) -> Health:
        """How the source is."""
        left_out = {reason: n for reason, n in dict(self.left_out).items() if n}
        if self.stamper.dropped:
            left_out[REPEATED] = self.stamper.dropped
        return Health(
            connected=self.connected,
            device=self.source,
            hardware=self.source,
            beam=self.beam,
            clock=self.stamper.clock,
            connections=self.connections,
            interruptions=self.interruptions,
            left_out=left_out,
            unreadable=self.unreadable,
            gaps=self.gaps,
        )

    # What follows is called by the thread.

    @property
    def wanted_still(self) -> bool:
        """True if the stream that is served is wanted, and not another one."""
        return self.served == self.wanted != 0

    def hinder(self, kind: Flow, text: str) -> None:
        """Note what keeps samples from flowing."""
        self._hindrance = Hindrance(kind, text, self._since, self.restarts)

    def begin(self) -> None:
        """Begin to measure for the stream that is wanted: the device's clock starts again."""
        self.stamper.restart()
        self.served = self.wanted
        self.silence.heard()

    def measured(
        self,
        device_ns: NDArray[np.int64],
        xyz: NDArray[np.float64],
        arrival_ns: int,
        valid: NDArray[np.bool_] | None = None,
    ) -> None:
        """Stamp a packet and hand on what can be; see Stamper.take."""
        self.hand_on(self.stamper.take(device_ns, xyz, arrival_ns, valid))
        if self.stamper.waiting and not self.stamper.clock.settled:
            text = f'{self.source}: samples wait until its clock is known'
            self.hinder(Flow.WAITING_FOR_CLOCK, text)

    def break_off(self, reason: str) -> None:
        """Hand on what waits for its stamps; if there is a reason, a gap follows."""
        self.hand_on(self.stamper.flush())
        if self.wanted_still and self._last_ns:
            self._broke_off = self._broke_off or reason

    def hand_on(self, parts: list[Samples]) -> None:
        """Let stamped samples be polled, if their stream is wanted still."""
        with self._lock:
            for part in parts if self.wanted_still else ():
                if self._broke_off:
                    gap = Gap(self._last_ns, int(part.stamp_ns[0]), self._broke_off)
                    self.gaps, self._broke_off = (*self.gaps[-MOST_GAPS:], gap), ''
                    self.interruptions += 1
                self._last_ns = int(part.stamp_ns[-1])
                self._hindrance, self._since, self.restarts = None, time.monotonic(), 0
                if len(self._queue) == MOST_HELD:
                    self.left_out[NOT_FETCHED] += len(self._queue.popleft())
                self._queue.append(part)
