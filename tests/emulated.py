# SPDX-License-Identifier: Apache-2.0
"""An emulated tracker in a thread of its own, listening on a free port."""

import asyncio
import threading
import time
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from cells import MACHINE, SHORT
from emulator import Cell, EmulatedTracker, read_faults

from otf_core.config import PlannerConfig
from otf_core.model.machine import machine_from_dict

DRIFT = 18e-6


@lru_cache
def cell():
    """The small cell on its short path, simulated once."""
    return Cell(machine_from_dict(MACHINE), PlannerConfig(**SHORT), 1, DRIFT)


class Running:
    """What a test sees of a running emulator: its port, and what it has measured when."""

    def __init__(self, faults, seed, simulated):
        self.true_ns = {}
        self._ahead = time.time_ns() - time.monotonic_ns()
        arguments = simulated or cell(), read_faults(faults), seed, DRIFT, self._record
        self.tracker = EmulatedTracker(*arguments)
        self.tracker.device.initialised = 'initialize' not in faults
        self._loop = asyncio.new_event_loop()
        self._ready, self._thread = threading.Event(), threading.Thread(target=self._run)
        self.port = 0

    def _record(self, seconds, xyz):
        ns = np.rint(seconds * 1e9).astype(np.int64) + self._ahead
        for point, at in zip(map(bytes, xyz), ns.tolist(), strict=True):
            # a machine at the end of its run, and in another one, gives the same points again
            self.true_ns.setdefault(point, []).append(at)

    def error_ms(self, samples):
        """Stamps less true times of measurement, the nearest where there are several, ms."""
        rows = zip(samples.stamp_ns.tolist(), samples.xyz, strict=True)
        off = ([stamp - at for at in self.true_ns[bytes(point)]] for stamp, point in rows)
        return np.array([min(one, key=abs) / 1e6 for one in off])

    def _run(self):
        self._loop.run_until_complete(self._serve())

    async def _serve(self):
        server = await asyncio.start_server(self.tracker.accept, '127.0.0.1', 0)
        self.port = server.sockets[0].getsockname()[1]
        self._stop = asyncio.Event()
        self._ready.set()
        await self._stop.wait()
        await self.tracker.close(server)

    def start(self):
        self._thread.start()
        assert self._ready.wait(10)

    def stop(self):
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10)
        self._loop.close()


@contextmanager
def emulator(faults='', seed=1, simulated=None):
    """Run an emulated tracker, of the small cell if no other is given."""
    running = Running(faults, seed, simulated)
    running.start()
    try:
        yield running
    finally:
        running.stop()
