# SPDX-License-Identifier: Apache-2.0
"""Stamps for samples in packets: device time mapped to host time, increasing, never arrival."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.model.observation import Samples
from otf_tracker_driver.clock.device_clock import ClockState, DeviceClock, Verdict
from otf_tracker_driver.clock.envelope import Line

SLEW = 1e-3
"""An improved line is approached by at most this share of the time that passes."""
REPEATED = 10**9
"""ns; a packet that goes back by less is an old one; by more: the device's clock has restarted."""
STEP = 1000
"""ns; least time between stamps."""
FEW, REGULAR = 5, 1.5
"""Fewer samples do not tell their interval, nor do those whose intervals vary by that factor."""


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
        cut, step = _largest_step(self._device, packet.device_ns)
        self._device = int(packet.device_ns[-1])
        verdict = self._clock.take(last_ns, arrival_ns, step)
        if self._epoch != self._clock.epoch:
            if verdict is Verdict.STEPPED:
                self._waiting.append(packet.part(slice(cut)))
                packet = packet.part(slice(cut, None))
            rest += self._release(self._clock.ended)
            self._epoch, self._given = self._clock.epoch, None
        self._waiting.append(packet)
        return rest if verdict is Verdict.WAIT else rest + self._release(self._clock.line)

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


def _largest_step(last: int | None, device_ns: NDArray[np.int64]) -> tuple[int, int]:
    """Return before which sample most time has passed, and how much more than usual, ns."""
    steps = np.diff(device_ns, prepend=device_ns[0] if last is None else last)
    if len(steps) < FEW:
        return 0, 0
    at, usual = int(np.argmax(steps)), int(np.median(steps))
    regular = np.delete(steps, at).max() < REGULAR * usual
    return at, int(steps[at]) - usual if regular else 0
