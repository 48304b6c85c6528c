# SPDX-License-Identifier: Apache-2.0
"""Sends packets as a network does: split and merged where the faults say so."""

from __future__ import annotations

import asyncio
import random

from otf_tracker_driver.emulator.faults import Faults

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
