#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A tracker that does not exist: an emScon server whose samples come from the simulated cell.

``./otf emulate-tracker --machine M.yaml``. Recorded trackers end a packet every 0.3332065 s of
their own clock, whatever the rate of samples, with all samples measured until then; the packet
arrives some milliseconds later. Between the parts of a run the reflector is moved by hand: the
beam is broken, and can be found again at the next target before that part is driven.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import random
import signal
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from otf_core.cli.parser import Parser
from otf_core.config import ParameterInfo, Parameters, PlannerConfig, SimulationConfig, parameter
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.model.machine import Machine, load_machine
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import load_tables
from otf_tracker_driver.backends import emscon_link as codes
from otf_tracker_driver.backends.emscon_link import (
    ANSWER,
    ANSWERS,
    EVENT,
    HEADER,
    MULTI_HEAD,
    REQUESTS,
    SAMPLES,
    Command,
    Event,
    Framer,
    Measurements,
    PacketType,
    ProtocolError,
    SampleStatus,
    Status,
    Value,
    read_values,
)

C = Command
SLOWEST, FASTEST = 15e-6, 20e-6
"""Rates that recorded trackers' clocks differ from those of hosts by."""


def encode_answer(command: int, status: int, *values: Value) -> bytes:
    """Return the packet of an answer; with an error status it holds no values."""
    packed = [v.encode('utf-16-le')[:62] if isinstance(v, str) else v for v in values]
    body = struct.pack(f'<{ANSWERS[Command(command)]}', *packed) if values else b''
    return ANSWER.pack(ANSWER.size + len(body), PacketType.COMMAND, command, status) + body


def encode_error(command: int, status: int) -> bytes:
    """Return the packet of an error that nobody asked for."""
    return ANSWER.pack(ANSWER.size, PacketType.ERROR, command, status)


def encode_event(event: int) -> bytes:
    """Return the packet of a system status change."""
    return EVENT.pack(EVENT.size, PacketType.EVENT, event)


def encode_measurements(packet: Measurements, kind: PacketType = PacketType.MULTI) -> bytes:
    """Return the packet of a continuous measurement; a-priori deviations are zero."""
    rows = np.zeros(len(packet.status), SAMPLES[kind])
    rows['status'], rows['value'] = packet.status, packet.value
    rows['s'], ns = np.divmod(packet.device_ns, 10**9)
    rows['us'] = ns // 1000
    size = MULTI_HEAD.size + rows.nbytes
    head = (size, kind, packet.result, len(rows), codes.CONTINUOUS_TIME, 0, *packet.environment)
    return MULTI_HEAD.pack(*head) + rows.tobytes()


@dataclass(frozen=True)
class Faults(Parameters):
    """Chances are per packet of samples, three of which are sent per second."""

    beam_loss: float = parameter(0.0, 'chance that the beam is lost', '', 0, 1)
    beam_out: float = parameter(0.5, 'how long nothing can be found after that', 's', 0, 600)
    split: float = parameter(0.0, 'chance that a packet is sent in pieces', '', 0, 1)
    merge: float = parameter(0.0, 'chance that packets are sent together', '', 0, 1)
    close_after: float = parameter(
        0.0,
        'the server announces that it closes, and closes, this long after each connection; '
        '0: never',
        's', 0, 1e6,
    )  # fmt: skip
    cut_after: float = parameter(0.0, 'the same without notice; 0: never', 's', 0, 1e6)
    busy: float = parameter(0.0, 'chance that a command is answered with busy', '', 0, 0.9)
    speed_warning: float = parameter(0.0, 'chance of samples with a speed warning', '', 0, 1)
    speed_exceeded: float = parameter(0.0, 'chance of samples of a target too fast', '', 0, 1)
    unknown: float = parameter(
        0.0, 'chance of an unknown sample status, event, error and packet type', '', 0, 1
    )
    clock_jump: float = parameter(0.0, 'chance that the clock jumps ahead by 2 s', '', 0, 1)
    silent: float = parameter(0.0, 'chance that no more packets come, without notice', '', 0, 1)
    foreign: float = parameter(0.0, 'chance that another program sets millimetres', '', 0, 1)
    jitter: float = parameter(1e-3, 'mean delay of packets', 's', 0, 0.1)
    late: float = parameter(0.01, 'chance that a packet is late by up to 60 ms', '', 0, 1)
    initialize: float = parameter(0.5, 'how long the tracker takes to initialise', 's', 0, 100)


