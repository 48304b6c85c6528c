# SPDX-License-Identifier: Apache-2.0
"""A tracker session in a thread of its own: nobody else ever waits for the network."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
import traceback
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import Future
from typing import TypeVar

from otf_core.model.observation import Samples
from otf_tracker_driver.emscon.configure import MeasurementSetup
from otf_tracker_driver.emscon.errors import TrackerError
from otf_tracker_driver.emscon.link import Link
from otf_tracker_driver.emscon.session import Address, Session
from otf_tracker_driver.emscon.state import BEING_STARTED, SessionState
from otf_tracker_driver.health import Flow, Hindrance

T = TypeVar('T')

ENDED_WITHIN = 5.0
"""s"""
MOST_HELD = 10_000
"""Packets that wait to be fetched, an hour of a tracker; the oldest are left out beyond."""
NOT_FETCHED = 'not fetched in time'


class SessionThread:
    """Runs a session; every method returns at once.

    Parameters
    ----------
    find : bool
        Whether the tracker may search for the reflector by itself.
    """

    def __init__(self, address: Address, wanted: MeasurementSetup, find: bool) -> None:
        self._address, self._wanted, self._find = address, wanted, find
        self._samples: deque[Samples] = deque()
        self._made = threading.Event()
        self._session: Session | None = None
        self._run: Future[None] = Future()
        self._thread = threading.Thread(target=self._work, name='emscon', daemon=True)
        self._thread.start()
        self._made.wait()

    @property
    def state(self) -> SessionState:
        """What the session does and has seen."""
        assert self._session is not None
        return self._session.state

    @property
    def configured(self) -> bool:
        """True once the tracker has been configured; TrackerError if it never will be."""
        if self._run.done():
            self._run.result()
        assert self._session is not None
        return self._session.configured.is_set()

    def stream(self, on: bool) -> None:
        """Start or stop a stream; what was not fetched of the one before is forgotten."""
        if on:  # until the session's thread comes to it
            starting = Hindrance(Flow.STARTING, BEING_STARTED, time.monotonic())
            self.state.hindrance = starting
        self._call(self._switch, on)

    def fetch(self) -> list[Samples]:
        """Samples that have come since the last call."""
        parts = []
        while self._samples:
            parts.append(self._samples.popleft())
        return parts

    def do(self, action: Callable[[Link], Awaitable[T]]) -> Future[T]:
        """Have the tracker do something while it does not measure; see actions.py."""
        return self._within(lambda session: session.do(action))

    def use_reflector(self, name: str) -> Future[str]:
        """Set a reflector by its name; the result is the name of the one that is set."""
        return self._within(lambda session: session.use_reflector(name))

    def _within(self, work: Callable[[Session], Coroutine[None, None, T]]) -> Future[T]:
        """Run a coroutine in the session's thread; what has ended raises why it did."""
        if self._run.done():
            self._run.result()
        assert self._session is not None
        return asyncio.run_coroutine_threadsafe(work(self._session), self._loop)

    def close(self) -> None:
        """Stop the measurement, disconnect, end the thread."""
        self._call(self._end)
        self._thread.join(ENDED_WITHIN)

    def _call(self, function: Callable[..., None], *arguments: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended by itself
            self._loop.call_soon_threadsafe(function, *arguments)

    def _switch(self, on: bool) -> None:
        assert self._session is not None
        self._samples.clear()
        self._streaming = on
        self._session.stream(on)

    def _end(self) -> None:
        self._task.cancel()

    def _work(self) -> None:
        asyncio.run(self._main())

    async def _main(self) -> None:
        self._loop, self._streaming = asyncio.get_running_loop(), False
        self._session = Session(self._address, self._wanted, self._find, self._take)
        self._task = asyncio.ensure_future(self._session.run())
        self._task.add_done_callback(self._ended)
        self._made.set()
        await asyncio.wait({self._task})

    def _ended(self, task: asyncio.Task[None]) -> None:
        """Keep why the session has ended, for whoever asks next."""
        reason = TrackerError('disconnected') if task.cancelled() else task.exception()
        if not isinstance(reason, TrackerError):
            traceback.print_exception(reason)
            reason = TrackerError(f'internal error of the connection: {reason!r}')
        self._run.set_exception(reason)

    def _take(self, samples: Samples) -> None:
        if not self._streaming:
            return
        if len(self._samples) == MOST_HELD:
            self.state.left_out[NOT_FETCHED] += len(self._samples.popleft())
        self._samples.append(samples)
