# SPDX-License-Identifier: Apache-2.0
"""Description of a source of points: where it is, how its lines look, which units; a YAML file.

See docs/tracker-protocol.md for every key, and two examples that are tried.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from otf_core.files.strict_yaml import Fields, read_yaml, value_text

LENGTHS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'in': 0.0254, 'ft': 0.3048}
ANGLES = {'rad': 1.0, 'deg': math.pi / 180, 'gon': math.pi / 200}
TIMES = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
HOST = 'host'
"""In place of the stamp: samples are stamped when they arrive."""
CARTESIAN = ('x', 'y', 'z')
SPHERICAL = ('azimuth', 'zenith', 'distance')
TEXT, JSON = 'text', 'json'
DECIMALS = ('.', ',')
BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
SENSES = ('clockwise', 'counterclockwise')
MOST_COLUMNS = 1000
REQUIRED = ('source', 'format', 'columns', 'keys', 'length', 'stamp')
OPTIONAL = ('time', 'separator', 'decimal', 'angle', 'azimuth_sense', 'peer', 'start', 'stop')
Place = int | str
"""Number of a column, from 0; or key in JSON, points between keys that lie in each other."""


@dataclass(frozen=True)
class Source:
    """Where lines come from.

    Attributes
    ----------
    kind : str
        'tcp', 'udp' or 'serial'.
    host : str
        Address to connect to, or to listen on; device file of a serial line.
    port : int
        TCP or UDP port, or baud rate.
    """

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        """As people write it."""
        return f'{self.kind}://{self.host}:{self.port}'


@dataclass(frozen=True)
class Description:
    """How to reach a source and to read its lines.

    Attributes
    ----------
    format : str
        'text' or 'json'.
    separator : str
        Between columns; empty: any white space.
    decimal : str
        Of numbers in text: '.' or ','.
    point : tuple
        Places of x, y, z; or of azimuth, zenith and distance if ``spherical``.
    clockwise : bool
        Azimuth grows clockwise, seen from above.
    stamp : int, str or None
        Place of the time of measurement; None: stamped on arrival.
    length, angle : float
        Metres and radians per unit.
    time : int
        Nanoseconds per unit.
    peer : str
        Only datagrams from this address are taken; empty: from anyone.
    start, stop : str
        Sent when a stream starts and ends; empty: nothing.
    """

    source: Source
    format: str
    separator: str
    decimal: str
    point: tuple[Place, Place, Place]
    spherical: bool
    clockwise: bool
    stamp: Place | None
    length: float
    angle: float
    time: int
    peer: str
    start: str
    stop: str


def read_description(path: str | Path) -> Description:
    """Read a description.

    Raises
    ------
    ConfigError
        Names file and key, what it holds and what is possible.
    """
    top = Fields(read_yaml(path), str(path))
    source = _source(top)
    kind = _choice(top, 'format', (TEXT, JSON))
    separator = _separator(top) if kind == TEXT and top.has('separator') else ''
    decimal = _choice(top, 'decimal', DECIMALS) if kind == TEXT and top.has('decimal') else '.'
    if decimal == separator:
        top.fail('decimal', f'{value_text(decimal)} separates the columns, too')
    columns = top.mapping('columns' if kind == TEXT else 'keys')
    spherical = not columns.has('x') and columns.has('azimuth')
    names = SPHERICAL if spherical else CARTESIAN
    first, second, third = (_place(columns, name, kind) for name in names)
    columns.done()
    stamp = _stamp(top, kind)
    length = LENGTHS[_choice(top, 'length', tuple(LENGTHS))]
    angle = ANGLES[_choice(top, 'angle', tuple(ANGLES))] if spherical else 1.0
    clockwise = spherical and _choice(top, 'azimuth_sense', SENSES) == SENSES[0]
    time = TIMES[_choice(top, 'time', tuple(TIMES))] if stamp is not None else 1
    peer = top.text('peer') if source.kind == 'udp' and top.has('peer') else ''
    start, stop = (_escaped(top.text(k)) if top.has(k) else '' for k in ('start', 'stop'))
    top.done(known=(*REQUIRED, *OPTIONAL))
    point = first, second, third
    return Description(
        source, kind, separator, decimal, point, spherical, clockwise, stamp, length, angle, time,
        peer, start, stop,
    )  # fmt: skip


def _source(top: Fields) -> Source:
    text = top.text('source')
    address = re.fullmatch(r'(tcp|udp|serial)://(.+):(\d{1,7})', text)
    if not address:
        top.fail('source', f'{value_text(text)}; give tcp://HOST:PORT, '
                 f'udp://ADDRESS:PORT (listens there) or '
                 f'serial:///dev/ttyUSB0:115200')  # fmt: skip
    kind, host, port = address[1], address[2], int(address[3])
    if kind == 'serial' and port not in BAUDS:
        top.fail('source', f'{port} baud; possible: {", ".join(map(str, BAUDS))}')
    if kind != 'serial' and not 0 < port < 65536:
        top.fail('source', f'port {port}; possible: 1 to 65535')
    return Source(kind, host, port)


def _separator(top: Fields) -> str:
    value = top.take('separator')
    if not isinstance(value, str) or not value:
        top.fail('separator', f'expected text, got {value_text(value)}')
    return _escaped(value)


def _choice(fields: Fields, key: str, possible: Sequence[str]) -> str:
    text = fields.text(key)
    if text not in possible:
        fields.fail(key, f'{value_text(text)}; possible: {", ".join(possible)}')
    return text


def _stamp(top: Fields, kind: str) -> Place | None:
    """Place of the stamp; None if samples are to be stamped on arrival."""
    value = top.take('stamp')
    return None if value == HOST else _checked(top, 'stamp', value, kind)


def _place(fields: Fields, key: str, kind: str) -> Place:
    return _checked(fields, key, fields.take(key), kind)


def _checked(fields: Fields, key: str, value: object, kind: str) -> Place:
    if kind == JSON:
        if isinstance(value, str) and value:
            return value
        fields.fail(key, f'{value_text(value)}; give its key in the JSON object, such as pose.x')
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MOST_COLUMNS:
        return value
    fields.fail(key, f'{value_text(value)}; give the number of its column, the first is 0')


def _escaped(text: str) -> str:
    return text.replace('\\r', '\r').replace('\\n', '\n').replace('\\t', '\t')