def read_faults(spec: str) -> Faults:
    """Read a list such as ``beam_loss=0.01,split,close_after=20``; without a value it is 1.

    Raises
    ------
    ConfigError
        If a fault is unknown, or its value out of range.
    """
    known = [info.name for info in Faults.infos()]
    values: dict[str, float] = {}
    for entry in filter(None, (part.strip() for part in spec.split(','))):
        name, given, text = entry.partition('=')
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f'did you mean {near[0]}? ' if near else ''
            raise ConfigError(f'--faults: {name!r} is unknown; {hint}possible: {", ".join(known)}')
        try:
            values[name] = float(text) if given else 1.0
        except ValueError:
            raise ConfigError(f'--faults: {name}: {text!r} is not a number') from None
    try:
        return Faults(**values)
    except ConfigError as error:
        raise ConfigError(f'--faults: {error}') from None


TICK = 1e-3
"""s on the tracker's clock; the shortest time between samples."""
STANDING = 1000
"""Ticks at the end of the run that are repeated for as long as found there."""


BY_HAND, BACK = 4000, 3000
"""Ticks for which the beam is broken between two parts, and for which the reflector then stands at
the next target before that part is driven."""


class Cell:
    """A run of the planned path, sampled a thousand times per second of the tracker's clock.

    Parameters
    ----------
    planning : PlannerConfig
        The path is that of a path planner with the same parameters.
    seed : int
        Of all random numbers.
    drift : float
        Rate of the tracker's clock, less one.
    truth : ErrorTables, optional
        Errors of the machine; drawn from the seed if not given.
    plan : Plan, optional
        Instead of the one that is made for the machine.
    """

    def __init__(
        self,
        machine: Machine,
        planning: PlannerConfig,
        seed: int,
        drift: float,
        truth: ErrorTables | None = None,
        plan: Plan | None = None,
    ) -> None:
        rate = (1 + drift) / TICK
        # scipy takes seconds on a cold computer; mistakes are told before
        from otf_core.planning.forecast import Setup
        from otf_core.planning.part_choice import planned
        from otf_core.sim.cell import simulate

        config = SimulationConfig(seed=seed, rate=rate, clock_drift=0.0)
        if truth is not None:
            truth = truth.on(machine)
        run = simulate(machine, plan or planned(Setup.of(machine), planning), config, truth)
        self.truth = run.truth
        ends = np.flatnonzero(np.diff(run.samples.stamp_ns) > 1e9) + 1
        points, lit = [], []
        for drive, own in zip(run.drives, np.split(run.samples.xyz, ends), strict=True):
            if points:
                still = max(1, round(0.5 * drive.part.dwell[0] / TICK))
                points += [np.zeros((BY_HAND, 3)), np.resize(own[:still], (BACK, 3))]
                lit += [np.zeros(BY_HAND, dtype=bool), np.ones(BACK, dtype=bool)]
            points.append(own)
            lit.append(np.ones(len(own), dtype=bool))
        self._xyz, self._lit = np.concatenate(points), np.concatenate(lit)

    @property
    def ticks(self) -> int:
        """Ticks of the whole run."""
        return len(self._xyz)

    def lit(self, tick: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether there is a reflector in view at these ticks since the machine started, (n,)."""
        return np.asarray(self._lit[np.clip(tick, 0, self.ticks - 1)])

    def at(self, tick: NDArray[np.int64]) -> NDArray[np.float64]:
        """Measured points at these ticks since the machine started, shape (n, 3), m."""
        standing = min(STANDING, self.ticks)
        start = self.ticks - standing
        index = np.where(tick < self.ticks, tick, start + (tick - start) % standing)
        return np.asarray(self._xyz[np.maximum(index, 0)])


LENGTH = (1.0, 1e3, 1e6, 1 / 0.3048, 1 / 0.9144, 1 / 0.0254)
ANGLE = (1.0, 180 / np.pi, 200 / np.pi)
CLOCKWISE, CYLINDRICAL = 6, (4, 5)
"""Coordinate systems."""
REFLECTORS = {3: 'RRR-0.5in', 7: 'CCR-1.5in', 9: 'TBR-0.5in'}
SETTERS: dict[Command, tuple[Command, Event]] = {
    C.SET_UNITS: (C.GET_UNITS, Event.UNITS),
    C.SET_ENVIRONMENT: (C.GET_ENVIRONMENT, Event.ENVIRONMENT),
    C.SET_MEASUREMENT_MODE: (C.GET_MEASUREMENT_MODE, Event.MODE),
    C.SET_COORDINATE_SYSTEM: (C.GET_COORDINATE_SYSTEM, Event.COORDINATE_SYSTEM),
    C.SET_CONTINUOUS_TIME: (C.GET_CONTINUOUS_TIME, Event.CONTINUOUS_PARAMETERS),
    C.SET_REFLECTOR: (C.GET_REFLECTOR, Event.REFLECTOR),
    C.SET_SYSTEM_SETTINGS: (C.GET_SYSTEM_SETTINGS, Event.SETTINGS),
    C.SET_STATISTIC_MODE: (C.GET_STATISTIC_MODE, Event.MODE),
}
LIMITS: dict[Command, tuple[tuple[float, float], ...]] = {
    C.SET_UNITS: ((0, 5), (0, 2), (0, 1), (0, 6), (0, 0)),
    C.SET_ENVIRONMENT: ((-10, 60), (500, 1200), (0, 100)),
    C.SET_MEASUREMENT_MODE: ((0, 1),),
    C.SET_COORDINATE_SYSTEM: ((0, 7),),
    C.SET_CONTINUOUS_TIME: ((1, 100_000), (0, 2**31 - 1), (0, 1), (0, 1)),
}
ALL_READY = 1 | 2 | 4 | 8 | 4096 | 65536


class Device:
    """Settings as a tracker has them that another program used before.

    Attributes
    ----------
    kept : dict
        Values of the settings, by the command that gets them.
    initialised, seen : bool
        Whether the tracker is initialised, and sees a reflector.
    face : int
        1 or 2.
    """

    def __init__(self) -> None:
        self.initialised = self.seen = False
        self.face = 1
        self.kept: dict[Command, tuple[Value, ...]] = {
            C.GET_UNITS: (1, 1, 0, 3, 0),
            C.GET_ENVIRONMENT: (20.0, 1013.25, 50.0),
            C.GET_MEASUREMENT_MODE: (0,),
            C.GET_COORDINATE_SYSTEM: (codes.SPHERICAL_COUNTER_CLOCKWISE,),
            C.GET_CONTINUOUS_TIME: (100, 0, 0, 0),
            C.GET_REFLECTOR: (3,),
            C.GET_SYSTEM_SETTINGS: (1, 1, 1, 1, 0, 1, 0, 0, 0),
            C.GET_STATISTIC_MODE: (0, 0),
        }

    @property
    def interval_ms(self) -> int:
        """From sample to sample."""
        return int(self.kept[C.GET_CONTINUOUS_TIME][0])

    def ready(self) -> int:
        """Result code of an attempt to measure."""
        if not self.initialised:
            return Status.NOT_INITIALISED
        return Status.OK if self.seen else 37

    def answers(self, number: int, body: bytes) -> list[bytes]:
        """Answers to a command that takes no time, and events that come with them."""
        if number == C.CLEAR_COMMAND_QUEUE:
            return [encode_answer(number, Status.OK)]
        if number not in set(Command):
            return [encode_answer(number, Status.NOT_IMPLEMENTED)]
        command = Command(number)
        try:
            values = read_values(REQUESTS.get(command, ''), body, 'command')
        except (ProtocolError, struct.error):
            return [encode_answer(command, Status.WRONG_PARAMETER)]
        if command in SETTERS:
            return self._set(command, values)
        if command in self.kept:
            return [encode_answer(command, Status.OK, *self.kept[command])]
        if command == C.GET_REFLECTORS:
            return [
                encode_answer(command, Status.OK, len(REFLECTORS), number, 1, 0.019, name)
                for number, name in REFLECTORS.items()
            ]
        facts = self._facts()
        if command in facts:
            return [encode_answer(command, Status.OK, *facts[command])]
        return [encode_answer(command, Status.NOT_IMPLEMENTED)]

    def _set(self, command: Command, values: tuple[Value, ...]) -> list[bytes]:
        for place, (value, (low, high)) in enumerate(
            zip(values, LIMITS.get(command, ()), strict=False)
        ):
            if not low <= float(value) <= high:
                return [encode_answer(command, 4 + place)]
        if command == C.SET_COORDINATE_SYSTEM and values[0] in CYLINDRICAL:
            return [encode_answer(command, Status.NOT_IMPLEMENTED)]
        if command == C.SET_REFLECTOR and values[0] not in REFLECTORS:
            return [encode_answer(command, Status.WRONG_REFLECTOR)]
        setting, event = SETTERS[command]
        self.kept[setting] = values
        return [encode_answer(command, Status.OK), encode_event(event)]

    def _facts(self) -> dict[Command, tuple[Value, ...]]:
        processor = codes.PROCESSOR_INITIALISED if self.initialised else 3
        bits = ALL_READY | (codes.REFLECTOR_SEEN if self.seen else 0)
        return {
            C.GET_SYSTEM_STATUS: (0, processor, 3, 0, 3, 6, 0, 1, 0, 7007),
            C.GET_TRACKER_STATUS: (2 if self.initialised else 0,),
            C.GET_MEASUREMENT_STATUS: (0, bits),
            C.GET_FACE: (self.face,),
            C.GET_TRACKER_INFO: (
                5, 'EMULATED', 7007, 1, 1, 0, 0, 0.0, 80.0, 0.1, 1000, 2, 6.28, 1.57, 0, 1, 0,
            ),
            C.GET_SOFTWARE_VERSION: ('emulator 3.6',),
        }  # fmt: skip

    def shown(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (n, 3), m, in the units and the coordinate system that are set."""
        length = LENGTH[int(self.kept[C.GET_UNITS][0])]
        angle = ANGLE[int(self.kept[C.GET_UNITS][1])]
        system = int(self.kept[C.GET_COORDINATE_SYSTEM][0])
        if system <= 3:
            mirrored = np.ones(3)
            if system:
                mirrored[system - 1] = -1.0
            return np.asarray(xyz * mirrored * length)
        x, y, z = xyz.T
        horizontal = (-1.0 if system == CLOCKWISE else 1.0) * np.arctan2(y, x) * angle
        distance = np.linalg.norm(xyz, axis=1)
        zenith = np.arccos(z / distance) * angle
        return np.column_stack([horizontal, zenith, distance * length])


PIECES = 5
MERGED_WITHIN = 0.004
PAUSE = 0.0005
"""s"""
MOST_WAITING = 1000
"""Packets; a client that does not read loses those beyond."""


class Wire:
    """Sends in the order given; ``put`` never waits."""

    def __init__(self, writer: asyncio.StreamWriter, faults: Faults, rng: random.Random) -> None:
        self._writer, self._faults, self._rng = writer, faults, rng
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue(MOST_WAITING)

    def put(self, packet: bytes) -> None:
        """Have a packet sent."""
        if not self._waiting.full():
            self._waiting.put_nowait(packet)

    async def send(self) -> None:
        """Send until cancelled, or until the client is gone."""
        while True:
            data = await self._waiting.get()
            if self._rng.random() < self._faults.merge:
                await asyncio.sleep(self._rng.uniform(0, MERGED_WITHIN))
                while not self._waiting.empty():
                    data += self._waiting.get_nowait()
            for piece in self._pieces(data):
                self._writer.write(piece)
                await self._writer.drain()
                if piece is not data:
                    await asyncio.sleep(PAUSE)

    def _pieces(self, data: bytes) -> list[bytes]:
        if self._rng.random() >= self._faults.split:
            return [data]
        cuts = sorted(self._rng.randrange(len(data)) for _ in range(self._rng.randint(1, PIECES)))
        ends = zip([0, *cuts], [*cuts, len(data)], strict=True)
        return [data[a:b] for a, b in ends if b > a]


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


ACCEPTING = 0.02
"""s; a connection that the system has taken is served within it."""
MOVED = 0.3
"""s; what a movement of the tracker takes."""
NOT_FOUND = 10004
TWO_FACE = (12e-6, -8e-6)
"""rad; differences of horizontal and vertical angle between the two faces, halved."""


class EmulatedTracker:
    """Serves clients until closed.

    Parameters
    ----------
    seed : int
        Of the faults.
    drift : float
        Rate of the tracker's clock, less one.
    record : callable, optional
        See Measuring.
    """

    def __init__(
        self, cell: Cell, faults: Faults, seed: int, drift: float, record: Record | None = None
    ) -> None:
        self._cell, self._faults, self._drift, self._record = cell, faults, drift, record
        self._rng = random.Random(seed)
        self.device = Device()
        self._drive = Drive()
        self._served: Wire | None = None
        self._measuring: asyncio.Task[bool] | None = None
        self._moving: asyncio.Task[None] | None = None
        self._blocked_until = 0.0
        self._clients: set[asyncio.Task[None]] = set()
        self._closed = False

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client in a task; once closed, leave it at once."""
        if self._closed:
            writer.close()
            return
        task = asyncio.ensure_future(self._client(reader, writer))
        self._clients.add(task)
        task.add_done_callback(self._clients.discard)
        task.add_done_callback(lambda _: writer.close())  # one that has not begun when cancelled

    async def close(self, server: asyncio.Server) -> None:
        """Close the server that hands on clients; leave all clients, and those just accepted.

        It takes none for a moment before it is closed: closed between a connection and its
        transport, asyncio would leave the socket open (CPython issue 109564).
        """
        self._closed = True
        for listening in server.sockets:
            asyncio.get_running_loop().remove_reader(listening.fileno())
        await asyncio.sleep(ACCEPTING)
        server.close()
        clients = list(self._clients)
        for task in clients:
            task.cancel()
        if self._moving is not None:
            self._moving.cancel()
            clients.append(self._moving)
        await asyncio.gather(*clients, return_exceptions=True)

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it leaves, or is left."""
        wire = Wire(writer, self._faults, self._rng)
        sending = asyncio.ensure_future(wire.send())
        mine = self._served is None
        if mine:
            self._served = wire
        tasks = [sending, asyncio.ensure_future(self._listen(reader, wire, mine))]
        tasks += [asyncio.ensure_future(self._leave(wire))] if mine else []
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if mine:
                self._stop()
                self._served = None
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def _leave(self, wire: Wire) -> None:
        """End the connection when the faults say so."""
        faults = self._faults
        ends = [after for after in (faults.close_after, faults.cut_after) if after]
        if not ends:
            await asyncio.get_running_loop().create_future()
        await asyncio.sleep(min(ends))
        if faults.close_after == min(ends):
            wire.put(encode_event(Event.SERVER_CLOSING))
            await asyncio.sleep(0.05)

    async def _listen(self, reader: asyncio.StreamReader, wire: Wire, mine: bool) -> None:
        framer = Framer()
        with contextlib.suppress(ProtocolError, OSError):
            while chunk := await reader.read(4096):
                for packet in framer.feed(chunk):
                    (number,) = map(int, read_values('i', packet[8:], 'command'))
                    body = packet[12:]
                    if mine:
                        self._obey(number, body, wire)
                    else:
                        wire.put(encode_answer(number, Status.MULTIPLE_CONNECTIONS))

    def _obey(self, number: int, body: bytes, wire: Wire) -> None:
        """Carry out a command, at once or in a task; while one moves, others are refused."""
        moving = self._moving is not None and not self._moving.done()
        if moving or self._rng.random() < self._faults.busy:
            wire.put(encode_answer(number, Status.BUSY))
        elif number == C.START_MEASUREMENT:
            self._start(wire)
        elif number == C.STOP_MEASUREMENT:
            if self._measuring is not None:  # else the beam was lost, and the machine drives on
                self._drive = Drive()
            self._stop()
            wire.put(encode_answer(number, Status.OK))
            wire.put(encode_event(Event.COORDINATE_SYSTEM))
        elif number in (C.INITIALIZE, C.GO_BIRD_BATH, C.FIND_REFLECTOR, C.CHANGE_FACE):
            self._stop()
            self._moving = asyncio.ensure_future(self._move(Command(number), wire))
        elif number == C.GET_DIRECTION and self.device.seen:
            wire.put(encode_answer(C.GET_DIRECTION, Status.OK, *self._direction()))
        else:
            for packet in self.device.answers(number, body):
                wire.put(packet)

    async def _move(self, command: Command, wire: Wire) -> None:
        """Take the time that a command takes, then answer."""
        device, status = self.device, int(Status.OK)
        if command == C.INITIALIZE:
            wire.put(encode_event(Event.STATUS_BUSY))
            await asyncio.sleep(self._faults.initialize)
            device.initialised = True
            wire.put(encode_event(Event.STATUS_READY))
        elif not device.initialised:
            status = Status.NOT_INITIALISED
        else:
            await asyncio.sleep(MOVED)
            if command == C.CHANGE_FACE:
                device.face = 3 - device.face
            elif time.monotonic() < self._blocked_until or not self._in_view():
                status = NOT_FOUND
            else:
                device.seen = True
        wire.put(encode_answer(command, status))

    def _in_view(self) -> bool:
        """Tell whether there is a reflector to be found just now."""
        elapsed = self._drive.elapsed(time.monotonic())
        return bool(self._cell.lit(np.array([round(elapsed * (1 + self._drift) / TICK)]))[0])

    def _start(self, wire: Wire) -> None:
        status = self.device.ready()
        if self._measuring is not None:
            status = 35
        if status != Status.OK:
            wire.put(encode_answer(C.START_MEASUREMENT, status))
            return
        wire.put(encode_event(Event.COORDINATE_SYSTEM))
        wire.put(encode_answer(C.START_MEASUREMENT, Status.OK))
        measuring = Measuring(
            self.device, self._cell, self._drive, self._drift, self._faults, self._rng, wire.put,
            self._record,
        )  # fmt: skip
        self._measuring = asyncio.ensure_future(measuring.run())
        self._measuring.add_done_callback(self._ended)

    def _ended(self, measuring: asyncio.Task[bool]) -> None:
        if self._measuring is measuring:
            self._measuring = None
        if not measuring.cancelled() and measuring.result():
            self._blocked_until = time.monotonic() + self._faults.beam_out

    def _stop(self) -> None:
        if self._measuring is not None:
            self._measuring.cancel()
            self._measuring = None

    def _direction(self) -> tuple[float, float]:
        """Horizontal and vertical angle of the target, rad, with the errors of the face."""
        x, y, z = self._cell.at(np.zeros(1, np.int64))[0]
        sign = 1 if self.device.face == 1 else -1
        horizontal, vertical = np.arctan2(y, x), np.arccos(z / np.linalg.norm((x, y, z)))
        return float(horizontal + sign * TWO_FACE[0]), float(vertical + sign * TWO_FACE[1])


async def serve(given: argparse.Namespace, faults: Faults, planning: PlannerConfig) -> None:
    """Simulate the cell, listen, say where, serve until interrupted."""
    drift = random.Random(given.seed).uniform(SLOWEST, FASTEST)
    truth = load_tables(given.tables).tables if given.tables else None
    cell = Cell(load_machine(given.machine), planning, given.seed, drift, truth)
    tracker = EmulatedTracker(cell, faults, given.seed, drift)
    try:
        server = await asyncio.start_server(tracker.accept, given.host, given.port)
    except (OSError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or error
        where = f'{given.host}:{given.port}'
        raise InputError(f'cannot listen on {where} ({reason}); choose another --port') from None
    try:
        interrupted = asyncio.Event()
        for end in (signal.SIGINT, signal.SIGTERM):  # a background job ignores SIGINT else
            asyncio.get_running_loop().add_signal_handler(end, interrupted.set)
        name, number = server.sockets[0].getsockname()[:2]
        sys.stdout.write(f'listening on {name}:{number}\n')
        sys.stdout.flush()
        await interrupted.wait()
    finally:
        await tracker.close(server)


def _described(info: ParameterInfo) -> str:
    unit = f', {info.unit}' if info.unit else ''
    return f'{info.name} ({info.default:g}{unit}): {info.meaning}'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the emulator; returns the exit code."""
    listed = '; '.join(map(_described, Faults.infos()))
    example = 'Example: ./otf emulate-tracker --machine machine.yaml --faults split,busy=0.1'
    description = str(__doc__).partition('\n')[0]
    parser = Parser('otf emulate-tracker', description=description, epilog=example)
    parser.add_argument('--machine', required=True, help='machine.yaml of the simulated cell')
    parser.add_argument('--host', default='127.0.0.1', help='address to listen on')
    parser.add_argument('--port', type=int, default=700, help='0: any that is free')
    parser.add_argument('--seed', type=int, default=1, help='seed of cell and faults')
    parser.add_argument('--tables', default='', help='true errors of the machine (drawn)')
    parser.add_argument('--faults', default='', help=f'list such as split,busy=0.1; {listed}')
    for name in ('passes', 'levels'):
        info = next(info for info in PlannerConfig.infos() if info.name == name)
        parser.add_argument(f'--{name}', type=int, default=info.default, help=info.meaning)
    given = parser.parse_args(arguments)
    try:
        planning = PlannerConfig(passes=given.passes, levels=given.levels)
        faults = read_faults(given.faults)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(serve(given, faults, planning))
    except OtfError as error:
        sys.stderr.write(f'error: {error}\n')
        return error.exit_code
    return 0


if __name__ == '__main__':
    sys.exit(main())
