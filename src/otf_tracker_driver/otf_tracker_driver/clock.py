# SPDX-License-Identifier: Apache-2.0
"""From the clock of a tracker to that of the host: stamps that increase and are never arrivals.

A packet that says device time d arrives at host time a = d + offset + rate d + delay, delay >= 0.
So a - d lies on or above the line offset + rate d (Moon, Skelly, Towsley: Estimation and removal
of clock skew from network delay measurements, INFOCOM 1999). For delays with an exponential
distribution of unknown mean the likeliest rate minimises n log(mean delay above the highest line
beneath all points). The density of real delays rises from zero, so that the least of n is known
to one part in root n, not in n: root n log(mean) is minimised instead. Packets that are very late
do not move the mean, and what is known of the rate is added as a normal distribution: of quartz
clocks at first, of this clock later. That keeps the line quiet in the first seconds.

Where the host has started the clock itself, its zero lies between the command and its answer. That
bounds the line from both sides, as a packet that happens to be quick does from above. A tracker
takes as long to start each time, so what bounds one start bounds all later ones.

Arrivals are the kernel's stamps of reception, not the moments at which somebody read: a process
that waits for the processor reads late. Linux notes with every segment and datagram when the
network handed it over (socket(7), SO_TIMESTAMPNS).
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import struct
import sys
import time
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.model.observation import Samples

SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40
"""asm-generic/socket.h; the module socket does not name them."""
COUNT = struct.Struct('=I')
MUCH = 1 << 22
"""Bytes of datagrams that the kernel is asked to keep; it may keep less."""
STAMP = struct.Struct('@ll')
"""struct timespec: s, ns."""
NOTES = socket.CMSG_SPACE(STAMP.size) + socket.CMSG_SPACE(COUNT.size)
"""Bytes of what the kernel tells with what it hands over."""
SLACK = 10**6
"""ns; between reading two clocks."""


class Arrivals:
    """A socket that tells how long ago what is read from it had arrived.

    Nothing can have arrived before the socket was last found empty: an age beyond is that of a
    time of day that was set meanwhile. So an age holds however long this process stood still.

    Attributes
    ----------
    dropped : int
        Datagrams that the kernel had no room for, as far as later ones have told.
    """

    def __init__(self, opened: socket.socket) -> None:
        self._socket = opened
        self._empty_ns, self.dropped = time.monotonic_ns(), 0
        if opened.type == socket.SOCK_DGRAM:
            with contextlib.suppress(OSError):
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, MUCH)
                opened.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        if sys.platform == 'linux':
            with contextlib.suppress(OSError):
                opened.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    @property
    def unread(self) -> bool:
        """True if something, if only the end, is there to be read."""
        return bool(select.select([self._socket], [], [], 0)[0])

    def receive(self, size: int) -> tuple[bytes, int, object]:
        """Return what has come, how long ago, ns, and from whom.

        Of bytes that came one after another and are read together it is the age of the last. It is
        0 where the kernel does not tell.
        """
        looked_ns = time.monotonic_ns()
        try:
            data, notes, _, peer = self._socket.recvmsg(size, NOTES)
        except (BlockingIOError, TimeoutError):
            self._empty_ns = looked_ns
            raise
        age = 0
        for level, kind, note in notes:
            if (level, kind) == (socket.SOL_SOCKET, SO_RXQ_OVFL) and len(note) == COUNT.size:
                (self.dropped,) = COUNT.unpack(note)
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS) and len(note) == STAMP.size:
                seconds, ns = STAMP.unpack(note)
                age = time.time_ns() - (seconds * 10**9 + ns)
                oldest = time.monotonic_ns() - self._empty_ns + SLACK
                age = age if 0 < age <= oldest else 0
        return data, age, peer


USUAL_RATE = 20e-6
"""Standard deviation of the rate of quartz clocks; recorded trackers have 15 to 20 ppm."""
RATES = np.arange(-100e-6, 100.1e-6, 1e-6)
"""Rates that are tried."""

USUAL_DELAY = 1e6
"""ns; median delay of packets, as far as none have told."""
ASSUMED = 4
"""Packets that this counts as much as."""
VERY_LATE = 5.0
"""Medians; packets later than that count as if late by as much."""
SHARPEST = 1e4
"""ns; delays are not resolved better."""
LOWERED = 1.1
"""Mean of the least of n delays is this many medians, divided by the root of n: 1.25 for delays
whose density rises from zero, such as sums of the age of a packet's last sample and of its way,
less for those whose density does not."""

MILLISECOND = 1e6
"""ns"""
TELLING = 6e6
"""ns; bounds of the start that are further apart say nothing."""
WANDERS = 2e-6
"""A quartz that has been seen keeps its rate within this."""
UNSURE = 3.0
"""How much further off the least late packets may be than by what is usual, against the start."""
MANY, DOUBTED = 10, 5e6
"""Packets that are all late, after the answer to a start, by more than they may be, show that the
tracker has started after it; fewer that are late by so many ns let one doubt."""
MOST_LOWERED = 3e6
"""ns; for few packets, some of them very late."""


@dataclass(frozen=True)
class ClockPrior:
    """What is known of a clock before its packets.

    Attributes
    ----------
    rate : float
        Host seconds per device second, less one.
    u_rate : float
        Its standard uncertainty.
    delay : float, ns
        Median delay of packets.
    floor : int or None, ns
        Host time before which the clock did not show zero; None if nobody knows.
    ceiling : int or None, ns
        Host time after which it did not, as far as the packets do not contradict.
    """

    rate: float = 0.0
    u_rate: float = USUAL_RATE
    delay: float = USUAL_DELAY
    floor: int | None = None
    ceiling: int | None = None


NOTHING = ClockPrior()


@dataclass(frozen=True)
class Line:
    """Host minus device time as a line over device time; nanoseconds stay integers.

    Attributes
    ----------
    origin : int, ns
        Device time at which the difference is ``base``.
    base : int, ns
    rate : float
        Host seconds per device second, less one.
    u_rate : float
        Standard uncertainty of the rate.
    u_base : float, ns
        Standard uncertainty of ``base``.
    bound : float, ns
        ``base`` cannot be off by more; infinite if nothing bounds it from both sides.
    started : float, ns
        So long after the command to start the clock showed zero at the latest; infinite if
        unknown.
    """

    origin: int
    base: int
    rate: float
    u_rate: float = 0.0
    u_base: float = 0.0
    bound: float = math.inf
    started: float = math.inf

    def at(self, device_ns: NDArray[np.int64] | int) -> NDArray[np.int64]:
        """Host minus device time at these device times, ns."""
        drift = self.rate * (np.asarray(device_ns) - self.origin)
        return np.asarray(self.base + np.rint(drift).astype(np.int64))


def lower_line(
    device_ns: NDArray[np.int64], delay_ns: NDArray[np.int64], known: ClockPrior = NOTHING
) -> Line:
    """Return the likeliest line beneath all points.

    Parameters
    ----------
    device_ns : ndarray of int64, shape (n,), ns
        Increasing.
    delay_ns : ndarray of int64, shape (n,), ns
        Arrival minus device time.

    Returns
    -------
    Line
        Lowered by what the least of n delays exceeds zero on average.
    """
    origin, base, n = int(device_ns[-1]), int(delay_ns[-1]), len(device_ns)
    x, y = (device_ns - origin).astype(float), (delay_ns - base).astype(float)
    above = y - RATES[:, None] * x
    least = above.min(axis=1)
    above -= least[:, None]
    median = np.median(above, axis=1)
    mean = np.minimum(above, VERY_LATE * median[:, None]).mean(axis=1)
    cost = (
        math.sqrt(n) * np.log(mean + SHARPEST) + 0.5 * ((RATES - known.rate) / known.u_rate) ** 2
    )
    delay = (n * median + ASSUMED * known.delay) / (n + ASSUMED)
    u = np.minimum(LOWERED * delay / math.sqrt(n), MOST_LOWERED)
    offset, drift = least - u, RATES * origin
    zero, late = (float(np.interp(known.rate, RATES, v)) for v in (least - drift, UNSURE * u))
    start = _start(known, base, zero, late if n >= MANY else math.inf)
    if start:
        u_start = math.hypot((start[1] - start[0]) / math.sqrt(12), WANDERS * origin)
        apart = offset - (sum(start) / 2 + drift)
        u = UNSURE * u
        both = u**2 + u_start**2
        cost += 0.5 * apart**2 / both
        offset, u = offset - apart * u**2 / both, u * u_start / np.sqrt(both)
    likely = np.exp(cost.min() - cost)
    likely /= likely.sum()
    rate, best, u_best = (float(likely @ v) for v in (RATES, offset, u))
    u_rate = math.sqrt(float(likely @ (RATES - rate) ** 2))
    bound = started = math.inf
    if start:
        unsure, drifted, touched = u_rate * origin, rate * origin, float(likely @ least)
        started = touched - drifted + UNSURE * unsure - start[0]
        lowest, highest = start[0] + drifted - unsure, start[1] + drifted + unsure
        best = _between(lowest, min(highest, touched), best)
        bound = max(best - lowest, highest - best)
        bound = touched - lowest if touched - highest > DOUBTED else bound
    return Line(origin, base + round(best), rate, u_rate, u_best, bound, started)


def _start(
    known: ClockPrior, base: int, highest: float, exceeding: float
) -> tuple[float, float] | None:
    """Return between which offsets the clock has started, ns from ``base``; None if unknown.

    ``highest`` is that of the highest line beneath all packets, at zero; a ceiling that it exceeds
    by more than ``exceeding`` does not hold.
    """
    if known.floor is None or known.floor - base >= highest:
        return None
    lowest, ceiling = float(known.floor - base), highest
    if known.ceiling is not None and known.ceiling - base < highest:
        contradicted = highest - exceeding > known.ceiling - base
        ceiling = highest if contradicted else float(known.ceiling - base)
    return (lowest, ceiling) if ceiling - lowest < TELLING else None


def _between(lowest: float, highest: float, offset: float) -> float:
    """Keep an estimate between its bounds, and the nearer to their middle the closer they are.

    Bounds up to 2 ms apart then leave an error of at most 1 ms, also if every packet is late by
    more than the estimate knows.
    """
    if lowest >= highest:
        return highest
    half = (highest - lowest) / 2
    slack = MILLISECOND - half if half < MILLISECOND else 1.5 * (half - MILLISECOND)
    middle = (lowest + highest) / 2
    return min(max(offset, middle - slack, lowest), middle + slack, highest)


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
        self.line: Line | None = None
        self.ended: Line | None = None
        self.epoch = 0
        self._packets = self._jumps = self._late = 0
        self._delay = self._spread = 0.0
        self._points: deque[tuple[int, int]] = deque()
        self._suspects: list[tuple[int, int]] = []
        self._late_ns = 0
        self._began = 0
        self._known = NOTHING
        self._quickest = NEVER

    @property
    def state(self) -> ClockState:
        """What is known now."""
        rate = self.line.rate if self.line else 0.0
        known = self.line is not None
        numbers = self._spread, self._delay, self._jumps, self._late
        return ClockState(known, self._packets, rate, *numbers)

    def restart(self) -> None:
        """Begin a new epoch: the device's clock starts again, at the rate that it has."""
        self.epoch += 1
        if self.line is not None:
            delay = max(self._spread * 1e9, 1.0)
            u_rate = math.hypot(self.line.u_rate, WANDERS)
            self._known = ClockPrior(self.line.rate, u_rate, delay)
        self._known = replace(self._known, floor=None, ceiling=None)
        self.line = None
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

    def take(self, device_ns: int, arrival_ns: int) -> bool:
        """Take the time of a packet's last sample on both clocks; tell whether the line holds."""
        self._packets += 1
        delay = arrival_ns - device_ns
        if self.line is None:
            return self._settle(device_ns, delay, arrival_ns)
        above = delay - int(self.line.at(device_ns))
        self._delay = above * 1e-9
        if above < -EARLY:
            return self._jump([(device_ns, delay)], self.line)
        if above > LATE:
            self._late += 1
            self._suspect(device_ns, delay)
            return self._jump(self._suspects, None) if self._late_for_long() else False
        self._suspects.clear()
        if self._add(device_ns, delay):
            self._fit()
        return True

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
        if self.line is None and self._points:
            self._fit()

    def _settle(self, device_ns: int, delay: int, arrival_ns: int) -> bool:
        least = min((other for _, other in self._points), default=delay)
        if delay < least - LATE:
            if len(self._points) > 1 or delay < least - HELD_UP:
                self._fit()
                return self._jump([(device_ns, delay)], self.line)
            self._points.clear()  # the first packet was late
        if not self._points:
            self._began = arrival_ns
        self._add(device_ns, delay)
        return self._settled(arrival_ns - self._began)

    def _settled(self, lasted: int) -> bool:
        """Draw the first line of an epoch if enough is known."""
        line = lower_line(*self._arrays(), self._known)
        enough = lasted >= SETTLING and len(self._points) > 1
        sure = lasted >= UNSURE_FOR or (math.isinf(line.bound) and line.u_base <= SURE)
        if line.bound > CERTAIN and not (enough and sure):
            return False
        self._fit()
        return True

    def _jump(self, points: list[tuple[int, int]], ended: Line | None) -> bool:
        """Begin a new epoch with these points; those that wait may belong to the one before."""
        self._jumps, self.ended, points = self._jumps + 1, ended, list(points)
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
        self._spread = float(np.median(delay - line.at(device))) * 1e-9
        self.line = line
        self._quickest = int(min(self._quickest, line.started))

    def _arrays(self) -> NDArray[np.int64]:
        """Device times and delays of the points, shape (2, n), ns."""
        return np.array(self._points, dtype=np.int64).T


