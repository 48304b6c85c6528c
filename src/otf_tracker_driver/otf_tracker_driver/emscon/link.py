# SPDX-License-Identifier: Apache-2.0
"""One connection to a tracker: commands with their answers, and whatever else it sends."""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import TypeVar

from otf_tracker_driver.emscon import codes, commands, packets
from otf_tracker_driver.emscon.codes import Command, Status
from otf_tracker_driver.emscon.commands import Value
from otf_tracker_driver.emscon.errors import CommandRefused, LinkError, TrackerError
from otf_tracker_driver.emscon.framing import Framer, ProtocolError
from otf_tracker_driver.emscon.wire import Wire, wired
from otf_tracker_driver.silence import first_of

T = TypeVar('T')
Values = tuple[Value, ...]
Unasked = Callable[[packets.Packet, int], None]

ANSWER_WITHIN = 5.0
"""s; for commands that move nothing."""
MOVED_WITHIN = 120.0
"""s; for commands that move the tracker or initialise it."""
SLOW = {Command.INITIALIZE, Command.CHANGE_FACE, Command.GO_BIRD_BATH, Command.FIND_REFLECTOR}
BUSY_FOR = 30.0
"""s; a tracker that is busy for longer is reported as busy."""
FIRST_BUSY_PAUSE, BUSY_PAUSE = 0.02, 0.2
"""s; until it is asked again, doubled each time."""
MOST_REFLECTORS = 200


