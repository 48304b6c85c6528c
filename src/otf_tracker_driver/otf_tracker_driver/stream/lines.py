# SPDX-License-Identifier: Apache-2.0
"""Points out of lines, and lines out of a byte stream; nothing in them is believed."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np

from otf_tracker_driver.stream.description import JSON, Description, Place

LONGEST = 4096
"""Bytes of a line; longer ones are left out."""
LATEST = 4.6e18
"""ns; differences of stamps beyond do not fit into 64 bits."""
FURTHEST = 200.0
"""m"""


class Lines:
    """Cuts a byte stream into lines; holds one unfinished line at most.

    Parameters
    ----------
    cut_in : bool
        The first bytes may be the end of a line, and are left out.

    Attributes
    ----------
    too_long : int
        Lines that were left out.
    partial : bool
        A line has begun that is not complete.
    """

    def __init__(self, cut_in: bool = False) -> None:
        self._held = b''
        self._skipping = cut_in
        self.too_long = 0
        self.partial = False

    def feed(self, chunk: bytes) -> Iterator[str]:
        """Take bytes; yield the lines that are complete, none of them empty."""
        *whole, rest = chunk.replace(b'\r', b'\n').split(b'\n')
        self.partial = bool(rest) or (self.partial and not whole)
        for part in whole:
            line, self._held = self._held + part, b''
            skipped, self._skipping = self._skipping, False
            if skipped or len(line) > LONGEST:
                self.too_long += not skipped
            elif line.strip():
                yield line.decode('utf-8', errors='replace').strip()
        if self._skipping or len(self._held) + len(rest) > LONGEST:
            self.too_long += not self._skipping
            self._skipping, self._held = True, b''
        else:
            self._held += rest


class Unreadable(Exception):
    """A line that holds no point; the message says why."""


def read_point(line: str, how: Description) -> tuple[int | None, tuple[float, float, float]]:
    """Read stamp and point of a line.

    Returns
    -------
    tuple
        Time of measurement, ns, or None; x, y, z, m.

    Raises
    ------
    Unreadable
    """
    values = _json(line) if how.format == JSON else _columns(line, how)
    first, second, third = (_number(_at(values, place), place) for place in how.point)
    if how.spherical:
        first, second, third = _cartesian(
            first * how.angle, second * how.angle, third, how.clockwise
        )
    x, y, z = (how.length * value for value in (first, second, third))
    if not 0.0 < math.sqrt(x * x + y * y + z * z) < FURTHEST:
        raise Unreadable(f'point ({x:g}, {y:g}, {z:g}) m is implausible; check length')
    if how.stamp is None:
        return None, (x, y, z)
    return _stamp(_at(values, how.stamp), how), (x, y, z)


def _columns(line: str, how: Description) -> list[str]:
    parts = [part.strip() for part in line.split(how.separator or None)]
    if how.decimal == '.':
        return parts
    # a point is none of theirs: it groups thousands, or the description is wrong
    return [part.replace('.', '_.').replace(how.decimal, '.') for part in parts]


def _json(line: str) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        raise Unreadable('no JSON') from None


def holds_one_object(datagram: bytes) -> bool:
    """Return whether all of a datagram is one JSON object, over however many lines."""
    try:
        return isinstance(json.loads(datagram), dict)
    except (ValueError, RecursionError):
        return False


def _at(values: object, place: Place) -> object:
    if isinstance(place, int):
        assert isinstance(values, list)
        if place >= len(values):
            raise Unreadable(f'column {place} is missing, there are {len(values)}')
        return values[place]
    for key in place.split('.'):
        if isinstance(values, dict) and key in values:
            values = values[key]
        elif isinstance(values, list) and key.isdecimal() and int(key) < len(values):
            values = values[int(key)]
        else:
            raise Unreadable(f'key {place} is missing')
    return values


def _number(value: object, place: Place) -> float:
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number):
            return number
    raise Unreadable(f'{"column" if isinstance(place, int) else "key"} {place} is not a number')


def _stamp(value: object, how: Description) -> int:
    """Time in ns; integers keep all their digits."""
    assert how.stamp is not None
    number = _number(value, how.stamp) * how.time
    if not abs(number) < LATEST:
        raise Unreadable('stamp is out of range')
    if isinstance(value, int) or (isinstance(value, str) and value.isdecimal()):
        return int(value) * how.time
    return round(number)


def _cartesian(
    azimuth: float, zenith: float, distance: float, clockwise: bool
) -> tuple[float, float, float]:
    sine = math.sin(zenith)
    y = distance * sine * math.sin(azimuth)
    return distance * sine * math.cos(azimuth), -y if clockwise else y, distance * math.cos(zenith)


def to_arrays(
    points: list[tuple[int | None, tuple[float, float, float]]], now_ns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,), ns, and points (n, 3), m; points without a stamp get the time of arrival."""
    stamps = [now_ns if stamp is None else stamp for stamp, _ in points]
    return np.array(stamps, np.int64), np.array([xyz for _, xyz in points])
