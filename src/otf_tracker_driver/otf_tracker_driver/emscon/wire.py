# SPDX-License-Identifier: Apache-2.0
"""A TCP connection within an event loop whose bytes come with their time of arrival."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

from otf_tracker_driver.clock.arrival import Arrivals
from otf_tracker_driver.emscon.errors import LinkError

CHUNK = 1 << 16
ENDED_WITHIN = 0.3
"""s"""
HINT = 'check that it is on and the address is correct'


class Wire:
    """An open connection; asyncio's own streams do not tell when bytes arrived.

    Parameters
    ----------
    opened : socket
        Connected, not blocking.
    """

    def __init__(self, opened: socket.socket) -> None:
        self._socket = opened
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._arrivals = Arrivals(opened)

    @property
    def unread(self) -> bool:
        """True if something, if only the end, is there to be read."""
        return self._arrivals.unread

    async def read(self, most: int) -> tuple[bytes, int]:
        """Return what has come and how long ago, ns; no bytes at the end. OSError if it broke.

        Asked for no more than a packet, it tells the age of each one of a backlog, as far as the
        kernel has kept them apart.
        """
        while True:
            try:
                data, age, _ = self._arrivals.receive(most)
                return data, age
            except BlockingIOError:
                await self._readable()

    def write(self, data: bytes) -> None:
        """Send a command; LinkError if the other side takes nothing any more."""
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise LinkError(f'connection lost ({error.strerror or error})') from None
        if sent < len(data):
            raise LinkError('the tracker takes no commands any more')

    async def end(self) -> None:
        """Let what was sent arrive: a socket that is closed with bytes unread resets its peer."""
        with contextlib.suppress(OSError, TimeoutError, asyncio.TimeoutError):
            self._socket.shutdown(socket.SHUT_WR)
            await asyncio.wait_for(self._rest(), ENDED_WITHIN)

    async def _rest(self) -> None:
        while (await self.read(CHUNK))[0]:
            pass

    async def _readable(self) -> None:
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()
        loop.add_reader(self._socket, lambda: ready.done() or ready.set_result(None))
        try:
            await ready
        finally:
            loop.remove_reader(self._socket)


@contextlib.asynccontextmanager
async def wired(host: str, port: int, within: float) -> AsyncIterator[Wire]:
    """Connect; the connection ends with the block.

    Raises
    ------
    LinkError
        If there is no connection within ``within`` s.
    """
    try:
        opened = await asyncio.wait_for(_connected(host, port), within)
    except (TimeoutError, asyncio.TimeoutError):
        raise LinkError(f'no connection within {within:g} s; {HINT}') from None
    except (OSError, UnicodeError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise LinkError(f'no connection ({reason}); {HINT}') from None
    with opened:
        wire = Wire(opened)
        try:
            yield wire
        finally:
            await wire.end()


async def _connected(host: str, port: int) -> socket.socket:
    """Connect to the first address of a host that can be reached."""
    loop = asyncio.get_running_loop()
    failed: OSError | None = None
    for family, kind, number, _, address in await loop.getaddrinfo(
        host, port, type=socket.SOCK_STREAM
    ):
        opened = socket.socket(family, kind, number)
        opened.setblocking(False)
        try:
            await loop.sock_connect(opened, address)
            return opened
        except OSError as error:
            opened.close()
            failed = error
        except BaseException:  # cancelled, too
            opened.close()
            raise
    assert failed is not None, 'getaddrinfo returns at least one address'
    raise failed
