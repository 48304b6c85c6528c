# SPDX-License-Identifier: Apache-2.0
"""Leica emScon TPI over TCP: packets, commands, codes, and a connection; knows no ROS.

TCP splits and merges packets as it likes. Every packet begins with two little-endian int32: its
size, this header included, and its type. What is implemented, from which sources, and what is
unsure: docs/trackers.md.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError
from otf_tracker_driver.backends.base import Unreachable
from otf_tracker_driver.backends.live import BEAT, Silence
from otf_tracker_driver.clock import Arrivals

Value = int | float | str
HEADER = struct.Struct('<ii')
COMMAND = struct.Struct('<iii')
ANSWER = struct.Struct('<iiii')
EVENT = struct.Struct('<iii')
MULTI_HEAD = struct.Struct('<iiiiiiddd')
LARGEST = 1 << 18
"""Bytes of the largest packet that is taken: 1000 points of 92 bytes, three times per second, are
31 kB."""
HIGHEST_TYPE = 255
"""Types above are no emScon: 11 are known, newer servers may add some."""
CONNECT_WITHIN = 2.0
"""s"""
HINT = 'check that it is on and the address is correct'
ANSWER_WITHIN, MOVED_WITHIN = 5.0, 120.0
"""s; for commands that move nothing; for those that move the tracker or initialise it."""
BUSY_FOR = 30.0
"""s; a tracker that is busy for longer is reported as busy."""
FIRST_BUSY_PAUSE, BUSY_PAUSE = 0.02, 0.2
"""s; until it is asked again, doubled each time."""
MOST_REFLECTORS = 200


class PacketType(IntEnum):
    """Second word of every packet."""

    COMMAND = 0
    ERROR = 1
    MULTI = 3
    EVENT = 8
    MULTI_2 = 10


class Command(IntEnum):
    """Commands that this driver or its emulator speaks."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    SET_UNITS = 5
    GET_UNITS = 6
    INITIALIZE = 7
    GET_STATION_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    SET_ENVIRONMENT = 20
    GET_ENVIRONMENT = 21
    SET_MEASUREMENT_MODE = 24
    GET_MEASUREMENT_MODE = 25
    SET_COORDINATE_SYSTEM = 26
    GET_COORDINATE_SYSTEM = 27
    SET_CONTINUOUS_TIME = 30
    GET_CONTINUOUS_TIME = 31
    SET_REFLECTOR = 40
    GET_REFLECTOR = 41
    GET_REFLECTORS = 42
    SET_SYSTEM_SETTINGS = 47
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    FIND_REFLECTOR = 63
    UNSOLICITED = 64
    GET_DIRECTION = 66
    SET_STATISTIC_MODE = 80
    GET_STATISTIC_MODE = 81
    GET_FACE = 98
    GET_MEASUREMENT_STATUS = 122
    CLEAR_COMMAND_QUEUE = 130
    GET_TRACKER_INFO = 132
    GET_SOFTWARE_VERSION = 142


class Status(IntEnum):
    """Result codes that are acted upon."""

    OK = 0
    BUSY = 1
    NOT_IMPLEMENTED = 2
    WRONG_PARAMETER = 3
    WRONG_REFLECTOR = 23
    NOT_INITIALISED = 39
    MULTIPLE_CONNECTIONS = 10011
    NOT_READY = 10014
    BEAM_LOST = 701


class SampleStatus(IntEnum):
    """First word of every sample of a continuous measurement."""

    OK = 0
    SPEED_WARNING = 1
    SPEED_EXCEEDED = 2
    PRISM_ERROR = 3


class Event(IntEnum):
    """System status changes that are acted upon or sent by the emulator."""

    ENVIRONMENT = 2
    UNITS = 6
    REFLECTOR = 7
    SETTINGS = 8
    COORDINATE_SYSTEM = 12
    MODE = 17
    CONTINUOUS_PARAMETERS = 19
    STATUS_BUSY = 26
    STATUS_READY = 27
    SERVER_CLOSING = 998


SI_UNITS = (0, 0, 0, 0, 0)
"""m, rad, C, mbar, relative humidity."""
CARTESIAN_RIGHT_HANDED, SPHERICAL_COUNTER_CLOCKWISE = 0, 7
CONTINUOUS_TIME = 1
PROCESSOR_INITIALISED = 5
REFLECTOR_SEEN = 2048
"""Bit of the answer to GET_MEASUREMENT_STATUS."""

