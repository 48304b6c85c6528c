# SPDX-License-Identifier: Apache-2.0
"""What an operator may ask of a tracker that does not stream; each takes the connection."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence

from otf_tracker_driver.emscon import configure
from otf_tracker_driver.emscon.codes import Command
from otf_tracker_driver.emscon.commands import Value
from otf_tracker_driver.emscon.link import Link

SEARCH_DISTANCE = 3.0
"""m; where a search begins if nothing better is known."""


async def reflectors(link: Link) -> tuple[str, ...]:
    """Names of the reflectors that the tracker knows."""
    return tuple((await link.reflectors()).values())


def reflector(name: str) -> Callable[[Link], Awaitable[str]]:
    """Set a reflector by its name; the action returns the one that is set then."""

    async def action(link: Link) -> str:
        return (await configure.set_reflector(link, name))[0]

    return action


async def bird_bath(link: Link) -> None:
    """Point to the home position; sets the distance from a reflector that lies there."""
    await link.ask(Command.GO_BIRD_BATH)


async def find_reflector(link: Link) -> None:
    """Search for the reflector around the present direction."""
    await link.ask(Command.FIND_REFLECTOR, SEARCH_DISTANCE)


async def clear_errors(link: Link) -> None:
    """Forget the commands of this client that still wait in the tracker."""
    await link.ask(Command.CLEAR_COMMAND_QUEUE, 0)


async def two_face_check(link: Link) -> tuple[float, float]:
    """Measure a target that stands still in both faces.

    Returns
    -------
    tuple of float
        Half the difference, face the tracker was in less the other, of horizontal and vertical
        angle, rad.
    """
    first = await link.ask(Command.GET_DIRECTION)
    await link.ask(Command.CHANGE_FACE)
    second = await link.ask(Command.GET_DIRECTION)
    await link.ask(Command.CHANGE_FACE)
    horizontal, vertical = (float(angle) for angle in second)
    # a server may give the angles of the second face as its circles show them
    readings = (horizontal, vertical), (horizontal + math.pi, -vertical)
    apart = [_difference(first, reading) for reading in readings]
    horizontal, vertical = min(apart, key=lambda pair: math.hypot(*pair))
    return horizontal / 2, vertical / 2


def _difference(first: Sequence[Value], second: Sequence[Value]) -> tuple[float, float]:
    horizontal, vertical = (
        math.remainder(float(a) - float(b), 2 * math.pi)
        for a, b in zip(first, second, strict=True)
    )
    return horizontal, vertical
