# SPDX-License-Identifier: Apache-2.0
"""TCP, UDP and serial lines as one thing: bytes come, bytes go."""

from __future__ import annotations

import os
import select
import socket
import termios
import tty
from abc import ABC, abstractmethod

from otf_tracker_driver.clock.arrival import Arrivals
from otf_tracker_driver.errors import Unreachable
from otf_tracker_driver.stream.description import Source

CHUNK = 1 << 16
CONNECT_WITHIN = 5.0
"""s"""
PROBES = {'TCP_KEEPIDLE': 3, 'TCP_KEEPINTVL': 2, 'TCP_KEEPCNT': 3}
"""s, s, number: a silent TCP connection is probed, so that one whose other end is gone ends."""


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
