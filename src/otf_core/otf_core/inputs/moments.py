# SPDX-License-Identifier: Apache-2.0
"""Times as text to int64 nanoseconds, without a detour over float64."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

CLOCK = re.compile(
    r'^(?:(?P<date>\d{1,4}[-./]\d{1,2}[-./]\d{1,4})[T\s]+)?'
    r'(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)(?:[.,](?P<part>\d+))?'
    r'(?:\s?(?P<half>[AP])M|Z|(?P<sign>[-+])(?P<zone_h>\d\d):?(?P<zone_m>\d\d))?$',
    re.IGNORECASE,
)
DAY_NS = 86_400_000_000_000
TOO_LARGE = 'a time does not fit into 64 bits of nanoseconds'
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def is_clock(text: str) -> bool:
    """Tell whether a text is a time of day, with or without a date."""
    return ':' in text


def clock_ns(text: str) -> int:
    """Nanoseconds since 1970 (UTC), or since midnight without a date; ValueError if it is no time.

    Dates are year first, or day first with points, or month first with strokes. An offset from
    UTC, as in ``+02:00``, is taken off.
    """
    match = CLOCK.match(text.strip())
    if match is None:
        raise ValueError(f'{text!r} is no time')
    part = (match['part'] or '')[:9].ljust(9, '0')
    hours = int(match['h'])
    if match['half']:
        hours = hours % 12 + (12 if match['half'] in 'Pp' else 0)
    seconds = 3600 * hours + 60 * int(match['m']) + int(match['s']) - _ahead_of_utc(match)
    return _midnight_ns(match['date']) + seconds * 1_000_000_000 + int(part)


def _ahead_of_utc(match: re.Match[str]) -> int:
    """Seconds by which a clock says more than UTC."""
    if match['sign'] is None:
        return 0
    seconds = 3600 * int(match['zone_h']) + 60 * int(match['zone_m'])
    return -seconds if match['sign'] == '-' else seconds


def _midnight_ns(date: str | None) -> int:
    if date is None:
        return 0
    first, second, third = (int(v) for v in re.split(r'[-./]', date))
    if first > 31:
        year, month, day = first, second, third
    elif '/' in date and first <= 12:
        month, day, year = first, second, third
    else:
        day, month, year = first, second, third
    year += 2000 if year < 100 else 0
    moment = datetime(year, month, day, tzinfo=timezone.utc)
    return (moment - EPOCH) // timedelta(days=1) * DAY_NS


def clocks_ns(texts: Sequence[str]) -> Stamps:
    """The same for many; those without a date go on after midnight."""
    found = np.array([clock_ns(text) for text in texts], dtype=np.int64)
    first = CLOCK.match(texts[0].strip()) if texts else None
    if first and first['date'] is None and len(found) > 1:
        back = np.diff(found) < -DAY_NS // 2
        found[1:] += DAY_NS * np.cumsum(back)
    return found


def decimals_ns(texts: Sequence[str], power: int) -> Stamps:
    """Decimal numbers to ns, exactly.

    Parameters
    ----------
    texts : sequence of str
    power : int
        Of ten, that takes the numbers to s.

    Raises
    ------
    ValueError
        If one is no number, or too large for int64.
    """
    shift = power + 9
    try:
        return np.array([int(d.scaleb(shift)) for d in _decimals(texts)], dtype=np.int64)
    except ArithmeticError:
        raise ValueError(TOO_LARGE) from None


def since_first(texts: Sequence[str]) -> Array:
    """Decimal numbers less the first of them, in their own unit; ValueError if one is none."""
    numbers = _decimals(texts)
    try:
        since = np.array([float(number - numbers[0]) for number in numbers])
    except ArithmeticError:
        raise ValueError(TOO_LARGE) from None
    if not np.isfinite(since).all():
        raise ValueError(TOO_LARGE)
    return since


def _decimals(texts: Sequence[str]) -> list[Decimal]:
    found = []
    for text in texts:
        try:
            found.append(Decimal(text))
        except InvalidOperation:
            raise ValueError(f'{text!r} is no time') from None
        if not found[-1].is_finite():
            raise ValueError(f'{text!r} is no time')
    return found
