# SPDX-License-Identifier: Apache-2.0
"""When bytes arrived: the kernel's stamp of reception, not the moment at which somebody read them.

A process that waits for the processor, or for another thread of its own, reads late. Linux notes
with every segment and datagram when the network handed it over (socket(7), SO_TIMESTAMPNS).
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import sys
import time

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
