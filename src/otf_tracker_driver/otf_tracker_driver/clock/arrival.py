# SPDX-License-Identifier: Apache-2.0
"""When bytes arrived: the kernel's stamp of reception, not the moment at which somebody read them.

A process that waits for the processor, or for another thread of its own, reads late. Linux notes
with every segment and datagram when the network handed it over (socket(7), SO_TIMESTAMPNS).
"""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
import time

SO_TIMESTAMPNS = 35
"""asm-generic/socket.h; the module socket does not name it."""
STAMP = struct.Struct('@ll')
"""struct timespec: s, ns."""
OLDEST = 10 * 10**9
"""ns; a greater age is that of a time of day that was set meanwhile."""


def stamp_arrivals(opened: socket.socket) -> None:
    """Have the kernel stamp what arrives, where it can."""
    if sys.platform == 'linux':
        with contextlib.suppress(OSError):
            opened.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def receive(opened: socket.socket, size: int) -> tuple[bytes, int, object]:
    """Return what has come, how long ago, ns, and from whom.

    Of bytes that came one after another and are read together it is the age of the last. It is 0
    where the kernel does not tell.
    """
    data, notes, _, peer = opened.recvmsg(size, socket.CMSG_SPACE(STAMP.size))
    for level, kind, note in notes:
        if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS) and len(note) == STAMP.size:
            seconds, ns = STAMP.unpack(note)
            age = time.time_ns() - (seconds * 10**9 + ns)
            return data, age if 0 < age < OLDEST else 0, peer
    return data, 0, peer
