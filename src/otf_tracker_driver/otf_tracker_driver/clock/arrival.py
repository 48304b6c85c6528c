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

SO_TIMESTAMPNS = 35
"""asm-generic/socket.h; the module socket does not name it."""
STAMP = struct.Struct('@ll')
"""struct timespec: s, ns."""
SLACK = 10**6
"""ns; between reading two clocks."""


class Arrivals:
    """A socket that tells how long ago what is read from it had arrived.

    Nothing can have arrived before the socket was last found empty: an age beyond is that of a
    time of day that was set meanwhile. So an age holds however long this process stood still.

    Parameters
    ----------
    opened : socket
    """

    def __init__(self, opened: socket.socket) -> None:
        self._socket = opened
        self._empty_ns = time.monotonic_ns()
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
            data, notes, _, peer = self._socket.recvmsg(size, socket.CMSG_SPACE(STAMP.size))
        except (BlockingIOError, TimeoutError):
            self._empty_ns = looked_ns
            raise
        for level, kind, note in notes:
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS) and len(note) == STAMP.size:
                seconds, ns = STAMP.unpack(note)
                age = time.time_ns() - (seconds * 10**9 + ns)
                oldest = time.monotonic_ns() - self._empty_ns + SLACK
                return data, age if 0 < age <= oldest else 0, peer
        return data, 0, peer
