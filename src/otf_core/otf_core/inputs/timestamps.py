# SPDX-License-Identifier: Apache-2.0
"""A column of times to int64 nanoseconds, without a detour over float64: numbers or moments.

Numbers are counts of a unit that is stated, or follows from the speed of the machine; days of a
spreadsheet; or dates and times of day that are written as one number. Moments: ``text_moments``.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import InputError
from otf_core.files.strict_yaml import shown
from otf_core.files.text_moments import (
    GLUED,
    ORDERS,
    SECOND_NS,
    MomentError,
    Moments,
    joined_without_zeros,
    read_moments,
    zeros_words,
)
from otf_core.files.units import LONG_TIMES, TIMES

Stamps = NDArray[np.int64]

USUAL_SPEED = 0.15
"""m/s, of machine tools that are measured."""
RATES = (0.5, 1e4)
"""Hz, that samples may have."""
GUESSED = ('s', 'ms', 'us', 'ns', 'days')
SECONDS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9, 'days': 86400.0}
FAST = 75.0
"""Percentile of the speeds that is taken for that of the machine."""
TOO_LARGE = 'a time does not fit into 64 bits of nanoseconds'
SPREADSHEET, MATLAB = (36_526, 54_789), (730_486, 748_749)
"""Days that spreadsheets (since 1899-12-30) and MATLAB count from 2000 to 2050."""
SPREADSHEET_1970, MATLAB_1970 = 25_569, 719_529


def is_number(text: str) -> bool:
    """Tell whether a text is a decimal number."""
    try:
        return Decimal(text).is_finite()
    except InvalidOperation:
        return False


def read_times(texts: Sequence[str], unit: str | None, xyz: Array, *, alone: bool) -> Moments:
    """Times of a column.

    Parameters
    ----------
    texts : sequence of str
    unit : str or None
        As stated; of dates their order.
    xyz : ndarray, shape (n, 3), m
        Points measured then, from which a unit that is not stated follows.
    alone : bool
        No other column is added to it.

    Raises
    ------
    MomentError
        If one is no time, or they can be read in two ways; says which and how.
    InputError
        If the unit is none of time.
    """
    if texts and not is_number(texts[0]):
        return _as_seen(read_moments(texts, unit if unit in ORDERS else None), xyz)
    if unit in TIMES:
        return _decimals(texts, TIMES[unit], unit or '')
    if unit in LONG_TIMES:
        return Moments(scaled_ns(texts, LONG_TIMES[unit]), unit or '')
    if unit is not None and unit not in ORDERS:
        raise InputError(
            f'{unit!r} is no unit of time that is read; possible: s, ms, us, ns, min, h, days'
        )
    written = _written_as_one(texts) if alone else None
    if written is not None:
        return written
    guess = _guessed(since_first(texts), xyz) if alone else 's'
    if guess == 'days':
        return _days(texts)
    return _decimals(texts, TIMES[guess], f'{guess} (not stated, by the speed)')


def _decimals(texts: Sequence[str], power: int, words: str) -> Moments:
    """Numbers of a unit; seconds whose parts have lost their leading zeros are repaired."""
    if power == 0 and all('.' in text for text in texts[:9]):
        parts = [text.partition('.')[::2] for text in texts]
        if all(whole.isdigit() and (part.isdigit() or not part) for whole, part in parts):
            seconds = np.array([int(whole) for whole, _ in parts], dtype=object) * SECOND_NS
            if max(seconds) < 2**62:
                whole_ns = seconds.astype(np.int64)
                repaired = joined_without_zeros(whole_ns, [part for _, part in parts])
                if repaired is not None:
                    return Moments(repaired[0], f'{words}{zeros_words(repaired[1])}')
    return Moments(decimals_ns(texts, power), words)


def _written_as_one(texts: Sequence[str]) -> Moments | None:
    """Dates and times of day, or times of day, that are written as one number; None: not so."""
    if all(GLUED.fullmatch(text) for text in texts):
        return read_moments(texts)
    parts = [text.partition('.')[::2] for text in texts]
    if not all(len(whole) in (5, 6) and whole.isdigit() for whole, _ in parts):
        return None
    whole_s = np.array([int(whole) for whole, _ in parts], np.int64)
    hours, minutes, seconds = whole_s // 10_000, whole_s // 100 % 100, whole_s % 100
    if hours.max() > 23 or minutes.max() > 59 or seconds.max() > 59:
        return None
    turns = np.diff(whole_s // 100) > 0
    if np.count_nonzero(turns) < 1 or np.any(np.diff(whole_s)[turns] < 100 - FULL_MINUTE):
        return None  # a count of seconds would pass 60 to 99
    if len({len(whole) for whole, _ in parts}) > 1 and whole_s.min() < 10_000 * 9:
        return None
    clock = (3600 * hours + 60 * minutes + seconds) * SECOND_NS
    digits = np.array([int(part[:9].ljust(9, '0')) if part else 0 for _, part in parts], np.int64)
    return Moments(clock + digits, 'hours, minutes and seconds as one number')


FULL_MINUTE = 60
"""Seconds: where a minute is full, the number of hours, minutes and seconds jumps by 40 more."""


def _days(texts: Sequence[str]) -> Moments:
    """Days and their parts, with a date where a spreadsheet or MATLAB counts them."""
    first = Decimal(texts[0])
    for (low, high), epoch, name in (
        (SPREADSHEET, SPREADSHEET_1970, 'a spreadsheet'),
        (MATLAB, MATLAB_1970, 'MATLAB'),
    ):
        if low <= first < high:
            return Moments(scaled_ns(texts, 86_400, epoch), f'days as {name} counts them')
    return Moments(scaled_ns(texts, 86_400), 'days (not stated, by the speed)')


def _as_seen(moments: Moments, xyz: Array) -> Moments:
    """Two numbers with a colon are minutes and seconds, or hours and minutes, by the speed."""
    if not moments.words.startswith('minutes and seconds'):
        return moments
    speed = _speed(1e-9 * (moments.stamp_ns - moments.stamp_ns[0]), xyz)
    if speed > 60.0**0.5 * USUAL_SPEED:
        return Moments(60 * moments.stamp_ns, 'hours and minutes (not stated, by the speed)')
    return Moments(moments.stamp_ns, f'{moments.words} (not stated, by the speed)')


def decimals_ns(texts: Sequence[str], power: int) -> Stamps:
    """Decimal numbers to ns, exactly.

    Parameters
    ----------
    texts : sequence of str
    power : int
        Of ten, that takes the numbers to s.

    Raises
    ------
    MomentError
        If one is no number, or too large for int64.
    """
    shift = power + 9
    try:
        return np.array([int(d.scaleb(shift)) for d in _numbers(texts)], dtype=np.int64)
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None


def scaled_ns(texts: Sequence[str], seconds: int, epoch: int = 0) -> Stamps:
    """Decimal numbers, less an epoch, of a unit of several seconds, to the nearest ns."""
    factor = seconds * SECOND_NS
    try:
        return np.array(
            [round((Fraction(d) - epoch) * factor) for d in _numbers(texts)], dtype=np.int64
        )
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None


def since_first(texts: Sequence[str]) -> Array:
    """Decimal numbers less the first of them, in their own unit; MomentError if one is none."""
    numbers = _numbers(texts)
    try:
        since = np.array([float(number - numbers[0]) for number in numbers])
    except ArithmeticError:
        raise MomentError(TOO_LARGE) from None
    if not np.isfinite(since).all():
        raise MomentError(TOO_LARGE)
    return since


def _numbers(texts: Sequence[str]) -> list[Decimal]:
    found = []
    for row, text in enumerate(texts):
        try:
            found.append(Decimal(text))
        except InvalidOperation:
            raise MomentError(f'{shown(text)} is no time', row) from None
        if not found[-1].is_finite():
            raise MomentError(f'{shown(text)} is no time', row)
    return found


def _speed(times: Array, xyz: Array) -> float:
    """Speed that the fast part of the motion has, m per unit of the times."""
    step = np.diff(times)
    if not np.any(step > 0):
        return 0.0
    moved = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return float(np.percentile(moved[step > 0] / step[step > 0], FAST))


def _guessed(times: Array, xyz: Array) -> str:
    """Unit of times, less the first, that makes the machine as fast as machines are."""
    step = np.diff(times)
    usual = float(np.median(step)) if len(step) else 0.0
    if usual <= 0:
        return 's'
    speed = _speed(times, xyz)
    fits = [u for u in GUESSED if RATES[0] <= 1.0 / (usual * SECONDS[u]) <= RATES[1]]
    if not fits or speed <= 0:
        return fits[0] if fits else 's'
    return min(fits, key=lambda u: abs(np.log(speed / SECONDS[u] / USUAL_SPEED)))
