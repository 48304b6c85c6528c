# SPDX-License-Identifier: Apache-2.0
"""The emulated tracker's TCP server: one client is served, a second one is told so."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time

import numpy as np

from otf_tracker_driver.emscon import commands
from otf_tracker_driver.emscon.codes import Command, Event, Status
from otf_tracker_driver.emscon.framing import Framer, ProtocolError
from otf_tracker_driver.emscon.packets import encode_answer, encode_event
from otf_tracker_driver.emulator.cell import TICK, Cell
from otf_tracker_driver.emulator.device import Device
from otf_tracker_driver.emulator.faults import Faults
from otf_tracker_driver.emulator.measuring import Drive, Measuring, Record
from otf_tracker_driver.emulator.wire import Wire

C = Command
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
                    number, body = commands.read_request(packet)
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
            wire.put(commands.answer(C.GET_DIRECTION, Status.OK, *self._direction()))
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