STATUS_TEXT = {
    1: 'server busy',
    2: 'command not implemented',
    3: 'wrong parameter',
    23: 'wrong reflector',
    26: 'no tracker processor',
    27: 'no weather station',
    35: 'usage conflict',
    37: 'no distance set: bring the reflector to a known point',
    38: 'no tracker connected',
    39: 'tracker not initialised',
    57: 'environment out of range',
    58: 'tracker is in compensation mode',
    94: 'no temperature',
    95: 'no pressure',
    96: 'no humidity',
    701: 'beam lost',
    10004: 'not ready to measure',
    10005: 'distance meter starting up',
    10011: 'another client is connected to the tracker: close it',
    10012: 'tracker not warmed up',
    10014: 'tracker not ready',
    10015: 'sensor communication failed',
}
SAMPLE_TEXT = {
    1: 'target fast',
    2: 'target too fast',
    3: 'no reflector',
    4: 'trigger too early',
}


def status_text(status: int) -> str:
    """State what a result code means."""
    if 4 <= status <= 10:
        return f'parameter {status - 3} is wrong (status {status})'
    if 11 <= status <= 22:
        return f'parameter out of range (status {status})'
    return f'{STATUS_TEXT.get(status, "unknown to this driver")} (status {status})'


def command_text(command: int) -> str:
    """State which command a number is."""
    known = {int(c): c.name.replace('_', ' ').lower() for c in Command}
    return f'{known.get(command, "unknown")} (command {command})'


class ProtocolError(Exception):
    """The peer sent what is no emScon; the message says what."""


