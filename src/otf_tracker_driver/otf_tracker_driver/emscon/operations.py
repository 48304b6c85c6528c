# SPDX-License-Identifier: Apache-2.0
"""What an operator asks of a tracker by name, and one sentence on what came of it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from otf_tracker_driver.emscon import actions
from otf_tracker_driver.emscon.link import Link

URAD = 1e6


async def _list(link: Link) -> str:
    return ', '.join(await actions.reflectors(link)) or 'the tracker knows no reflector'


async def _bird_bath(link: Link) -> str:
    await actions.bird_bath(link)
    return 'the beam is on the reflector in the bird bath, and the distance is set'


async def _find(link: Link) -> str:
    await actions.find_reflector(link)
    return 'the reflector is found'


async def _two_faces(link: Link) -> str:
    horizontal, vertical = (URAD * angle for angle in await actions.two_face_check(link))
    return (
        f'horizontal {horizontal:.2f} urad, vertical {vertical:.2f} urad: half the differences of '
        f'both faces, of a target at rest'
    )


async def _clear(link: Link) -> str:
    await actions.clear_errors(link)
    return 'commands that were waiting in the tracker are cleared'


OPERATIONS: dict[str, Callable[[Link], Awaitable[str]]] = {
    'list_reflectors': _list,
    'bird_bath': _bird_bath,
    'find_reflector': _find,
    'two_face_check': _two_faces,
    'clear_errors': _clear,
}
