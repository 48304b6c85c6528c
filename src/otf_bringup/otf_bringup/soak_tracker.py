# SPDX-License-Identifier: Apache-2.0
"""An emulated tracker in a thread of its own, whose faults change while it serves."""

from __future__ import annotations

import asyncio
import threading

from otf_core.config import PlannerConfig
from otf_core.model.machine import Machine
from otf_tracker_driver.emulator.cell import Cell
from otf_tracker_driver.emulator.faults import read_faults
from otf_tracker_driver.emulator.server import EmulatedTracker

DRIFT = 18e-6
"""Rate of its clock, less one."""
ENDED_WITHIN = 10.0
"""s"""


class SoakTracker:
    """Serves on a free port of this computer until closed.

    Parameters
    ----------
    planning : PlannerConfig
        Of the path that it drives.
    """

    def __init__(self, machine: Machine, planning: PlannerConfig, seed: int) -> None:
        cell = Cell(machine, planning, seed, DRIFT)
        self._tracker = EmulatedTracker(cell, read_faults(''), seed, DRIFT)
        self._loop = asyncio.new_event_loop()
        self._ready, self.port = threading.Event(), 0
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=[self._serve()])
        self._thread.start()
        self._ready.wait()

    def change(self, faults: str) -> None:
        """Cut the connection; from the next one on, these faults happen."""
        changing = self._tracker.change(read_faults(faults))
        asyncio.run_coroutine_threadsafe(changing, self._loop).result(ENDED_WITHIN)

    def switch(self, on: bool) -> None:
        """Switch it on or off: nobody listens at its port then."""
        work = self._listen() if on else self._leave()
        asyncio.run_coroutine_threadsafe(work, self._loop).result(ENDED_WITHIN)

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(ENDED_WITHIN)

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        await self._listen()
        self._ready.set()
        await self._stop.wait()
        await self._tracker.close(self._server)

    async def _listen(self) -> None:
        accept = self._tracker.accept
        self._server = await asyncio.start_server(accept, '127.0.0.1', self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _leave(self) -> None:
        self._server.close()
        await self._tracker.change(read_faults(''))
