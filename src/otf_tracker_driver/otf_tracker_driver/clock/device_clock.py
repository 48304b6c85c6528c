# SPDX-License-Identifier: Apache-2.0
"""The clock of a device against that of the host, followed packet by packet.

An epoch is a time in which the device's clock runs on without a jump. A new one begins where it
goes back, where packets come earlier than is possible, and where all packets are late.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from otf_tracker_driver.clock.envelope import NOTHING, WANDERS, ClockPrior, Line, lower_line

WINDOW = 120 * 10**9
"""ns; older packets are forgotten, so that a rate that changes with temperature is followed."""
BUCKET = 25 * 10**7
"""ns; of packets within it only the least late one is kept."""
SETTLING, UNSURE_FOR = 2 * 10**9, 3 * 10**9
"""ns; so long packets are collected at least, and at most, before the first line is believed."""
SURE = 6e5
"""ns; standard uncertainty of a line that is believed after the least time."""
CERTAIN = 1e6
"""ns; a line that cannot be off by more is believed at once."""
EARLY = 5 * 10**6
"""ns; a packet that much beneath the line is impossible without a jump."""
LATE = 80 * 10**6
"""ns; recorded packets are late by 60 ms at most."""
HELD_UP = 10**9
"""ns; a first packet that is followed by one earlier by less was held up; more is a jump."""
NEVER = 2**62
"""ns"""
LATE_FOR = 5 * 10**9
"""ns; if all packets are late for so long, the clock has jumped back. A backlog that is read at
once, after this process stood still, is late, too, but does not come for so long; a pause in which
nothing comes counts for ``HELD_UP``."""
RAISED = 3 * 10**6
"""ns; and if the least late ones of ``RAISED_FOR`` are late by more, beyond the usual delay."""
RAISED_FOR = 40
"""buckets"""


class Verdict(Enum):
    """What a packet means for those that wait for their stamps."""

    WAIT = 'the line is not known yet, or in doubt'
    STAMP = 'the line holds'
    STEPPED = 'the line holds, on a clock that has jumped within the packet'


@dataclass(frozen=True)
class ClockState:
    """What is known of the device's clock.

    Attributes
    ----------
    settled : bool
        The line is known.
    packets : int
        Since the start.
    rate : float
        Host seconds per device second, less one; 0 until known.
    spread : float, s
        Median delay of the least late packets above the line.
    delay : float, s
        Arrival of the last packet after its last sample.
    jumps : int
        Jumps of the device's clock that were found.
    late : int
        Packets more than 80 ms late.
    """

    settled: bool = False
    packets: int = 0
    rate: float = 0.0
    spread: float = 0.0
    delay: float = 0.0
    jumps: int = 0
    late: int = 0


class DeviceClock:
    """Fits the line of the present epoch.

    Attributes
    ----------
    line : Line or None
        None until the clock has settled.
    epoch : int
        Changes with every jump and restart.
    ended : Line or None
        Of the epoch that a jump has ended, for samples that were measured before it.
    """

    def __init__(self) -> None:
        self._line: Line | None = None
        self.ended: Line | None = None
        self.epoch = 0
        self._packets = self._jumps = self._late = 0
        self._delay = self._spread = 0.0
        self._ahead = 0
        self._points: deque[tuple[int, int]] = deque()
        self._suspects: list[tuple[int, int]] = []
        self._late_ns = 0
        self._began = 0
        self._known = NOTHING
        self._quickest = NEVER

    @property
    def line(self) -> Line | None:
        """Host minus device time."""
        return self._line and self._line.ahead(self._ahead)

    @property
    def state(self) -> ClockState:
        """What is known now."""
        rate = self._line.rate if self._line else 0.0
        known = self._line is not None
        numbers = self._spread, self._delay, self._jumps, self._late
        return ClockState(known, self._packets, rate, *numbers)

    def restart(self) -> None:
        """Begin a new epoch: the device's clock starts again, at the rate that it has."""
        self.epoch += 1
        if self._line is not None:
            delay = max(self._spread * 1e9, 1.0)
            u_rate = math.hypot(self._line.u_rate, WANDERS)
            self._known = ClockPrior(self._line.rate, u_rate, delay)
        self._known = replace(self._known, floor=None, ceiling=None)
        self._line, self._ahead = None, 0
        self._points.clear()
        self._suspects.clear()

    def started(
        self, ordered_ns: int, answered_ns: int | None = None, sent_ns: int | None = None
    ) -> None:
        """Take when the clock was ordered to start from zero, and when that was answered.

        The quickest start so far counts: a tracker takes as long each time, while answers wait
        behind others. The order has left at ``sent_ns`` at the latest; at once if not given.
        """
        answered = NEVER if answered_ns is None else answered_ns - ordered_ns
        self._quickest = min(self._quickest, answered)
        waited = 0 if sent_ns is None else sent_ns - ordered_ns
        latest = min(answered, waited + self._quickest)
        ceiling = ordered_ns + latest if latest < NEVER else None
        self._known = replace(self._known, floor=ordered_ns, ceiling=ceiling)

    def take(self, device_ns: int, arrival_ns: int, step_ns: int = 0) -> Verdict:
        """Take the time of a packet's last sample on both clocks.

        ``step_ns`` is what the samples of the packet skip beyond their interval. If the packet is
        early by as much, no sample is missing: the clock has jumped by just that.
        """
        self._packets += 1
        device_ns -= self._ahead
        delay = arrival_ns - device_ns
        if self._line is None:
            return self._settle(device_ns, delay, arrival_ns)
        above = delay - int(self._line.at(device_ns))
        stepped = above < -EARLY <= above + step_ns <= LATE
        if stepped:
            self.ended, self.epoch = self.line, self.epoch + 1
            self._jumps, self._ahead = self._jumps + 1, self._ahead + step_ns
            device_ns, delay, above = device_ns - step_ns, delay + step_ns, above + step_ns
        self._delay = above * 1e-9
        if above < -EARLY:
            return self._jump([(device_ns, delay)], self._line)
        if above > LATE:
            self._late += 1
            self._suspect(device_ns, delay)
            return self._jump(self._suspects, None) if self._late_for_long() else Verdict.WAIT
        self._suspects.clear()
        if self._add(device_ns, delay):
            self._fit()
        return Verdict.STEPPED if stepped else Verdict.STAMP

    def _suspect(self, device_ns: int, delay: int) -> None:
        """Keep a late packet, and for how long such have come one after another."""
        if self._suspects:
            arrived = device_ns + delay - sum(self._suspects[-1])
            self._late_ns += min(arrived, HELD_UP)
        else:
            self._late_ns = 0
        self._suspects.append((device_ns, delay))

    def _late_for_long(self) -> bool:
        """Return whether late packets have come for long, on both clocks: a backlog has not."""
        measured = self._suspects[-1][0] - self._suspects[0][0]
        return min(measured, self._late_ns) >= LATE_FOR

    def give_up_waiting(self) -> None:
        """Take the best line there is; nothing more will come in this epoch."""
        self._suspects.clear()
        if self._line is None and self._points:
            self._fit()

    def _settle(self, device_ns: int, delay: int, arrival_ns: int) -> Verdict:
        least = min((other for _, other in self._points), default=delay)
        if delay < least - LATE:
            if len(self._points) > 1 or delay < least - HELD_UP:
                self._fit()
                return self._jump([(device_ns, delay)], self._line)
            self._points.clear()  # the first packet was late
        if not self._points:
            self._began = arrival_ns
        self._add(device_ns, delay)
        return self._settled(arrival_ns - self._began)

    def _settled(self, lasted: int) -> Verdict:
        """Draw the first line of an epoch if enough is known."""
        line = lower_line(*self._arrays(), self._known)
        enough = lasted >= SETTLING and len(self._points) > 1
        sure = lasted >= UNSURE_FOR or (math.isinf(line.bound) and line.u_base <= SURE)
        if line.bound > CERTAIN and not (enough and sure):
            return Verdict.WAIT
        self._fit()
        return Verdict.STAMP

    def _jump(self, points: list[tuple[int, int]], ended: Line | None) -> Verdict:
        """Begin a new epoch with these points; those that wait may belong to the one before."""
        self._jumps += 1
        ahead, self.ended = self._ahead, ended and ended.ahead(self._ahead)
        points = [(device_ns + ahead, delay - ahead) for device_ns, delay in points]
        self.restart()
        self._began = sum(points[0])
        for device_ns, delay in points:
            self._add(device_ns, delay)
        return self._settled(points[-1][0] - points[0][0])

    def _add(self, device_ns: int, delay: int) -> bool:
        """Keep a point if it is the least late of its bucket; tell whether it is the first."""
        points = self._points
        first = not points or device_ns // BUCKET != points[-1][0] // BUCKET
        if not first:
            if delay > points[-1][1]:
                return False
            points.pop()
        points.append((device_ns, delay))
        while device_ns - points[0][0] > WINDOW:
            points.popleft()
        return first

    def _fit(self) -> None:
        device, delay = self._arrays()
        line = lower_line(device, delay, self._known)
        above = delay - line.at(device)
        if len(above) > 2 * RAISED_FOR and self._raised(above):
            self._jumps += 1
            self._points = deque(list(self._points)[-RAISED_FOR:])
            self._fit()
            return
        self._spread = float(np.median(above)) * 1e-9
        self._line = line
        self._quickest = int(min(self._quickest, line.started))

    def _arrays(self) -> NDArray[np.int64]:
        """Device times and delays of the points, shape (2, n), ns."""
        return np.array(self._points, dtype=np.int64).T

    @staticmethod
    def _raised(above: np.ndarray) -> bool:
        """Return whether the newest packets are late without exception."""
        older, newest = above[:-RAISED_FOR], above[-RAISED_FOR:]
        return bool(newest.min() > RAISED + np.median(older))
