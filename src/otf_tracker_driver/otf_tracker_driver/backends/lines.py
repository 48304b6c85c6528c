# SPDX-License-Identifier: Apache-2.0
"""Points as lines: where they come from, how lines are read; a YAML file describes both.

TCP, UDP and serial lines are one thing: bytes come, bytes go. Nothing in them is believed. See
docs/trackers.md for every key, and two examples that are tried.
"""

from __future__ import annotations

import json
import math
import os
import re
import select
import socket
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from otf_core.files.strict_yaml import Fields, read_yaml, value_text
from otf_tracker_driver.backends.base import Unreachable
from otf_tracker_driver.backends.live import FURTHEST
from otf_tracker_driver.clock import Arrivals

LENGTHS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'in': 0.0254, 'ft': 0.3048}
ANGLES = {'rad': 1.0, 'deg': math.pi / 180, 'gon': math.pi / 200}
TIMES = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
HOST = 'host'
"""In place of the stamp: samples are stamped when they arrive."""
CARTESIAN = ('x', 'y', 'z')
SPHERICAL = ('azimuth', 'zenith', 'distance')
TEXT, JSON = 'text', 'json'
DECIMALS = ('.', ',')
BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
SENSES = ('clockwise', 'counterclockwise')
MOST_COLUMNS = 1000
REQUIRED = ('source', 'format', 'columns', 'keys', 'length', 'stamp')
OPTIONAL = ('time', 'separator', 'decimal', 'angle', 'azimuth_sense', 'peer', 'start', 'stop')
LONGEST = 4096
"""Bytes of a line; longer ones are left out."""
LATEST = 4.6e18
"""ns; differences of stamps beyond do not fit into 64 bits."""
CHUNK = 1 << 16
CONNECT_WITHIN = 5.0
"""s"""
PROBES = {'TCP_KEEPIDLE': 3, 'TCP_KEEPINTVL': 2, 'TCP_KEEPCNT': 3}
"""s, s, number: a silent TCP connection is probed, so that one whose other end is gone ends."""
Place = int | str
"""Number of a column, from 0; or key in JSON, points between keys that lie in each other."""


@dataclass(frozen=True)
class Source:
    """Where lines come from.

    Attributes
    ----------
    kind : str
        'tcp', 'udp' or 'serial'.
    host : str
        Address to connect to, or to listen on; device file of a serial line.
    port : int
        TCP or UDP port, or baud rate.
    """

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        """As people write it."""
        return f'{self.kind}://{self.host}:{self.port}'


@dataclass(frozen=True)
class Description:
    """How to reach a source and to read its lines.

    Attributes
    ----------
    format : str
        'text' or 'json'.
    separator : str
        Between columns; empty: any white space.
    decimal : str
        Of numbers in text: '.' or ','.
    point : tuple
        Places of x, y, z; or of azimuth, zenith and distance if ``spherical``.
    clockwise : bool
        Azimuth grows clockwise, seen from above.
    stamp : int, str or None
        Place of the time of measurement; None: stamped on arrival.
    length, angle : float
        Metres and radians per unit.
    time : int
        Nanoseconds per unit.
    peer : str
        Only datagrams from this address are taken; empty: from anyone.
    start, stop : str
        Sent when a stream starts and ends; empty: nothing.
    """

    source: Source
    format: str
    separator: str
    decimal: str
    point: tuple[Place, Place, Place]
    spherical: bool
    clockwise: bool
    stamp: Place | None
    length: float
    angle: float
    time: int
    peer: str
    start: str
    stop: str


def read_description(path: str | Path) -> Description:
    """Read a description.

    Raises
    ------
    ConfigError
        Names file and key, what it holds and what is possible.
    """
    top = Fields(read_yaml(path), str(path))
    source = _source(top)
    kind = _choice(top, 'format', (TEXT, JSON))
    separator = _separator(top) if kind == TEXT and top.has('separator') else ''
    decimal = _choice(top, 'decimal', DECIMALS) if kind == TEXT and top.has('decimal') else '.'
    if decimal == separator:
        top.fail('decimal', f'{value_text(decimal)} separates the columns, too')
    columns = top.mapping('columns' if kind == TEXT else 'keys')
    spherical = not columns.has('x') and columns.has('azimuth')
    names = SPHERICAL if spherical else CARTESIAN
    first, second, third = (_place(columns, name, kind) for name in names)
    columns.done()
    value = top.take('stamp')
    stamp = None if value == HOST else _checked(top, 'stamp', value, kind)
    length = LENGTHS[_choice(top, 'length', tuple(LENGTHS))]
    angle = ANGLES[_choice(top, 'angle', tuple(ANGLES))] if spherical else 1.0
    clockwise = spherical and _choice(top, 'azimuth_sense', SENSES) == SENSES[0]
    time = TIMES[_choice(top, 'time', tuple(TIMES))] if stamp is not None else 1
    peer = top.text('peer') if source.kind == 'udp' and top.has('peer') else ''
    start, stop = (_escaped(top.text(k)) if top.has(k) else '' for k in ('start', 'stop'))
    top.done(known=(*REQUIRED, *OPTIONAL))
    point = first, second, third
    return Description(
        source, kind, separator, decimal, point, spherical, clockwise, stamp, length, angle, time,
        peer, start, stop,
    )  # fmt: skip