class Framer:
    """Collects bytes and yields whole packets, header included.

    What it holds never exceeds one packet and one chunk.
    """

    def __init__(self) -> None:
        self._held = bytearray()

    @property
    def partial(self) -> bool:
        """True if a packet has begun that is not complete."""
        return bool(self._held)

    @property
    def missing(self) -> int:
        """Bytes until the end of the packet that has begun, as far as is known; of its header."""
        held = len(self._held)
        size: int = HEADER.size if held < HEADER.size else HEADER.unpack_from(self._held)[0]
        return size - held

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Take bytes as they arrived; yield the packets that are complete.

        Raises
        ------
        ProtocolError
            If the next header cannot be one; nothing after it can be framed.
        """
        self._held += chunk
        start = 0
        try:
            while len(self._held) - start >= HEADER.size:
                size, kind = HEADER.unpack_from(self._held, start)
                if not (HEADER.size <= size <= LARGEST and 0 <= kind <= HIGHEST_TYPE):
                    raise ProtocolError(f'not an emScon packet: size {size}, type {kind}')
                if len(self._held) - start < size:
                    return
                start += size
                yield bytes(self._held[start - size : start])
        finally:
            del self._held[:start]


class TrackerError(InputError):
    """The tracker cannot be used as it is."""


class LinkError(TrackerError, Unreachable):
    """There is no connection, or it was lost; connecting again may help."""


class CommandRefused(TrackerError):
    """The tracker answered a command with an error.

    Attributes
    ----------
    status : int
        Result code.
    """

    def __init__(self, command: int, status: int) -> None:
        super().__init__(command, status)
        self.status = status

    def __str__(self) -> str:
        command, status = self.args
        return f'{command_text(command)}: {status_text(status)}'


SLOW = {Command.INITIALIZE, Command.CHANGE_FACE, Command.GO_BIRD_BATH, Command.FIND_REFLECTOR}
SAMPLE = np.dtype([('status', '<i4'), ('s', '<i4'), ('us', '<i4'), ('value', '<f8', 3)])
SAMPLE_2 = np.dtype([*SAMPLE.descr, ('apriori', '<f8', 7)])
SAMPLES = {PacketType.MULTI: SAMPLE, PacketType.MULTI_2: SAMPLE_2}


@dataclass(frozen=True)
class Answer:
    """Answer to a command: result code and what follows it."""

    command: int
    status: int
    body: bytes


@dataclass(frozen=True)
class ErrorReport:
    """Error that the tracker reports by itself, such as a lost beam."""

    command: int
    status: int


@dataclass(frozen=True)
class StatusChange:
    """Event that the tracker reports by itself."""

    event: int


@dataclass(frozen=True)
class Measurements:
    """One packet of a continuous measurement.

    Attributes
    ----------
    result : int
        Result code of the packet.
    environment : tuple of float
        Temperature, pressure, humidity in the current units.
    status : ndarray of int32, shape (n,)
        Of every sample, see SampleStatus.
    device_ns : ndarray of int64, shape (n,), ns
        Time of every sample since the start of the measurement, on the tracker's clock.
    value : ndarray, shape (n, 3)
        In the current units and coordinate system.
    """

    result: int
    environment: tuple[float, float, float]
    status: NDArray[np.int32]
    device_ns: NDArray[np.int64]
    value: NDArray[np.float64]


Packet = Answer | ErrorReport | StatusChange | Measurements


def decode(packet: bytes) -> Packet | None:
    """Read one whole packet from the tracker; None if it is of a type that is of no use.

    Raises
    ------
    ProtocolError
        If the packet is shorter than its type needs, or its parts do not fill it.
    """
    _, kind = HEADER.unpack_from(packet)
    if kind == PacketType.COMMAND:
        _, _, command, status = _unpacked(ANSWER, packet, 'answer')
        return Answer(command, status, packet[ANSWER.size :])
    if kind == PacketType.ERROR:
        _, _, command, status = _unpacked(ANSWER, packet, 'error')
        return ErrorReport(command, status)
    if kind == PacketType.EVENT:
        return StatusChange(_unpacked(EVENT, packet, 'event')[2])
    if kind in SAMPLES:
        return _measurements(packet, SAMPLES[PacketType(kind)])
    return None


def _unpacked(layout: struct.Struct, packet: bytes, what: str) -> tuple[int, ...]:
    if len(packet) < layout.size:
        raise ProtocolError(f'{what} of {len(packet)} bytes, {layout.size} needed')
    return layout.unpack_from(packet)


def _measurements(packet: bytes, layout: np.dtype) -> Measurements:
    head = _unpacked(MULTI_HEAD, packet, 'measurement')
    result, count = head[2:4]
    # a count that does not fill the packet is never used as a length
    if count < 0 or len(packet) != MULTI_HEAD.size + count * layout.itemsize:
        raise ProtocolError(f'measurement of {len(packet)} bytes says {count} samples')
    rows = np.frombuffer(packet, layout, count, MULTI_HEAD.size)
    device_ns = rows['s'].astype(np.int64) * 10**9 + rows['us'].astype(np.int64) * 1000
    environment = head[6], head[7], head[8]
    return Measurements(
        result, environment, rows['status'].copy(), device_ns, rows['value'].astype(float)
    )


REQUESTS: dict[Command, str] = {
    Command.SET_UNITS: '5i',
    Command.SET_ENVIRONMENT: '3d',
    Command.SET_MEASUREMENT_MODE: 'i',
    Command.SET_COORDINATE_SYSTEM: 'i',
    Command.SET_CONTINUOUS_TIME: '4i',
    Command.SET_REFLECTOR: 'i',
    Command.SET_SYSTEM_SETTINGS: '9i',
    Command.FIND_REFLECTOR: 'd',
    Command.SET_STATISTIC_MODE: '2i',
    Command.CLEAR_COMMAND_QUEUE: 'i',
}
"""What follows the number of a command, little-endian and packed: ``i`` an int32, ``d`` a double,
``64s`` a text of 32 UTF-16 units; nothing if not listed."""
ANSWERS: dict[Command, str] = {
    Command.GET_SYSTEM_STATUS: '10i',
    Command.GET_TRACKER_STATUS: 'i',
    Command.GET_UNITS: '5i',
    Command.GET_STATION_ORIENTATION: '6d',
    Command.GET_TRANSFORMATION: '7d',
    Command.GET_ENVIRONMENT: '3d',
    Command.GET_MEASUREMENT_MODE: 'i',
    Command.GET_COORDINATE_SYSTEM: 'i',
    Command.GET_CONTINUOUS_TIME: '4i',
    Command.GET_REFLECTOR: 'i',
    Command.GET_REFLECTORS: '3id64s',
    Command.GET_SYSTEM_SETTINGS: '9i',
    Command.GET_DIRECTION: '2d',
    Command.GET_STATISTIC_MODE: '2i',
    Command.GET_FACE: 'i',
    Command.GET_MEASUREMENT_STATUS: '2i',
    Command.GET_TRACKER_INFO: 'i64s5i3d2i2d3i',
    Command.GET_SOFTWARE_VERSION: '64s',
}
"""The same of what follows the result code of an answer."""


def encode_request(command: Command, *values: Value) -> bytes:
    """Return the packet of a command with its values."""
    body = struct.pack(f'<{REQUESTS.get(command, "")}', *values)
    return COMMAND.pack(COMMAND.size + len(body), PacketType.COMMAND, command) + body


def read_values(fields: str, body: bytes, what: str) -> tuple[Value, ...]:
    """Read values of a packet; newer servers may append to them.

    Raises
    ------
    ProtocolError
        If there are too few bytes of ``what``.
    """
    layout = struct.Struct(f'<{fields}')
    if len(body) < layout.size:
        raise ProtocolError(f'{what}: {len(body)} bytes, {layout.size} needed')
    return tuple(_text(v) if isinstance(v, bytes) else v for v in layout.unpack_from(body))


def _text(raw: bytes) -> str:
    """Text up to its NUL, in one printable line."""
    text = raw.decode('utf-16-le', errors='replace').partition('\0')[0]
    return ''.join(c if c.isprintable() else '?' for c in text)


class Link:
    """One connection to a tracker: commands with their answers, and whatever else it sends.

    Parameters
    ----------
    unasked : callable
        Takes packets that answer nothing, and when their first byte arrived, ns.
    now_ns : callable
        Time of the host.
    ended : threading.Event
        Whoever waits for the tracker gives up once it is set.

    Attributes
    ----------
    asked_ns, sent_ns, answered_ns : int
        Just before and just after the last command was sent, and when the last answer arrived.
    unreadable : int
        Packets that were framed but made no sense.
    """

    def __init__(
        self,
        opened: socket.socket,
        unasked: Callable[[Packet, int], None],
        now_ns: Callable[[], int],
        ended: threading.Event,
    ) -> None:
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        opened.setblocking(False)
        self._socket, self._arrivals = opened, Arrivals(opened)
        self._unasked, self._now_ns, self._ended = unasked, now_ns, ended
        self._framer, self._begun_ns = Framer(), 0
        self._awaited: Command | None = None
        self._answers: deque[Answer] = deque()
        self._heard = False
        self.asked_ns = self.sent_ns = self.answered_ns = self.unreadable = 0

    @property
    def unread(self) -> bool:
        """True if the tracker has sent more than was read until now."""
        return self._arrivals.unread

    def read(self, within: float) -> None:
        """Take what has arrived, or arrives within so many seconds.

        No more than a packet is asked for at a time, so that the age of each one of a backlog is
        known, as far as the kernel has kept them apart.

        Raises
        ------
        LinkError
            If the connection has ended, or is to end.
        """
        if self._ended.is_set():
            raise LinkError('disconnected')
        if not select.select([self._socket], [], [], within)[0]:
            return
        try:
            chunk, age_ns, _ = self._arrivals.receive(self._framer.missing)
            if not chunk:
                raise self._lost('the tracker closed the connection')
            arrival_ns = self._now_ns() - age_ns
            if not self._framer.partial:
                self._begun_ns = arrival_ns
            for packet in self._framer.feed(chunk):
                self._take(packet)
        except BlockingIOError:
            return
        except ProtocolError as error:
            raise self._lost(f'{error}; is an emScon server listening there?') from None
        except OSError as error:
            raise self._lost(f'connection lost ({error.strerror or error})') from None

    def _lost(self, reason: str) -> LinkError:
        unheard = ', before any answer; is another client connected?'
        return LinkError(reason if self._heard else reason + unheard)

    def _take(self, raw: bytes) -> None:
        try:
            packet = decode(raw)
        except ProtocolError:
            self.unreadable += 1
            return
        self._heard = True
        if isinstance(packet, ErrorReport) and packet.command == self._awaited:
            packet = Answer(packet.command, packet.status, b'')
        if isinstance(packet, Answer):
            if packet.command == self._awaited:
                self.answered_ns = self._begun_ns
                self._answers.append(packet)
        elif packet is not None:
            self._unasked(packet, self._begun_ns)

    def pause(self, seconds: float) -> None:
        """Take what arrives for so long."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.read(min(left, BEAT))

    def ask(self, command: Command, *values: Value) -> tuple[Value, ...]:
        """Send a command and return the values of its answer; waits while the tracker is busy.

        Raises
        ------
        CommandRefused
            If the tracker answers with an error.
        LinkError
            If there is no answer, or no connection.
        """
        until, pause = time.monotonic() + BUSY_FOR, FIRST_BUSY_PAUSE
        while True:
            try:
                self._send(command, *values)
                return self._answer(command)
            except CommandRefused as refused:
                if refused.status != Status.BUSY or time.monotonic() > until:
                    raise
            finally:
                self._awaited = None
            self.pause(pause)
            pause = min(2 * pause, BUSY_PAUSE)

    def reflectors(self) -> dict[int, str]:
        """Return number and name of all reflectors; each comes in an answer of its own."""
        found: dict[int, str] = {}
        answer = self.ask(Command.GET_REFLECTORS)
        self._awaited = Command.GET_REFLECTORS
        try:
            for _ in range(MOST_REFLECTORS):
                total, number, _, _, name = answer
                found[int(number)] = str(name)
                if len(found) >= int(total):
                    return found
                answer = self._answer(Command.GET_REFLECTORS)
        finally:
            self._awaited = None
        raise LinkError(f'the tracker lists more than {MOST_REFLECTORS} reflectors')

    def optional(self, command: Command) -> tuple[Value, ...] | None:
        """Answer of a command that not every server knows; None from one that does not."""
        try:
            return self.ask(command)
        except CommandRefused as refused:
            if refused.status != Status.NOT_IMPLEMENTED:
                raise
            return None

    def set(self, set_: Command, get: Command, *values: Value) -> None:
        """Set values and read them back; TrackerError if the tracker keeps others."""
        self.ask(set_, *values)
        got = self.ask(get)
        # servers may keep doubles with less digits
        if any(abs(float(a) - float(b)) > 1e-3 for a, b in zip(got, values, strict=True)):
            raise TrackerError(
                f'{command_text(set_)}: {values} is set, but the tracker keeps {got}; '
                f'set it at the tracker, or see whether another program holds it'
            )

    def tell(self, command: Command) -> None:
        """Send a command without values whose answer does not matter any more."""
        with contextlib.suppress(LinkError):
            self._send(command)

    def _send(self, command: Command, *values: Value) -> None:
        request = encode_request(command, *values)
        self._answers.clear()
        self._awaited, self.asked_ns = command, self._now_ns()
        try:
            sent = self._socket.send(request)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise LinkError(f'connection lost ({error.strerror or error})') from None
        if sent < len(request):
            raise LinkError('the tracker takes no commands any more')
        self.sent_ns = self._now_ns()

    def _answer(self, command: Command) -> tuple[Value, ...]:
        limit, silence = MOVED_WITHIN if command in SLOW else ANSWER_WITHIN, Silence()
        what = command_text(command)
        while not self._answers:
            if silence.beat() > limit:
                raise LinkError(
                    f'no answer to {what} within {limit:.0f} s; is it an emScon server?'
                )
            self.read(BEAT)
        answer = self._answers.popleft()
        if answer.status != Status.OK:
            raise CommandRefused(command, answer.status)
        try:
            fields = ANSWERS.get(command, '')
            return read_values(fields, answer.body, f'answer to {what}')
        except ProtocolError as error:
            raise TrackerError(f'{error}; this version of the server is not known') from None


@contextlib.contextmanager
def connected(host: str, port: int, *arguments: Any) -> Iterator[Link]:
    """Connect; the connection ends with the block. LinkError if there is none."""
    try:
        opened = socket.create_connection((host, port), CONNECT_WITHIN)
    except TimeoutError:
        raise LinkError(f'no connection within {CONNECT_WITHIN:g} s; {HINT}') from None
    except (OSError, UnicodeError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise LinkError(f'no connection ({reason}); {HINT}') from None
    with opened:
        try:
            yield Link(opened, *arguments)
        finally:  # a socket that is closed with bytes unread resets its peer
            opened.settimeout(BEAT)
            until = time.monotonic() + BEAT
            with contextlib.suppress(OSError):
                opened.shutdown(socket.SHUT_WR)
                while opened.recv(1 << 16) and time.monotonic() < until:
                    pass
