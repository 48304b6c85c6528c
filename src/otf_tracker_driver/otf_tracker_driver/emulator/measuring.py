# SPDX-License-Identifier: Apache-2.0
"""A continuous measurement of the emulated tracker: packets at its pace, and what goes wrong.

Recorded trackers end a packet every 0.3332065 s of their own clock, whatever the rate of samples,
with all samples measured until then; the packet arrives some milliseconds later.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from otf_tracker_driver.emscon.codes import Command, Event, PacketType, SampleStatus, Status
from otf_tracker_driver.emscon.framing import HEADER
from otf_tracker_driver.emscon.packets import (
    Measurements,
    encode_error,
    encode_event,
    encode_measurements,
)
from otf_tracker_driver.emulator.cell import TICK, Cell
from otf_tracker_driver.emulator.device import Device
from otf_tracker_driver.emulator.faults import Faults

PERIOD = 0.3332065
"""s on the tracker's clock, as recorded."""
LATEST = 0.06
"""s, as recorded."""
JUMP = 2.0
"""s"""
COARSE = 0.002
"""s; what the timers of an event loop are coarse by, amply."""
Record = Callable[[NDArray[np.float64], NDArray[np.float64]], None]


class Drive:
    """When the machine started to drive; it goes on whether it is measured or not."""

    def __init__(self) -> None:
        self.started: float | None = None

    def elapsed(self, now: float) -> float:
        """Seconds since it started, 0 before."""
        return 0.0 if self.started is None else now - self.started

    def since(self, now: float) -> float:
        """Seconds since it started; it starts with the first question."""
        if self.started is None:
            self.started = now
        return now - self.started


class Measuring:
    """Sends packets until stopped, or until the beam is lost.

    Parameters
    ----------
    drift : float
        Rate of the tracker's clock, less one.
    put : callable
        Sends a packet.
    record : callable, optional
        Takes true times (n,), s on the host's monotonic clock, and the points sent (n, 3), m.
    """

    def __init__(
        self,
        device: Device,
        cell: Cell,
        drive: Drive,
        drift: float,
        faults: Faults,
        rng: random.Random,
        put: Callable[[bytes], None],
        record: Record | None = None,
    ) -> None:
        self._device, self._cell, self._drift = device, cell, drift
        self._faults, self._rng, self._put, self._record = faults, rng, put, record
        self._begun = time.monotonic()
        self._first_tick = round(drive.since(self._begun) * (1 + drift) / TICK)
        self._jumped = 0.0

    async def run(self) -> bool:
        """Send packets; returns True when the beam is lost, False when the stream falls silent."""
        step = self._device.interval_ms
        sent, end = 0, 0.0
        while True:
            end += PERIOD
            upto = int(end / TICK) // step + 1
            lost = self._happens('beam_loss')
            if lost:  # recorded trackers send at once what they have
                upto = self._rng.randint(sent, upto)
                end = upto * step * TICK
            dark = np.flatnonzero(~self._cell.lit(self._first_tick + step * np.arange(sent, upto)))
            if dark.size:  # the reflector is taken out of the beam
                lost, upto = True, sent + int(dark[0])
                end = upto * step * TICK
            packet = self._packet(step * np.arange(sent, upto))
            due = self._begun + end / (1 + self._drift)
            await _until(due + self._delay())
            if self._happens('silent'):
                return False
            if packet:
                self._put(packet)
            if lost:
                self._device.seen = False
                self._put(encode_error(Command.UNSOLICITED, Status.BEAM_LOST))
                return True
            self._strange()
            sent = upto

    def _packet(self, tick: NDArray[np.int64]) -> bytes:
        """Packet of the samples at these ticks since the start of the measurement, if any."""
        if not len(tick):
            return b''
        xyz = self._cell.at(self._first_tick + tick)
        if self._record:
            self._record(np.asarray(self._begun + tick * TICK / (1 + self._drift)), xyz)
        if self._happens('clock_jump'):
            self._jumped += JUMP
        device_ns = (tick * round(TICK * 1e9)) + round(self._jumped * 1e9)
        status = np.zeros(len(tick), np.int32)
        for fault, code in (
            ('speed_warning', SampleStatus.SPEED_WARNING),
            ('speed_exceeded', SampleStatus.SPEED_EXCEEDED),
            ('unknown', 77),
        ):
            if self._happens(fault):
                status[self._rng.randrange(len(tick)) :][:10] = code
        environment = self._device.kept[Command.GET_ENVIRONMENT]
        packet = Measurements(0, environment, status, device_ns, self._device.shown(xyz))  # type: ignore[arg-type]
        extended = self._device.kept[Command.GET_STATISTIC_MODE][1]
        return encode_measurements(packet, PacketType.MULTI_2 if extended else PacketType.MULTI)

    def _strange(self) -> None:
        """Send what the client cannot know, or what another program does."""
        if self._happens('unknown'):
            self._put(encode_event(4242))
            self._put(HEADER.pack(HEADER.size + 4, 99) + b'\xff\xff\xff\xff')
        if self._happens('foreign'):
            units = self._device.kept[Command.GET_UNITS]
            self._device.kept[Command.GET_UNITS] = (1, *units[1:])
            self._put(encode_event(Event.UNITS))

    def _delay(self) -> float:
        late = self._rng.uniform(0, LATEST) if self._happens('late') else 0.0
        mean = self._faults.jitter
        return late + (self._rng.expovariate(1 / mean) if mean else 0.0)

    def _happens(self, fault: str) -> bool:
        return self._rng.random() < float(getattr(self._faults, fault))


async def _until(due: float) -> None:
    """Sleep until a time on the monotonic clock, s; event loops wake a millisecond late."""
    await asyncio.sleep(max(0.0, due - time.monotonic() - COARSE))
    while time.monotonic() < due:
        await asyncio.sleep(0)