def _source(top: Fields) -> Source:
    text = top.text('source')
    address = re.fullmatch(r'(tcp|udp|serial)://(.+):(\d{1,7})', text)
    if not address:
        top.fail('source', f'{value_text(text)}; give tcp://HOST:PORT, '
                 f'udp://ADDRESS:PORT (listens there) or '
                 f'serial:///dev/ttyUSB0:115200')  # fmt: skip
    kind, host, port = address[1], address[2], int(address[3])
    if kind == 'serial' and port not in BAUDS:
        top.fail('source', f'{port} baud; possible: {", ".join(map(str, BAUDS))}')
    if kind != 'serial' and not 0 < port < 65536:
        top.fail('source', f'port {port}; possible: 1 to 65535')
    return Source(kind, host, port)


def _separator(top: Fields) -> str:
    value = top.take('separator')
    if not isinstance(value, str) or not value:
        top.fail('separator', f'expected text, got {value_text(value)}')
    return _escaped(value)


def _choice(fields: Fields, key: str, possible: Sequence[str]) -> str:
    text = fields.text(key)
    if text not in possible:
        fields.fail(key, f'{value_text(text)}; possible: {", ".join(possible)}')
    return text


def _place(fields: Fields, key: str, kind: str) -> Place:
    return _checked(fields, key, fields.take(key), kind)


def _checked(fields: Fields, key: str, value: object, kind: str) -> Place:
    if kind == JSON:
        if isinstance(value, str) and value:
            return value
        fields.fail(key, f'{value_text(value)}; give its key in the JSON object, such as pose.x')
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MOST_COLUMNS:
        return value
    fields.fail(key, f'{value_text(value)}; give the number of its column, the first is 0')


def _escaped(text: str) -> str:
    return text.replace('\\r', '\r').replace('\\n', '\n').replace('\\t', '\t')


class Lines:
    """Cuts a byte stream into lines; holds one unfinished line at most.

    Parameters
    ----------
    cut_in : bool
        The first bytes may be the end of a line, and are left out.

    Attributes
    ----------
    too_long : int
        Lines that were left out.
    partial : bool
        A line has begun that is not complete.
    """

    def __init__(self, cut_in: bool = False) -> None:
        self._held = b''
        self._skipping = cut_in
        self.too_long = 0
        self.partial = False

    def feed(self, chunk: bytes) -> Iterator[str]:
        """Take bytes; yield the lines that are complete, none of them empty."""
        *whole, rest = chunk.replace(b'\r', b'\n').split(b'\n')
        self.partial = bool(rest) or (self.partial and not whole)
        for part in whole:
            line, self._held = self._held + part, b''
            skipped, self._skipping = self._skipping, False
            if skipped or len(line) > LONGEST:
                self.too_long += not skipped
            elif line.strip():
                yield line.decode('utf-8', errors='replace').strip()
        if self._skipping or len(self._held) + len(rest) > LONGEST:
            self.too_long += not self._skipping
            self._skipping, self._held = True, b''
        else:
            self._held += rest


class Unreadable(Exception):
    """A line that holds no point; the message says why."""


def read_point(line: str, how: Description) -> tuple[int | None, tuple[float, float, float]]:
    """Read stamp and point of a line.

    Returns
    -------
    tuple
        Time of measurement, ns, or None; x, y, z, m.

    Raises
    ------
    Unreadable
    """
    values = _json(line) if how.format == JSON else _columns(line, how)
    first, second, third = (_number(_at(values, place), place) for place in how.point)
    if how.spherical:
        first, second, third = _cartesian(
            first * how.angle, second * how.angle, third, how.clockwise
        )
    x, y, z = (how.length * value for value in (first, second, third))
    if not 0.0 < math.sqrt(x * x + y * y + z * z) < FURTHEST:
        raise Unreadable(f'point ({x:g}, {y:g}, {z:g}) m is implausible; check length')
    if how.stamp is None:
        return None, (x, y, z)
    return _stamp(_at(values, how.stamp), how), (x, y, z)


def _columns(line: str, how: Description) -> list[str]:
    parts = [part.strip() for part in line.split(how.separator or None)]
    if how.decimal == '.':
        return parts
    # a point is none of theirs: it groups thousands, or the description is wrong
    return [part.replace('.', '_.').replace(how.decimal, '.') for part in parts]


def _json(line: str) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        raise Unreadable('no JSON') from None


def holds_one_object(datagram: bytes) -> bool:
    """Return whether all of a datagram is one JSON object, over however many lines."""
    try:
        return isinstance(json.loads(datagram), dict)
    except (ValueError, RecursionError):
        return False


def _at(values: object, place: Place) -> object:
    if isinstance(place, int):
        assert isinstance(values, list)
        if place >= len(values):
            raise Unreadable(f'column {place} is missing, there are {len(values)}')
        return values[place]
    for key in place.split('.'):
        if isinstance(values, dict) and key in values:
            values = values[key]
        elif isinstance(values, list) and key.isdecimal() and int(key) < len(values):
            values = values[int(key)]
        else:
            raise Unreadable(f'key {place} is missing')
    return values