class Link:
    """Sends commands, waits for their answers, and hands on what comes unasked.

    Parameters
    ----------
    unasked : callable
        Takes packets that answer nothing, and when their first byte arrived, ns; returns at once.
    now_ns : callable
        Time of the host.

    Attributes
    ----------
    ended : asyncio.Future
        Holds the LinkError that ended the connection.
    asked_ns, sent_ns, answered_ns : int
        Just before and just after the last command was sent, and when the last answer arrived, on
        the clock of ``now_ns``.
    unreadable, late_answers : int
        Packets that were framed but made no sense; answers that nobody waits for.
    """

    def __init__(self, wire: Wire, unasked: Unasked, now_ns: Callable[[], int]) -> None:
        self._wire = wire
        self._unasked, self._now_ns = unasked, now_ns
        self._waiting: dict[int, deque[asyncio.Queue[packets.Answer]]] = {}
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._heard = False
        self.asked_ns = self.sent_ns = self.answered_ns = 0
        self.unreadable = self.late_answers = 0

    @property
    def unread(self) -> bool:
        """True if the tracker has sent more than was read until now."""
        return self._wire.unread

    async def read(self) -> None:
        """Read until the connection ends; LinkError says why it did."""
        framer, reason = Framer(), 'the tracker closed the connection'
        begun_ns = 0
        try:
            while True:
                chunk, age_ns = await self._wire.read(framer.missing)
                if not chunk:
                    break
                arrival_ns = self._now_ns() - age_ns
                if not framer.partial:
                    begun_ns = arrival_ns
                for packet in framer.feed(chunk):
                    self._take(packet, begun_ns)
                    begun_ns = arrival_ns
        except ProtocolError as error:
            reason = f'{error}; is an emScon server listening there?'
        except OSError as error:
            reason = f'connection lost ({error.strerror or error})'
        except Exception as error:  # a defect: who waits for an answer gets it too
            traceback.print_exc()
            self._end(LinkError(f'internal error while reading: {error!r}'))
            raise
        if not self._heard:
            reason += ', before any answer; is another client connected?'
        lost = LinkError(reason)
        self._end(lost)
        raise lost

    def _end(self, lost: LinkError) -> None:
        if not self.ended.done():
            self.ended.set_exception(lost)
            self.ended.exception()  # retrieved: nobody may be waiting

    def _take(self, raw: bytes, arrival_ns: int) -> None:
        try:
            packet = packets.decode(raw)
        except ProtocolError:
            self.unreadable += 1
            return
        self._heard = True
        if isinstance(packet, packets.ErrorReport) and self._waiting.get(packet.command):
            packet = packets.Answer(packet.command, packet.status, b'')
        if not isinstance(packet, packets.Answer):
            self._unasked(packet, arrival_ns)
            return
        waiting = self._waiting.get(packet.command)
        if waiting and not waiting[0].full():
            self.answered_ns = arrival_ns
            waiting[0].put_nowait(packet)
        else:
            self.late_answers += 1

    async def ask(self, command: Command, *values: Value) -> Values:
        """Send a command and return the values of its answer; waits while the tracker is busy.

        Raises
        ------
        Refused
            If the tracker answers with an error.
        LinkError
            If there is no answer, or no connection.
        """
        return await self._patiently(command, values, partial(self._answer, command))

    def tell(self, command: Command) -> None:
        """Send a command without values whose answer does not matter any more."""
        with contextlib.suppress(LinkError):
            self._wire.write(commands.encode_request(command))

    async def reflectors(self) -> dict[int, str]:
        """Return number and name of all reflectors; each comes in an answer of its own."""
        return await self._patiently(Command.GET_REFLECTORS, (), self._list)

    async def _list(self, answers: asyncio.Queue[packets.Answer]) -> dict[int, str]:
        reflectors: dict[int, str] = {}
        for _ in range(MOST_REFLECTORS):
            total, number, _, _, name = await self._answer(Command.GET_REFLECTORS, answers)
            reflectors[int(number)] = str(name)
            if len(reflectors) >= int(total):
                return reflectors
        raise LinkError(f'the tracker lists more than {MOST_REFLECTORS} reflectors')

    async def _patiently(
        self,
        command: Command,
        values: Values,
        take: Callable[[asyncio.Queue[packets.Answer]], Awaitable[T]],
    ) -> T:
        """Send a command and take its answers; again while the tracker is busy."""
        loop = asyncio.get_running_loop()
        until, pause = loop.time() + BUSY_FOR, FIRST_BUSY_PAUSE
        while True:
            try:
                async with self._asked(command, values) as answers:
                    return await take(answers)
            except CommandRefused as refused:
                if refused.status != Status.BUSY or loop.time() > until:
                    raise
            await asyncio.sleep(pause)
            pause = min(2 * pause, BUSY_PAUSE)

    @contextlib.asynccontextmanager
    async def _asked(
        self, command: Command, values: Values
    ) -> AsyncIterator[asyncio.Queue[packets.Answer]]:
        """Send a command; its answers come in the queue until the block ends."""
        answers: asyncio.Queue[packets.Answer] = asyncio.Queue(MOST_REFLECTORS)
        waiting = self._waiting.setdefault(command, deque())
        waiting.append(answers)
        try:
            request = commands.encode_request(command, *values)
            self.asked_ns = self._now_ns()
            self._wire.write(request)
            self.sent_ns = self._now_ns()
            yield answers
        finally:
            waiting.remove(answers)

    async def _answer(self, command: Command, answers: asyncio.Queue[packets.Answer]) -> Values:
        limit = MOVED_WITHIN if command in SLOW else ANSWER_WITHIN
        got = asyncio.ensure_future(answers.get())
        try:
            await first_of({got, self.ended}, limit)
        finally:
            got.cancel()
        if got.cancelled() or not got.done():
            if self.ended.done():
                raise LinkError(str(self.ended.exception()))
            what = codes.command_text(command)
            raise LinkError(f'no answer to {what} within {limit:.0f} s; is it an emScon server?')
        answer = got.result()
        if answer.status != Status.OK:
            raise CommandRefused(command, answer.status)
        try:
            return commands.read_answer(command, answer.body)
        except ProtocolError as error:
            raise TrackerError(f'{error}; this version of the server is not known') from None


@contextlib.asynccontextmanager
async def connected(
    host: str, port: int, unasked: Unasked, now_ns: Callable[[], int], within: float
) -> AsyncIterator[Link]:
    """Connect; the connection ends with the block.

    Raises
    ------
    LinkError
        If there is no connection within ``within`` s, or it is lost inside the block.
    """
    async with wired(host, port, within) as wire:
        link = Link(wire, unasked, now_ns)
        reading = asyncio.ensure_future(link.read())
        try:
            yield link
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
