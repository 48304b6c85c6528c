# SPDX-License-Identifier: Apache-2.0
"""Silence of a source, measured in time in which this process ran and could have heard it.

A process may stand still for seconds: swapped out, in a paused virtual machine, stopped by a
debugger, starved by others. What came meanwhile lies in the socket. So time is counted in beats,
each of which counts for little however long it lasted, and nobody is called silent while anything
is unread.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

BEAT = 0.25
"""s; longest wait between two beats."""
COUNTED = 2 * BEAT
"""s; a beat that took longer, as the process stood still, counts for this."""


class Silence:
    """How long nothing was heard.

    Parameters
    ----------
    clock : callable, optional
        Monotonic seconds.

    Attributes
    ----------
    lasted : float, s
        Up to the last beat.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.heard()

    def heard(self) -> None:
        """Note that something came just now."""
        self.lasted, self._beat = 0.0, self._clock()

    def beat(self) -> float:
        """Count the time since the beat before, and return how long the silence has lasted, s."""
        now = self._clock()
        self.lasted += min(now - self._beat, COUNTED)
        self._beat = now
        return self.lasted


async def first_of(futures: set[asyncio.Future[Any]], within: float) -> bool:
    """Wait until one of the futures is done, for so many seconds in which this process runs.

    Returns
    -------
    bool
        Whether one is done.
    """
    silence = Silence()
    while silence.lasted < within:
        step = min(BEAT, within - silence.lasted)
        completed, _ = await asyncio.wait(
            futures, timeout=step, return_when=asyncio.FIRST_COMPLETED
        )
        if completed:
            return True
        silence.beat()
    return False
