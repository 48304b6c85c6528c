# SPDX-License-Identifier: Apache-2.0
"""Packets out of a byte stream: TCP splits and merges them as it likes.

Every packet begins with two little-endian int32: its size, this header included, and its type.
No size is believed beyond what a tracker sends: 1000 points of 92 bytes at 3 packets per second
are 31 kB.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

HEADER = struct.Struct('<ii')
LARGEST = 1 << 18
"""Bytes of the largest packet that is taken."""
HIGHEST_TYPE = 255
"""Types above are no emScon: 11 are known, newer servers may add some."""


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
