# SPDX-License-Identifier: Apache-2.0
"""Times as texts: dates and times of day in the forms of many countries, to int64 nanoseconds.

A column is read by one rule: all with a date or none, one order of day, month and year, one sense
of the part of a second. Where the texts leave two readings, they are refused with both.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from otf_core.files.strict_yaml import value_text

Stamps = NDArray[np.int64]

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
EPOCH = date(1970, 1, 1).toordinal()
ORDERS = {'dmy': 'day, month, year', 'mdy': 'month, day, year', 'ymd': 'year, month, day'}
"""In which a date of three numbers may stand."""
CONTINUOUS_NS = DAY_NS // 2
"""Steps within a recording are smaller."""
FEWEST_JOINED = 10
"""Times from which on it shows that leading zeros are missing."""
CLOCK = re.compile(
    r'(?P<h>\d{1,3}):(?P<m>\d\d)(?::(?P<s>\d\d)(?:(?P<sign>[.,:])(?P<part>\d+))?(?![\d:])'
    r'|[.,](?P<decimal>\d+)(?![\d:]))'
)
"""A time of day; or minutes and decimal seconds, hours and decimal minutes."""
FRACTION = re.compile(r'(.*:\d\d:\d\d)[.,](\d+)((?:\D.*)?)')
"""A time of day with a part of a second."""
IRIG = re.compile(r'(?:(?P<year>\d{4}):)?(?P<day>\d{3}):(?=\d\d:\d\d:\d\d(?![\d:]))')
"""Day of the year before a time of day."""
GLUED = re.compile(
    r'(?P<date>(?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01]))(?P<link>[T_ -]?)'
    r'(?P<h>[01]\d|2[0-3])(?P<m>[0-5]\d)(?P<s>[0-5]\d)(?:[.,]?(?P<part>\d{1,9}))?(?![\d:])',
    re.IGNORECASE,
)
"""Date and time of day without signs between: 20251124T131501.250."""
DAY_OF_YEAR = re.compile(r'(?:(?P<year>\d{4})[-:/ ])?(?P<day>\d{3})$')
AFTER = re.compile(
    r'\s?(?:(?P<half>[AP])\.?\s?M\.?)?\s?'
    r'(?:Z|(?:UTC|GMT)?(?P<sign>[-+])(?P<h>\d\d?)(?::?(?P<m>\d\d))?|(?P<zone>[A-Z]{3,4}))?'
    r'(?:\s(?P<year>\d{4}))?',
    re.IGNORECASE,
)
"""What may follow a time of day; the year stands there in asctime."""
WEEKDAY = re.compile(r'^[^\W\d_]{2,10}[.,]?\s+(?=.*\d)')
NUMBERS = re.compile(r'(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})$')
DAY_FIRST = re.compile(r'(\d{1,2})[-./ ]{0,2}([^\W\d_]{3,10})[-./, ]{0,2}(\d{4}|\d\d)?$')
NAME_FIRST = re.compile(r'([^\W\d_]{3,10})[-./ ]{1,2}(\d{1,2})(?:[-./, ]{1,2}(\d{4}))?$')
YEAR_FIRST = re.compile(r'(\d{4})[-./ ]([^\W\d_]{3,10})[-./ ](\d{1,2})$')
ZONES = {
    'UTC': 0, 'GMT': 0, 'WET': 0, 'BST': 1, 'WEST': 1, 'CET': 1, 'MEZ': 1, 'CEST': 2, 'MESZ': 2,
    'EET': 2, 'EEST': 3, 'EST': -5, 'EDT': -4, 'CDT': -5, 'MST': -7, 'MDT': -6, 'PST': -8,
    'PDT': -7, 'JST': 9, 'KST': 9,
}  # fmt: skip
"""Hours ahead of UTC; without CST, which is two zones."""
MONTHS = (
    ('jan', 'ene', 'gen'), ('feb', 'fev'), ('mar', 'mrz'), ('apr', 'avr', 'abr'),
    ('may', 'mai', 'mag'), ('jun', 'juin', 'giu'), ('jul', 'juil', 'lug'), ('aug', 'aou', 'ago'),
    ('sep', 'set'), ('oct', 'okt', 'ott'), ('nov',), ('dec', 'dez', 'dic'),
)  # fmt: skip
"""Beginnings of their names in English, German, French, Spanish and Italian, without accents."""


class MomentError(ValueError):
    """A text that is not a time, or times that can be read in two ways.

    Attributes
    ----------
    row : int or None
        Of the text that is none, from 0; None: it is not that of one row.
    orders : tuple of str
        Of ``ORDERS``, between which the texts leave the choice.
    """

    def __init__(self, message: str, row: int | None = None, orders: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.row, self.orders = row, tuple(orders)


@dataclass(frozen=True)
class ColumnTimes:
    """Times of a column.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        Since 1970 (UTC), or since midnight without a date.
    words : str
        How they were read.
    """

    stamp_ns: Stamps
    words: str


@dataclass(frozen=True)
class _Date:
    """A date as it stands there: ``days`` since 1970, or three numbers of unknown order."""

    days: int | None = None
    numbers: tuple[int, int, int] | None = None
    sign: str = ''
    text: str = ''


@dataclass(frozen=True)
class _Text:
    """A time taken apart: date, whole seconds since midnight (UTC), part of a second as digits."""

    date: _Date | None
    seconds: int
    part: str
    form: str = ''


def is_moment(text: str) -> bool:
    """Return whether a text is a time of day, with or without a date, and no number."""
    if ':' not in text and not ('T' in text.upper() or '_' in text):
        return False
    try:
        _parted(_plain(text))
    except ValueError:
        return False
    return True


def read_moments(texts: Sequence[str], order: str | None = None) -> ColumnTimes:
    """Times of a column to ns.

    Parameters
    ----------
    order : str, optional
        Of the numbers of dates, of ``ORDERS``, where it is known.

    Raises
    ------
    MomentError
        If a text is not a time, or if they can be read in two ways; says how.
    """
    moments = []
    for row, text in enumerate(texts):
        try:
            moments.append(_read(text))
        except ValueError as error:
            raise MomentError(f'{value_text(text)} {error}', row) from None
    if not moments:
        return ColumnTimes(np.empty(0, np.int64), '')
    dated = [one.date is not None for one in moments]
    if len(set(dated)) > 1:
        row = dated.index(not dated[0])
        has = (
            'has no date, but those before it have'
            if dated[0]
            else 'has a date, but the first has none'
        )
        raise MomentError(f'{value_text(texts[row])} {has}', row)
    forms = {one.form for one in moments}
    if len(forms) > 1:
        row = next(k for k, one in enumerate(moments) if one.form != moments[0].form)
        raise MomentError(
            f'{value_text(texts[row])} has another form than {value_text(texts[0])}', row
        )
    seconds = np.array([one.seconds for one in moments], np.int64) * SECOND_NS
    words = moments[0].form or 'hours, minutes, seconds'
    if dated[0]:
        days, order_words = _days([one.date for one in moments if one.date], seconds, order)
        seconds = seconds + days * DAY_NS
        words = f'date ({order_words}) and time' if order_words else 'date and time'
    stamps, repaired = _with_parts(seconds, [one.part for one in moments], moments[0].form)
    if not dated[0] and len(stamps) > 1:
        stamps[1:] += DAY_NS * np.cumsum(np.diff(stamps) < -DAY_NS // 2)  # past midnight
    return ColumnTimes(stamps, f'{words}{repaired}')


def joined_without_zeros(whole_ns: Stamps, parts: Sequence[str]) -> tuple[Stamps, int] | None:
    """Parts of a second that were joined as integers, without their leading zeros.

    Parameters
    ----------
    whole_ns : ndarray of int64, shape (n,), ns
        Full seconds.
    parts : sequence of str
        Digits behind the decimal sign.

    Returns
    -------
    ndarray of int64 and int, or None
        Stamps in ns and the power of ten of the integers; None unless the parts as decimals go
        back, and as integers ascend.
    """
    longest = max(map(len, parts))
    places = next((k for k in (3, 6, 9) if longest <= k), 0)
    different = {len(part) for part in parts}
    if (
        len(parts) < FEWEST_JOINED
        or not places
        or len(different) < 2
        or any(p[:1] == '0' and len(p) > 1 for p in parts)
    ):
        return None
    decimal = whole_ns + np.array([int(p.ljust(9, '0')) if p else 0 for p in parts], np.int64)
    unit = 10 ** (9 - places)
    integer = whole_ns + unit * np.array([int(p) if p else 0 for p in parts], np.int64)
    if np.all(np.diff(decimal) >= 0) or np.any(np.diff(integer) < 0):
        return None
    return integer, -places


def _with_parts(whole_ns: Stamps, parts: Sequence[str], form: str) -> tuple[Stamps, str]:
    """Full seconds and their parts together, and in words what was repaired."""
    if form == 'hours, minutes, seconds, milliseconds':
        return whole_ns + 1_000_000 * np.array([int(p) for p in parts], np.int64), ''
    repaired = joined_without_zeros(whole_ns, parts)
    if repaired is not None:
        return repaired[0], zeros_words(repaired[1])
    digits = [int(part[:9].ljust(9, '0')) if part else 0 for part in parts]
    return whole_ns + np.array(digits, np.int64), ''


def zeros_words(power: int) -> str:
    """State that leading zeros were put back."""
    return f', the parts of a second as 10^{power} s, which had lost their leading zeros'


def _read(text: str) -> _Text:
    """Take a text apart; what many have in common, all but the part of a second, once."""
    match = FRACTION.fullmatch(text)
    if match is None:
        return _parted(_plain(text))
    before, part, after = match.groups()
    common = _common(before, after)
    return _Text(common.date, common.seconds, part)


@lru_cache(maxsize=4096)
def _common(before: str, after: str) -> _Text:
    return _parted(_plain(before + after))


def _plain(text: str) -> str:
    return ' '.join(text.replace('\u202f', ' ').replace('\xa0', ' ').split())


def _parted(text: str) -> _Text:
    """Take a text apart; ValueError says why it is not a time."""
    glued = GLUED.match(text)
    if glued is not None:
        day, ahead, _ = _after(text[glued.end() :])
        clock = _seconds(glued['h'], glued['m'], glued['s'], day)
        return _Text(_date(glued['date']), clock - ahead, glued['part'] or '', '')
    days = IRIG.match(text)
    if days is not None:
        rest = _parted(text[days.end() :])
        return _Text(_date(text[: days.end() - 1]), rest.seconds, rest.part, rest.form)
    match = CLOCK.search(text)
    if match is None:
        raise ValueError(_unread(text))
    before, at = text[: match.start()], match.start()
    if before[-1:].isdigit() or before[-1:] in (':', '+', '.') or before == '-':
        raise ValueError(_unread(text))
    half, ahead, year = _after(text[match.end() :])
    when = _date(text[:at].rstrip('T,_ -'), year) if before.strip() else None
    if match['decimal'] is not None:
        return _with_decimal(match, when, half)
    form = 'hours, minutes, seconds, milliseconds' if match['sign'] == ':' else ''
    if form and len(match['part']) != 3:
        raise ValueError('ends in a colon and digits: frames or milliseconds, which is not stated')
    clock = _seconds(match['h'], match['m'], match['s'], half)
    return _Text(when, clock - ahead, match['part'] or '', form)


def _unread(text: str) -> str:
    """State what a text that is not a time may be."""
    if re.fullmatch(r'\d{1,2}(:\d{1,2}){3}', text):
        return 'has four numbers: with days in front, or frames behind, which is not stated'
    return 'is not a time'


def _seconds(hours: str, minutes: str, seconds: str, half: str) -> int:
    """Seconds since midnight; ValueError if there is no such time."""
    h, m, s = int(hours), int(minutes), int(seconds)
    if h > 24 or m > 59 or s > 60 or (half and not 0 <= h <= 12):
        raise ValueError('is not a time of day')
    if half:
        h = h % 12 + (12 if half == 'P' else 0)
    return 3600 * h + 60 * m + s


def _with_decimal(match: re.Match[str], when: _Date | None, half: str) -> _Text:
    """Two numbers, the second with decimals: minutes and seconds as spreadsheets show them."""
    first, second = int(match['h']), int(match['m'])
    if when is not None or half:
        raise ValueError('has decimals of a minute; export hours, minutes and seconds')
    if second > 59:
        raise ValueError('is not a time')
    return _Text(None, 60 * first + second, match['decimal'], 'minutes and seconds')


@lru_cache(maxsize=4096)
def _after(text: str) -> tuple[str, int, str]:
    """Half of the day (A, P), seconds ahead of UTC, and year in what follows a time of day."""
    match = AFTER.fullmatch(text)
    if match is None:
        raise ValueError('is not a time')
    ahead = 0
    if match['zone']:
        zone = match['zone'].upper()
        if zone not in ZONES:
            raise ValueError(f'is in the time zone {zone}, which is not known; give UTC or +hh:mm')
        ahead = 3600 * ZONES[zone]
    elif match['sign']:
        ahead = 3600 * int(match['h']) + 60 * int(match['m'] or 0)
        ahead = -ahead if match['sign'] == '-' else ahead
    return (match['half'] or '').upper(), ahead, match['year'] or ''


@lru_cache(maxsize=4096)
def _date(text: str, year: str = '') -> _Date:
    """Take a date apart; ValueError if it is none."""
    bare = text.strip()
    if re.fullmatch(r'\d{8}', bare):
        return _Date(_day_number(int(bare[:4]), int(bare[4:6]), int(bare[6:])))
    if match := DAY_OF_YEAR.match(bare):
        days, number = int(match['day']), match['year'] or year
        if not 1 <= days <= 366:
            raise ValueError('has no day of a year')
        first = date(int(number), 1, 1).toordinal() - EPOCH if number else 0
        return _Date(first + days - 1)
    bare = WEEKDAY.sub('', bare) if not DAY_FIRST.match(bare) and not _is_month(bare) else bare
    if match := NUMBERS.match(bare):
        one, two, three = int(match[1]), int(match[3]), int(match[4])
        if len(match[1]) == 4:
            return _Date(_day_number(one, two, three))
        if len(match[4]) not in (2, 4) or len(match[1]) > 2:
            raise ValueError('has an unknown form of date')
        return _Date(None, (one, two, three), match[2], bare)
    if match := DAY_FIRST.match(bare):
        return _named(match[3] or year, match[2], match[1])
    if match := NAME_FIRST.match(bare):
        return _named(match[3] or year, match[1], match[2])
    if match := YEAR_FIRST.match(bare):
        return _named(match[1], match[2], match[3])
    raise ValueError('has an unknown form of date')


def _is_month(text: str) -> bool:
    try:
        _month(text.split()[0])
    except ValueError:
        return False
    return True


def _month(name: str) -> int:
    """Number of a month by the beginning of its name; ValueError if it is none."""
    plain = unicodedata.normalize('NFKD', name.lower())
    letters = ''.join(c for c in plain if c.isalpha())
    best = max(
        (len(begin), number)
        for number, begins in enumerate(MONTHS, start=1)
        for begin in (*begins, '')
        if letters.startswith(begin)
    )
    if best[0] < 3:
        raise ValueError(f'names no month ({name})')
    return best[1]


def _named(year: str, month: str, day: str) -> _Date:
    if not year:
        raise ValueError('has a date without a year')
    return _Date(_day_number(_full(int(year), len(year)), _month(month), int(day)))


def _full(year: int, digits: int) -> int:
    return year + 2000 if digits <= 2 else year


def _day_number(year: int, month: int, day: int) -> int:
    """Days since 1970; ValueError if there is no such day."""
    try:
        return date(year, month, day).toordinal() - EPOCH
    except ValueError:
        raise ValueError('has a day that does not exist') from None


def _days(
    dates: Sequence[_Date], seconds_ns: Stamps, order: str | None
) -> tuple[NDArray[np.int64], str]:
    """Days since 1970 of a column, and in words in which order they were read."""
    if all(one.days is not None for one in dates):
        return np.array([one.days for one in dates], np.int64), ''
    if any(one.days is not None for one in dates):
        row = next(
            k for k, one in enumerate(dates) if (one.days is None) != (dates[0].days is None)
        )
        raise MomentError('has a date of another form than the first', row)
    different = {one.numbers: one for one in dates if one.numbers}
    readings = {}
    for name in (order,) if order else ORDERS:
        try:
            of = {numbers: _ordered(numbers, one, name) for numbers, one in different.items()}
        except ValueError:
            continue
        readings[name] = np.array([of[one.numbers] for one in dates if one.numbers], np.int64)
    if not readings:
        raise MomentError(
            f'{dates[0].text!r} to {dates[-1].text!r}: no order of day, month and year fits all '
            f'lines{f" ({order} was requested)" if order else ""}'
        )
    good = {
        name: days
        for name, days in readings.items()
        if np.all(np.abs(np.diff(days * DAY_NS + seconds_ns)) < CONTINUOUS_NS)
    }
    readings = good or readings
    if len(readings) > 1 and len({days.tobytes() for days in readings.values()}) > 1:
        both = ' or '.join(
            f'{date.fromordinal(int(days[0]) + EPOCH).isoformat()} ({ORDERS[name]})'
            for name, days in readings.items()
        )
        raise MomentError(f'{dates[0].text!r} may be {both}', orders=list(readings))
    name, days = next(iter(readings.items()))
    return days, ORDERS[name]


def _ordered(numbers: tuple[int, int, int], one: _Date, order: str) -> int:
    """Days since 1970 of three numbers; ValueError if they are no date in this order."""
    digits = len(one.text.rpartition(one.sign)[2])
    if order == 'ymd' and digits == 4:
        raise ValueError('the year stands last')
    if order == 'mdy' and one.sign == '.':
        raise ValueError('no country uses this order')
    year, month, day = (numbers[order.index(letter)] for letter in 'ymd')
    return _day_number(_full(year, 2 if order == 'ymd' else digits), month, day)