def _number(value: object, place: Place) -> float:
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number):
            return number
    raise Unreadable(f'{"column" if isinstance(place, int) else "key"} {place} is not a number')


def _stamp(value: object, how: Description) -> int:
    """Time in ns; integers keep all their digits."""
    assert how.stamp is not None
    number = _number(value, how.stamp) * how.time
    if not abs(number) < LATEST:
        raise Unreadable('stamp is out of range')
    if isinstance(value, int) or (isinstance(value, str) and value.isdecimal()):
        return int(value) * how.time
    return round(number)


def _cartesian(
    azimuth: float, zenith: float, distance: float, clockwise: bool
) -> tuple[float, float, float]:
    sine = math.sin(zenith)
    y = distance * sine * math.sin(azimuth)
    return distance * sine * math.cos(azimuth), -y if clockwise else y, distance * math.cos(zenith)


class Transport(ABC):
    """An open source of bytes; OSError where it has ended.

    Attributes
    ----------
    datagrams : bool
        What comes is whole messages.
    cuts_in : bool
        The first bytes may be the end of a line.
    age_ns : int, ns
        How long ago what was received last had arrived.
    """

    datagrams = cuts_in = False
    age_ns = 0

    @property
    def dropped(self) -> int:
        """Messages that came and that this computer had no room for."""
        return 0

    @abstractmethod
    def receive(self, timeout: float) -> bytes | None:
        """Return what has come, or None if nothing comes within the timeout, s."""

    @abstractmethod
    def send(self, data: bytes) -> bool:
        """Send to the source; False if nobody knows yet where that is."""

    @abstractmethod
    def close(self) -> None:
        """Close; afterwards nothing may be called."""


class Socket(Transport):
    """TCP connection, or UDP port that is listened to."""

    def __init__(self, opened: socket.socket, datagrams: bool, only: str = '') -> None:
        self._socket, self.datagrams, self._only = opened, datagrams, only
        self._peer: object = None
        self._arrivals = Arrivals(opened)

    @property
    def dropped(self) -> int:
        """Datagrams that the kernel had no room for, while nobody read."""
        return self._arrivals.dropped

    def receive(self, timeout: float) -> bytes | None:
        """Return what has come; a TCP peer that has closed is an OSError."""
        self._socket.settimeout(timeout)
        try:
            data, self.age_ns, peer = self._arrivals.receive(CHUNK)
        except TimeoutError:
            return None
        if self._only and not (isinstance(peer, tuple) and peer[0] == self._only):
            return None
        self._peer = peer
        if not data and not self.datagrams:
            raise ConnectionError('the source closed the connection')
        return data

    def send(self, data: bytes) -> bool:
        """Send; over UDP to whoever has sent last, so not before that."""
        if not self.datagrams:
            self._socket.sendall(data)
            return True
        if not isinstance(self._peer, tuple):
            return False
        self._socket.sendto(data, self._peer)
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Serial(Transport):
    """Serial line, 8N1, no handshake."""

    cuts_in = True

    def __init__(self, device: str, baud: int) -> None:
        self._file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(self._file)
            settings = termios.tcgetattr(self._file)
            settings[4] = settings[5] = getattr(termios, f'B{baud}')
            settings[2] |= termios.CLOCAL | termios.CREAD
            termios.tcsetattr(self._file, termios.TCSANOW, settings)
        except termios.error as error:
            os.close(self._file)
            raise OSError(error.args[0], 'no serial line') from None

    def receive(self, timeout: float) -> bytes | None:
        """Return what has come."""
        if not select.select([self._file], [], [], timeout)[0]:
            return None
        data = os.read(self._file, CHUNK)
        if not data:
            raise ConnectionError('the serial line is gone')
        return data

    def send(self, data: bytes) -> bool:
        """Send to the line."""
        os.write(self._file, data)
        return True

    def close(self) -> None:
        """Close the line."""
        os.close(self._file)


def open_source(source: Source, peer: str = '') -> Transport:
    """Open a source; of datagrams, take only those of a peer if one is given.

    Raises
    ------
    Unreachable
        If it cannot be opened; says which and why.
    """
    try:
        if source.kind == 'serial':
            return Serial(source.host, source.port)
        if source.kind == 'udp':
            return Socket(_listening(source), True, socket.gethostbyname(peer) if peer else '')
        address = source.host, source.port
        return Socket(_probed(socket.create_connection(address, CONNECT_WITHIN)), False)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise Unreachable(
            f'{source}: cannot be opened ({reason}); check that the device is on and the address '
            f'is correct'
        ) from None


def _probed(opened: socket.socket) -> socket.socket:
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in PROBES.items():
        if hasattr(socket, name):
            opened.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    return opened


def _listening(source: Source) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(
        source.host, source.port, type=socket.SOCK_DGRAM
    )[0]
    opened = socket.socket(family, kind, protocol)
    try:
        opened.bind(address)
    except OSError:
        opened.close()
        raise
    return opened
