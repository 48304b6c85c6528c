# SPDX-License-Identifier: Apache-2.0
"""What follows the number of a command, and the result code of its answer: little-endian, packed.

``i`` is an int32, ``d`` a double, ``64s`` a text of 32 UTF-16 units.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from otf_tracker_driver.emscon.codes import Command, PacketType, command_text
from otf_tracker_driver.emscon.framing import ProtocolError
from otf_tracker_driver.emscon.packets import COMMAND, encode_answer

Value = int | float | str
C = Command


@dataclass(frozen=True)
class Layout:
    """Fields of a request and of its answer."""

    request: str = ''
    answer: str = ''


def _pair(set_: Command, get: Command, fields: str) -> dict[Command, Layout]:
    return {set_: Layout(fields), get: Layout('', fields)}


LAYOUTS: dict[Command, Layout] = {
    **{command: Layout() for command in Command},
    C.GET_SYSTEM_STATUS: Layout('', '10i'),
    C.GET_TRACKER_STATUS: Layout('', 'i'),
    **_pair(C.SET_UNITS, C.GET_UNITS, '5i'),
    C.GET_STATION_ORIENTATION: Layout('', '6d'),
    C.GET_TRANSFORMATION: Layout('', '7d'),
    **_pair(C.SET_ENVIRONMENT, C.GET_ENVIRONMENT, '3d'),
    **_pair(C.SET_MEASUREMENT_MODE, C.GET_MEASUREMENT_MODE, 'i'),
    **_pair(C.SET_COORDINATE_SYSTEM, C.GET_COORDINATE_SYSTEM, 'i'),
    **_pair(C.SET_CONTINUOUS_TIME, C.GET_CONTINUOUS_TIME, '4i'),
    **_pair(C.SET_REFLECTOR, C.GET_REFLECTOR, 'i'),
    C.GET_REFLECTORS: Layout('', '3id64s'),
    **_pair(C.SET_SYSTEM_SETTINGS, C.GET_SYSTEM_SETTINGS, '9i'),
    C.FIND_REFLECTOR: Layout('d'),
    C.GET_DIRECTION: Layout('', '2d'),
    **_pair(C.SET_STATISTIC_MODE, C.GET_STATISTIC_MODE, '2i'),
    C.GET_FACE: Layout('', 'i'),
    C.GET_MEASUREMENT_STATUS: Layout('', '2i'),
    C.CLEAR_COMMAND_QUEUE: Layout('i'),
    C.GET_TRACKER_INFO: Layout('', 'i64s5i3d2i2d3i'),
    C.GET_SOFTWARE_VERSION: Layout('', '64s'),
}


def encode_request(command: Command, *values: Value) -> bytes:
    """Return the packet of a command with its values."""
    body = _pack(LAYOUTS[command].request, values)
    return COMMAND.pack(COMMAND.size + len(body), PacketType.COMMAND, command) + body


def read_answer(command: Command, body: bytes) -> tuple[Value, ...]:
    """Read what follows the result code of an answer; newer servers may append to it.

    Raises
    ------
    ProtocolError
        If it is too short.
    """
    return _unpack(LAYOUTS[command].answer, body, f'answer to {command_text(command)}')


def read_request(packet: bytes) -> tuple[int, bytes]:
    """Return number of a command and what follows it; ProtocolError if it is too short."""
    if len(packet) < COMMAND.size:
        raise ProtocolError(f'command of {len(packet)} bytes')
    return COMMAND.unpack_from(packet)[2], packet[COMMAND.size :]


def request_values(command: Command, body: bytes) -> tuple[Value, ...]:
    """Read the values of a command; ProtocolError if there are too few."""
    return _unpack(LAYOUTS[command].request, body, command_text(command))


def answer(command: Command, status: int, *values: Value) -> bytes:
    """Return the packet of an answer; with an error status it holds no values."""
    body = _pack(LAYOUTS[command].answer, values) if status == 0 else b''
    return encode_answer(command, status, body)


def _pack(fields: str, values: tuple[Value, ...]) -> bytes:
    packed = [v.encode('utf-16-le')[:62] if isinstance(v, str) else v for v in values]
    return struct.pack(f'<{fields}', *packed)


def _unpack(fields: str, body: bytes, what: str) -> tuple[Value, ...]:
    layout = struct.Struct(f'<{fields}')
    if len(body) < layout.size:
        raise ProtocolError(f'{what}: {len(body)} bytes, {layout.size} needed')
    return tuple(_text(v) if isinstance(v, bytes) else v for v in layout.unpack_from(body))


def _text(raw: bytes) -> str:
    """Text up to its NUL, in one printable line."""
    text = raw.decode('utf-16-le', errors='replace').partition('\0')[0]
    return ''.join(c if c.isprintable() else '?' for c in text)
