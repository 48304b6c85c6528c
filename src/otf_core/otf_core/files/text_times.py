# SPDX-License-Identifier: Apache-2.0
"""Times of a text column to int64 nanoseconds, without a detour over float64.

Read are decimal numbers of a unit, dates and times of day as ISO 8601 writes them, and whatever
form of ``strptime`` is stated. Everything else is refused with the option that reads it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from datetime import date, datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import value_text

Stamps = NDArray[np.int64]

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
TIMES = {
    's': 0, 'sec': 0, 'secs': 0, 'second': 0, 'seconds': 0, 'sekunden': 0, 'ms': -3, 'msec': -3,
    'milliseconds': -3, 'us': -6, 'usec': -6, 'µs': -6, 'μs': -6, 'ns': -9, 'nsec': -9,
    'nsecs': -9, 'nanosec': -9,
}  # fmt: skip
"""Powers of ten, to s."""
LONG_TIMES = {'min': 60, 'minute': 60, 'minutes': 60, 'h': 3600, 'hour': 3600, 'hours': 3600,
              'day': 86400, 'days': 86400}  # fmt: skip
"""To s."""
GUESSED = {'s': 0, 'ms': -3, 'us': -6, 'ns': -9}
RATES = (0.5, 1e4)
"""Hz, that samples may have."""
SINCE_1970 = (1e9, 4e9)
"""s; numbers of this size count from 1970 on: 2001 to 2096."""
SPREADSHEET, SPREADSHEET_1970 = (36_526, 54_789), 25_569
"""Days that spreadsheets (since 1899-12-30) count from 2000 to 2050, and in 1970."""
ISO = re.compile(
    r'(?:(\d{4})-(\d\d)-(\d\d)[T ])?(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?'
    r'\s?(?:Z|UTC|([-+])(\d\d):?(\d\d))?',
    re.IGNORECASE,
)
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
MOST = Decimal(10) ** 19
"""Of any unit; more does not fit."""
TOO_LARGE = 'a time does not fit into 64 bits of nanoseconds'


class TimeTextError(ValueError):
    """A text that is not a time, or that can be read in several ways.

    Attributes
    ----------
    row : int or None
        Of the text, from 0; None: it is not that of one row.
    units : tuple of str
        Between which the texts leave the choice.
    """

    def __init__(self, message: str, row: int | None = None, units: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.row, self.units = row, tuple(units)


def read_times(
    texts: Sequence[str], unit: str | None = None, form: str | None = None
) -> tuple[Stamps, str]:
    """Times of a column, ns since 1970 (UTC) or since midnight, and how they were read.

    Parameters
    ----------
    unit : str, optional
        Of numbers.
    form : str, optional
        As ``strptime`` takes it; ``%f`` has any number of digits.

    Raises
    ------
    TimeTextError
        If one is not a time, or it is not stated what they are; says which option states it.
    ConfigError
        If ``form`` is none.
    """
    if form is not None:
        return _by_rows(texts, _reader(form)), f'the form {form}'
    if texts and not is_decimal(texts[0]):
        return _by_rows(texts, _iso), 'date and time' if texts[0][4:5] == '-' else 'time of day'
    if unit in LONG_TIMES:
        return _days_and_hours(texts, LONG_TIMES[unit]), unit or ''
    if unit is not None and unit not in TIMES:
        possible = 's, ms, us, ns, min, h, days'
        raise TimeTextError(f'{unit!r} is not a supported unit of time; possible: {possible}')
    numbers = _numbers(texts)
    words = unit or ''
    if unit is None:
        unit = _unit_by_size(numbers)
        words = f'{unit} (not stated, by their size)'
    return _integers(d.scaleb(TIMES[unit] + 9) for d in numbers), words


def is_decimal(text: str) -> bool:
    """Return whether a text is a decimal number."""
    try:
        return Decimal(text).is_finite()
    except InvalidOperation:
        return False


def _numbers(texts: Sequence[str]) -> list[Decimal]:
    numbers = []
    for row, text in enumerate(texts):
        if not is_decimal(text):
            raise TimeTextError(f'{value_text(text)} is not a number as the first is', row)
        numbers.append(Decimal(text))
    if any(abs(number) > MOST for number in (numbers[:1] + numbers[-1:])):
        raise TimeTextError(TOO_LARGE)
    return numbers


def _integers(numbers: Iterable[Decimal | int]) -> Stamps:
    try:
        return np.array([int(number) for number in numbers], dtype=np.int64)
    except ArithmeticError:
        raise TimeTextError(TOO_LARGE) from None


def _days_and_hours(texts: Sequence[str], seconds: int) -> Stamps:
    """Numbers of a unit of several seconds; days with their date if a spreadsheet counts them."""
    numbers = _numbers(texts)
    low, high = SPREADSHEET
    epoch = SPREADSHEET_1970 if seconds == 86_400 and low <= numbers[0] < high else 0
    return _integers(round((Fraction(d) - epoch) * seconds * SECOND_NS) for d in numbers)


def _unit_by_size(numbers: Sequence[Decimal]) -> str:
    """Unit of numbers whose heading states none: they count from 1970 on, or one rate fits."""
    first, step = abs(float(numbers[0])), 0.0
    low, high = SINCE_1970
    for unit, power in GUESSED.items():
        if low <= first * 10.0**power < high:
            return unit
    if len(numbers) > 1:
        step = float(np.median(np.diff([float(d - numbers[0]) for d in numbers])))
    low, high = RATES
    fits = [u for u, p in GUESSED.items() if step > 0 and low <= 1.0 / (step * 10.0**p) <= high]
    if len(fits) != 1:
        raise TimeTextError(
            f'the unit of {value_text(str(numbers[0]))}, in steps of {step:g}, is not stated',
            units=fits or tuple(GUESSED),
        )
    return fits[0]


def _by_rows(texts: Sequence[str], read: Callable[[str], tuple[bool, int]]) -> Stamps:
    """Times of all rows; those without a date go on past midnight."""
    stamps, dated = np.empty(len(texts), np.int64), False
    for row, text in enumerate(texts):
        try:
            has_date, stamps[row] = read(text)
        except ValueError as error:
            raise TimeTextError(f'{value_text(text)} {error}', row) from None
        if row and has_date != dated:
            has = 'a date, but the first has none' if has_date else 'no date, but the first has'
            raise TimeTextError(f'{value_text(text)} has {has}', row)
        dated = has_date
    if not dated and len(stamps) > 1:
        stamps[1:] += DAY_NS * np.cumsum(np.diff(stamps) < -DAY_NS // 2)
    return stamps


def _iso(text: str) -> tuple[bool, int]:
    """Whether a text has a date, and its time, ns; ValueError if it is not ISO 8601."""
    match = ISO.fullmatch(text)
    if match is None:
        raise ValueError(f'is not a time as ISO 8601 writes it; {form_hint(text)}')
    year, month, day, hours, minutes, seconds, part, sign, ahead_h, ahead_m = match.groups()
    if int(hours) > 24 or int(minutes) > 59 or int(seconds) > 60:
        raise ValueError('is not a time of day')
    whole = 3600 * int(hours) + 60 * int(minutes) + int(seconds)
    if sign:
        whole -= int(sign + '1') * (3600 * int(ahead_h) + 60 * int(ahead_m))
    if year:
        try:
            whole += 86_400 * (date(int(year), int(month), int(day)).toordinal() - 719_163)
        except ValueError:
            raise ValueError('has a day that does not exist') from None
    return bool(year), whole * SECOND_NS + _part_ns(part)


def _part_ns(digits: str | None) -> int:
    """Part of a second, from the digits behind its point."""
    return int((digits or '')[:9].ljust(9, '0'))


CLOCKS = ('%H:%M:%S.%f', '%H:%M:%S,%f', '%H:%M:%S:%f', '%H:%M:%S', '%I:%M:%S %p', '%I:%M:%S.%f %p')
DATES = (
    '%d.%m.%Y', '%d.%m.%y', '%m/%d/%Y', '%d/%m/%Y', '%m/%d/%y', '%d/%m/%y', '%Y/%m/%d', '%y-%m-%d',
    '%d-%m-%Y', '%d-%m-%y', '%d-%b-%Y', '%d %b %Y',
)  # fmt: skip
"""Forms that a message suggests where they suit."""


def form_hint(text: str) -> str:
    """State the option that reads such a text, with the forms that may be its own."""
    forms = [f'{date} {clock}' for date in DATES for clock in CLOCKS]
    forms += [f'%a %b %d {clock} %Y' for clock in CLOCKS] + list(CLOCKS)
    ways = [f'--time-format "{form}"' for form in forms if _suits(form, text)]
    words = ' or '.join(ways) or 'e.g. --time-format "%d.%m.%Y %H:%M:%S.%f"'
    return f'state its form: {words} (%d is the day, %m the month)'


def _suits(form: str, text: str) -> bool:
    try:
        _reader(form)(text)
    except ValueError:
        return False
    return True


DIRECTIVES = {'Y': r'\d{4}', 'j': r'\d{3}', 'f': r'(?P<part>\d+)', '%': '%'} | dict.fromkeys(
    'dmHIMSy', r'\d\d?'
)


def _reader(form: str) -> Callable[[str], tuple[bool, int]]:
    """Give the reader of texts of a form; ConfigError if it is none."""
    pattern = ''.join(
        DIRECTIVES.get(word[1:], '.+?') if word[0] == '%' else re.escape(word)
        for word in re.findall(r'%.|[^%]', form)
    )
    has_date = re.search('%[YyGcx]', form) is not None
    try:
        parts = re.compile(re.sub(r'(?:\\\s)+', r'\\s+', pattern))
        datetime.strptime('', form)
    except re.error:
        raise ConfigError(f'--time-format: {form!r} holds a word twice') from None
    except ValueError as error:
        if 'directive' in str(error) or 'stray' in str(error):
            raise ConfigError(f'--time-format: {form!r}: {error}') from None

    @lru_cache(maxsize=4096)
    def whole_ns(text: str) -> int:
        moment = datetime.strptime(text, form)
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=timezone.utc)
        zero = EPOCH if has_date else datetime(1900, 1, 1, tzinfo=timezone.utc)
        return (moment - zero) // timedelta(microseconds=1) * 1000

    def read(text: str) -> tuple[bool, int]:
        match, digits = parts.fullmatch(text), ''
        if match is not None and '%f' in form:
            digits = match['part']
            text = f'{text[: match.start("part")]}0{text[match.end("part") :]}'
        try:
            return has_date, whole_ns(text) + _part_ns(digits)
        except ValueError:
            raise ValueError(f'is not a time of the form {form} (--time-format)') from None

    return read
