# SPDX-License-Identifier: Apache-2.0
"""A tracker that is kept connected, configured and, if wanted, streaming, whatever happens.

One task lives as long as the session: connect, configure, wait until a stream is wanted, bring the
beam onto the reflector, start, watch; on trouble say so at once, mend it, go on.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from otf_core.model.observation import Samples
from otf_tracker_driver.clock.stamper import HostClock
from otf_tracker_driver.emscon import actions, codes, state
from otf_tracker_driver.emscon.codes import Command, Event, Status
from otf_tracker_driver.emscon.configure import MeasurementSetup, configure, unchanged
from otf_tracker_driver.emscon.errors import CommandRefused, LinkError, TrackerError
from otf_tracker_driver.emscon.intake import Intake
from otf_tracker_driver.emscon.link import Link, connected
from otf_tracker_driver.emscon.packets import (
    ErrorReport,
    Measurements,
    Packet,
    StatusChange,
    UnusedPacket,
)
from otf_tracker_driver.emscon.state import SessionState
from otf_tracker_driver.health import Beam, Flow, Hindrance
from otf_tracker_driver.silence import BEAT, Silence

T = TypeVar('T')

CONNECT_WITHIN = 2.0
"""s"""
FIRST_PAUSE, LONGEST_PAUSE = 0.2, 1.0
"""s; between attempts, doubled each time."""
SILENT_FOR, LONGEST_SILENCE = 1.0, 30.0
"""s; a tracker that streams sends packets three times per second, late by 60 ms at most. One that
sends nothing is started again after the first time, then after twice as long each time."""
SENDS_NOTHING = 'the tracker measures and sends nothing'
NOT_MEASURING = 'came while no measurement was under way'
NOT_CONFIRMED = 'settings not confirmed'
PASSING = frozenset({
    Status.BUSY, Status.NOT_INITIALISED, Status.NOT_READY, Status.MULTIPLE_CONNECTIONS,
    26, 38, 10004, 10005, 10012, 10015,
})  # fmt: skip
"""Refusals of a tracker that may be ready later."""
LINGERS = 3.0
"""s; a tracker may take a connection for open for a while after its end."""
HARMLESS = frozenset({0, 1, 2, 3, 7, 17, 19, 24, 25, 26, 27, 28, 30, 31, 145, 151, 850, 999})
"""Events that leave units and coordinates as they are."""
MOST_HELD = 100
"""Packets that wait for a setting to be read back."""


@dataclass(frozen=True)
class Address:
    """Where the tracker listens."""

    host: str
    port: int

    def __str__(self) -> str:
        """As people write it."""
        return f'{self.host}:{self.port}'


class Session:
    """Keeps one tracker at work; all methods belong to the thread of its event loop.

    Parameters
    ----------
    find : bool
        Whether the tracker may search for the reflector by itself.
    deliver : callable
        Takes stamped samples.

    Attributes
    ----------
    configured : asyncio.Event
        Set once the tracker has been configured.
    """

    def __init__(
        self,
        address: Address,
        wanted: MeasurementSetup,
        find: bool,
        deliver: Callable[[Samples], None],
    ) -> None:
        self._address, self._wanted, self._find = address, wanted, find
        self.state = SessionState()
        self.configured = asyncio.Event()
        self._clock = HostClock()
        self._intake = Intake(self.state, deliver)
        self._link: Link | None = None
        self._streaming = self._measuring = False
        self._wanted_stream = self._served_stream = 0
        self._since, self._starts, self._patience = time.monotonic(), 0, SILENT_FOR
        self._silence = Silence()
        self._wake = asyncio.Event()
        self._lost = ''
        self._doubt = self._closing = False
        self._operated = asyncio.Lock()
        self._held: list[tuple[Measurements, int]] = []
        self._made = _now()

    def stream(self, on: bool) -> None:
        """Set whether a stream is wanted; a new one has nothing to do with that before."""
        if on and not self._streaming:
            self._wanted_stream += 1
            self._intake.forget()
            self._lost = ''
            self._flow()
            self._starts = -1  # the first one is none again
            self._hinder(Flow.STARTING, state.BEING_STARTED)
        self._streaming = on
        self._wake.set()

    async def do(self, action: Callable[[Link], Awaitable[T]]) -> T:
        """Have the tracker do something while it does not measure."""
        if self._link is None or self.state.tracker is None:
            raise TrackerError(f'not connected: {self.state.trouble or "wait"}')
        async with self._operated:
            if self._measuring:
                raise TrackerError('the tracker is measuring; stop it first')
            return await action(self._link)

    async def use_reflector(self, name: str) -> str:
        """Set a reflector by its name, for this connection and those to come; return its name."""
        used = await self.do(actions.reflector(name))
        self._wanted = replace(self._wanted, reflector=used)
        if self.state.tracker is not None:
            self.state.tracker = replace(self.state.tracker, reflector=used)
        return used

    async def run(self) -> None:
        """Connect and keep at it; raises TrackerError only if the first attempt fails."""
        pause = FIRST_PAUSE
        while True:
            try:
                self.state.phase = state.CONNECTING
                arguments = self._unasked, self._clock.now_ns, CONNECT_WITHIN
                address = self._address
                async with connected(address.host, address.port, *arguments) as link:
                    await self._configure(link)
                    pause = FIRST_PAUSE
                    await self._serve(link)
            except TrackerError as error:
                self._count(self._link)
                if not self.configured.is_set() and not self._may_be_our_own(error):
                    raise self._first_failure(error) from None
                self.state.phase, self.state.beam = state.CONNECTING, Beam.UNKNOWN
                text = f'tracker at {self._address}: {error}; connecting again'
                self._hinder(Flow.NO_CONNECTION, text)
            finally:
                self._link = None
            await asyncio.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _first_failure(self, error: TrackerError) -> TrackerError:
        """Return the error with the address, as one that may pass if it may."""
        passing = isinstance(error, LinkError)
        passing |= isinstance(error, CommandRefused) and error.status in PASSING
        return (LinkError if passing else TrackerError)(f'tracker at {self._address}: {error}')

    def _may_be_our_own(self, error: TrackerError) -> bool:
        """Whether a tracker may just not have noticed that our last connection has ended."""
        refused = isinstance(error, CommandRefused) and error.status == Status.MULTIPLE_CONNECTIONS
        return refused and _now() - self._made < LINGERS

    async def _configure(self, link: Link) -> None:
        self.state.phase = state.CONFIGURING
        self.state.tracker = await configure(link, self._wanted, self._initialising)
        self.state.connections += 1
        self._doubt = self._closing = False
        self._link = link
        self.configured.set()

    def _initialising(self) -> None:
        self.state.phase = state.INITIALISING

    async def _serve(self, link: Link) -> None:
        """Stream whenever it is wanted; ends with an error only."""
        pause = FIRST_PAUSE
        while True:
            if not self._streaming:
                self.state.phase = state.READY
                if self.state.hindrance and self.state.hindrance.kind != Flow.STARTING:
                    self.state.hindrance = None  # a stream requested just now is not ended
                await self._pause(link, None)
                continue
            try:
                if await self._on_target(link):
                    await self._measure(link)
                pause = FIRST_PAUSE
            except CommandRefused as refused:
                self._hinder(Flow.SILENT, f'{refused}; trying again')
                if refused.status == Status.NOT_INITIALISED:
                    raise LinkError('the tracker is not initialised any more') from None
                await self._pause(link, pause)
                pause = min(2 * pause, LONGEST_SILENCE)

    async def _on_target(self, link: Link) -> bool:
        """Bring the beam onto the reflector; False if no stream is wanted any more."""
        pause = FIRST_PAUSE
        while self._streaming:
            seen = await _reflector_seen(link)
            if seen:
                return True
            self.state.phase = state.SEARCHING
            self._lose_beam()
            lost = self._lost or 'no reflector in the beam'
            if self._find:
                if pause == FIRST_PAUSE:
                    self._hinder(
                        Flow.BEAM_BROKEN, f'{lost}; the tracker searches for the reflector'
                    )
                try:
                    await link.ask(Command.FIND_REFLECTOR, self._intake.last_range or 3.0)
                    return True
                except CommandRefused as refused:
                    text = f'{lost}; searched in vain: {refused}; trying again'
                    self._hinder(Flow.BEAM_BROKEN, text)
            else:
                self._hinder(Flow.BEAM_BROKEN, f'{lost}; bring the beam back onto the reflector')
            await self._pause(link, pause)
            pause = min(2 * pause, LONGEST_PAUSE)
        return False

    async def _measure(self, link: Link) -> None:
        """Start, and watch until the stream is not wanted any more or breaks off."""
        try:
            await self._start(link)
            while self._wanted_still and not self._lost:
                await self._pause(link, BEAT)
                if self._doubt:
                    await self._settle_doubt(link)
                if self._silence.beat() > self._patience and not link.unread:
                    self._patience = min(2 * self._patience, LONGEST_SILENCE)
                    self._interrupt(Flow.SILENT, SENDS_NOTHING)
                    self._hinder(Flow.SILENT, f'{SENDS_NOTHING}; starting it again')
            with contextlib.suppress(CommandRefused):  # it may have stopped by itself
                await link.ask(Command.STOP_MEASUREMENT)  # what comes before the answer counts
        except LinkError as error:
            self._interrupt(Flow.NO_CONNECTION, str(error))
            raise
        except asyncio.CancelledError:
            link.tell(Command.STOP_MEASUREMENT)
            raise
        finally:
            self._measuring = False
            self._leave_out_held(NOT_CONFIRMED)
            if self._wanted_still:
                self._intake.end(self._lost)
            else:
                self._intake.drop()

    async def _start(self, link: Link) -> None:
        """Have the tracker measure."""
        async with self._operated:
            self._lost, self._held = '', []
            self._served_stream = self._wanted_stream
            self._intake.begin()
            self._measuring = True
            await link.ask(Command.START_MEASUREMENT)
            self._intake.started(link.asked_ns, link.answered_ns, link.sent_ns)
        self._starts += 1
        self.state.phase, self.state.beam = state.STREAMING, Beam.ON_TARGET
        if self.state.hindrance is not None:  # it may be flowing by now
            hindrance = self.state.hindrance
            self._hinder(hindrance.kind, hindrance.text)
        self._silence.heard()

    @property
    def _wanted_still(self) -> bool:
        """True if the stream that is served is still wanted, and not another one."""
        return self._streaming and self._served_stream == self._wanted_stream

    async def _settle_doubt(self, link: Link) -> None:
        """Read back what gives samples their meaning, after an event that may have changed it."""
        self._doubt = False
        changed = await unchanged(link)
        if not changed:
            held, self._held = self._held, []
            for packet, arrival_ns in held:
                self._intake.take(packet, arrival_ns)
            return
        self._leave_out_held(f'{changed} changed')
        raise LinkError(f'another program has changed the {changed}; set again')

    def _leave_out_held(self, reason: str) -> None:
        if self._held:
            self.state.left_out[reason] += sum(len(packet.status) for packet, _ in self._held)
        self._held = []

    async def _pause(self, link: Link, timeout: float | None) -> None:
        """Wait until something happens; LinkError if that is the end of the connection."""
        waking = asyncio.ensure_future(self._wake.wait())
        try:
            either: set[asyncio.Future[Any]] = {waking, link.ended}
            await asyncio.wait(either, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        finally:
            waking.cancel()
        self._wake.clear()
        self._count(link)
        if link.ended.done():
            raise LinkError(str(link.ended.exception()))
        if self._closing:
            raise LinkError('the server is closing')

    def _unasked(self, packet: Packet, arrival_ns: int) -> None:
        """Take what the tracker sends by itself; called from its connection."""
        if isinstance(packet, Measurements):
            self._samples(packet, arrival_ns)
        elif isinstance(packet, ErrorReport):
            if self._measuring:
                lost = packet.status == Status.BEAM_LOST
                if lost:
                    self._lose_beam()
                kind = Flow.BEAM_BROKEN if lost else Flow.SILENT
                self._interrupt(kind, codes.status_text(packet.status))
        elif isinstance(packet, StatusChange):
            self._closing |= packet.event == Event.SERVER_CLOSING
            self._doubt |= packet.event not in HARMLESS
            self._wake.set()
        elif isinstance(packet, UnusedPacket):
            self.state.unused += 1

    def _samples(self, packet: Measurements, arrival_ns: int) -> None:
        """Take samples, also those that come between an interruption and its end."""
        if not self._measuring:
            if self._streaming:
                self.state.left_out[NOT_MEASURING] += len(packet.status)
            return
        if not self._wanted_still:
            return
        self._silence.heard()
        if self._doubt:
            if len(self._held) >= MOST_HELD:
                self.state.left_out[NOT_CONFIRMED] += len(self._held.pop(0)[0].status)
            self._held.append((packet, arrival_ns))
            return
        before = self.state.samples
        if not self._intake.take(packet, arrival_ns):
            self._lose_beam()
            self._interrupt(Flow.BEAM_BROKEN, 'no reflector in any sample')
        elif self.state.samples > before:
            if not self._lost:
                self._flow()
        elif self._intake.waiting:  # with a clock that is known: for the next packet only
            if not self.state.clock.settled:
                text = "samples wait until the tracker's clock is known"
                self._hinder(Flow.WAITING_FOR_CLOCK, text)
        elif time.monotonic() - self._since > SILENT_FOR and not self._lost:
            self._hinder(Flow.SILENT, 'the tracker sends no sample that can be used')

    def _lose_beam(self) -> None:
        self.state.beam = Beam.SEARCHING if self._find else Beam.LOST

    def _flow(self) -> None:
        """Note that samples flow."""
        self.state.hindrance = None
        self._since, self._starts, self._patience = time.monotonic(), 0, SILENT_FOR

    def _hinder(self, kind: Flow, text: str) -> None:
        """Note what keeps samples from flowing."""
        self.state.hindrance = Hindrance(kind, text, self._since, max(0, self._starts))

    def _interrupt(self, kind: Flow, reason: str) -> None:
        """Note that the stream broke off."""
        if self._measuring and not self._lost:
            self._lost = reason
            self._hinder(kind, reason)
            self.state.phase = state.SEARCHING
        self._wake.set()

    def _count(self, link: Link | None) -> None:
        """Take over the counters of a connection."""
        if link is not None:
            self.state.unreadable += link.unreadable
            self.state.late_answers += link.late_answers
            link.unreadable = link.late_answers = 0


def _now() -> float:
    return asyncio.get_running_loop().time()


async def _reflector_seen(link: Link) -> bool:
    """Ask whether the tracker sees a reflector; servers that cannot tell are believed to."""
    try:
        _, bits = await link.ask(Command.GET_MEASUREMENT_STATUS)
    except CommandRefused:
        return True
    return bool(int(bits) & codes.REFLECTOR_SEEN)