SLEW = 1e-3
"""An improved line is approached by at most this share of the time that passes."""
REPEATED = 10**9
"""ns; a packet that goes back by less is an old one; by more: the device's clock has restarted."""
STEP = 1000
"""ns; least time between stamps."""


class HostClock:
    """Time of the host that never jumps: steady, and equal to the time of day at the start."""

    def __init__(self) -> None:
        self._ahead = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Time now, ns since 1970."""
        return time.monotonic_ns() + self._ahead


@dataclass(frozen=True)
class Packet:
    """Samples that wait for their stamps; some of them serve the clock only."""

    device_ns: NDArray[np.int64]
    xyz: NDArray[np.float64]
    kept: NDArray[np.bool_]

    def part(self, chosen: slice | NDArray[np.bool_]) -> Packet:
        """Some of the samples."""
        return Packet(self.device_ns[chosen], self.xyz[chosen], self.kept[chosen])


class Stamper:
    """Holds packets back until their time is known, then stamps them.

    Attributes
    ----------
    dropped : int
        Samples of device times that had been there before, or cannot be stamped.
    squeezed : int
        Samples whose stamps were moved behind those given out before a jump of the clock.
    """

    def __init__(self) -> None:
        self._clock = DeviceClock()
        self._waiting: list[Packet] = []
        self._device: int | None = None
        self._given: tuple[int, int] | None = None
        self._last_ns = -(2**63) + 1
        self._epoch = self._clock.epoch
        self.dropped = self.squeezed = 0

    @property
    def clock(self) -> ClockState:
        """What is known of the device's clock."""
        return self._clock.state

    @property
    def waiting(self) -> bool:
        """True if samples wait for their stamps."""
        return any(packet.kept.any() for packet in self._waiting)

    def restart(self) -> list[Samples]:
        """Return what still waits; the device's clock starts again."""
        rest = self.flush()
        self.dropped += sum(int(np.count_nonzero(packet.kept)) for packet in self._waiting)
        self._waiting.clear()
        self._clock.restart()
        self._epoch, self._given, self._device = self._clock.epoch, None, None
        return rest

    def started(
        self, ordered_ns: int, answered_ns: int | None = None, sent_ns: int | None = None
    ) -> None:
        """Take when the device's clock was ordered to start from zero, and when it answered."""
        self._clock.started(ordered_ns, answered_ns, sent_ns)

    def flush(self) -> list[Samples]:
        """Return what still waits, stamped as well as can be."""
        self._clock.give_up_waiting()
        return self._release(self._clock.line)

    def take(
        self,
        device_ns: NDArray[np.int64],
        xyz: NDArray[np.float64],
        arrival_ns: int,
        valid: NDArray[np.bool_] | None = None,
    ) -> list[Samples]:
        """Take the samples of one packet.

        Parameters
        ----------
        device_ns : ndarray of int64, shape (n,), ns
            On the device's clock.
        xyz : ndarray, shape (n, 3), m
        arrival_ns : int
            On the host's clock.
        valid : ndarray of bool, shape (n,), optional
            Which samples are wanted; the others tell the clock only. All if not given.

        Returns
        -------
        list of Samples
            All that can be stamped now, in order.
        """
        if not len(device_ns):
            return []
        packet = Packet(device_ns, xyz, np.ones(len(xyz), bool) if valid is None else valid)
        return self._taken(packet, arrival_ns)

    def _taken(self, packet: Packet, arrival_ns: int) -> list[Samples]:
        rest: list[Samples] = []
        back = np.flatnonzero(np.diff(packet.device_ns) < -REPEATED)
        if back.size:  # the clock has started again within the packet
            cut = int(back[0]) + 1
            self._waiting.append(self._increasing(packet.part(slice(cut))))
            return self.restart() + self._taken(packet.part(slice(cut, None)), arrival_ns)
        if self._device is not None and int(packet.device_ns[-1]) < self._device - REPEATED:
            rest = self.restart()
        last_ns = int(packet.device_ns[-1])
        packet = self._increasing(packet)
        if not len(packet.device_ns):
            return rest
        self._device = int(packet.device_ns[-1])
        known = self._clock.take(last_ns, arrival_ns)
        if self._epoch != self._clock.epoch:
            rest += self._release(self._clock.ended)
            self._epoch, self._given = self._clock.epoch, None
        self._waiting.append(packet)
        return rest + self._release(self._clock.line) if known else rest

    def _increasing(self, packet: Packet) -> Packet:
        """Leave out samples that are not later than all before them."""
        start = -(2**63) if self._device is None else self._device
        highest = np.maximum.accumulate(np.concatenate([[start], packet.device_ns]))
        new = packet.device_ns > highest[:-1]
        self.dropped += int(np.count_nonzero(packet.kept & ~new))
        return packet.part(new)

    def _release(self, line: Line | None) -> list[Samples]:
        if line is None:
            return []
        waiting, self._waiting = self._waiting, []
        stamped = [self._stamped(packet, line) for packet in waiting if len(packet.device_ns)]
        return [part for part in stamped if len(part)]

    def _stamped(self, packet: Packet, line: Line) -> Samples:
        device = packet.device_ns
        stamp = device + line.at(device)
        if self._given is not None:
            at, given = self._given
            off = given - at - int(line.at(at))
            excess = np.maximum(abs(off) - SLEW * (device - at), 0.0)
            stamp = stamp + np.rint(np.sign(off) * excess).astype(np.int64)
        least = self._last_ns + STEP * np.arange(1, len(device) + 1)
        self.squeezed += int(np.count_nonzero(stamp < least))
        stamp = np.maximum(stamp, least)
        self._last_ns = int(stamp[-1])
        self._given = int(device[-1]), self._last_ns
        return Samples(stamp[packet.kept], packet.xyz[packet.kept])
