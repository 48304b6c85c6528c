# SPDX-License-Identifier: Apache-2.0
"""Scales of axes, of dates and of colour: round steps, marks, classes and their keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import ArrayLike, NDArray

from otf_core.arrays import Array

ROUND = (1.0, 2.0, 5.0, 10.0)
FINE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
DECADE_MARKS, MIN_MARKS = 7, 2
"""Marks on a logarithmic scale beyond which only powers of ten are marked, below which
more of them; intervals on a linear one below which there are more."""
DAY = timedelta(days=1)
MONTHS = (1, 2, 3, 6, 12, 24, 60, 120)
LONGEST_BY_HOUR = 2
"""d; longer spans are marked by date."""
DAYS = (0.125, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Steps of dates."""
LEVELS = 6


@dataclass(frozen=True)
class Scale:
    """A linear or logarithmic scale.

    Attributes
    ----------
    low, high : float
        Ends; ``high`` above ``low``.
    label : str
        What is shown, with its unit.
    logarithmic : bool
    marks : int
        Marks wished for on a linear scale.
    named : tuple of (value, text)
        Marks in place of round values.
    """

    low: float
    high: float
    label: str
    logarithmic: bool = False
    marks: int = 4
    named: tuple[tuple[float, str], ...] = ()

    def place(self, values: ArrayLike) -> Array:
        """Share of the scale below values of any shape."""
        given = np.asarray(values, dtype=float)
        if self.logarithmic:
            given = np.log(np.maximum(given, 1e-300))
            low, high = math.log(self.low), math.log(self.high)
        else:
            low, high = self.low, self.high
        return np.asarray((given - low) / (high - low))

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Round values on the scale, and how they are written."""
        if self.named:
            return list(self.named)
        if self.logarithmic:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            found = [(m, m * 10.0**k) for k in powers for m in ROUND[:3]]
            inside = [(m, v) for m, v in found if self.low <= v <= self.high]
            if len(inside) < MIN_MARKS:
                fine = [m * 10.0**k for k in powers for m in FINE]
                return [(v, f'{v:g}') for v in fine if self.low <= v <= self.high]
            few = len(inside) <= DECADE_MARKS or self.high < 10.0 * self.low
            return [(v, f'{v:g}') for m, v in inside if few or m == 1.0]
        step = round_step((self.high - self.low) / self.marks)
        few = math.floor(self.high / step + 1e-9) - math.ceil(self.low / step - 1e-9) < MIN_MARKS
        if few and self.marks > MIN_MARKS:
            step = round_step(0.4 * step)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        return [
            (k * step, f'{k * step + 0.0:.{digits}f}'.replace('-', '\N{MINUS SIGN}'))
            for k in range(first, last + 1)
        ]


def round_step(wished: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below a wished step."""
    power = 10.0 ** math.floor(math.log10(max(wished, 1e-300)))
    return next(m * power for m in ROUND if m * power >= wished * (1.0 - 1e-9))


def round_below(wished: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a wished size."""
    power = 10.0 ** math.floor(math.log10(max(wished, 1e-300)) + 1e-12)
    return next(m * power for m in ROUND[2::-1] if m * power <= wished * (1.0 + 1e-9))


def around(values: ArrayLike, label: str, *, zero: bool = False, marks: int = 4) -> Scale:
    """Scale around values (NaN left out) with a little room; ``zero``: begins or ends there."""
    given = np.asarray(values, dtype=float)
    given = given[np.isfinite(given)]
    low, high = (float(given.min()), float(given.max())) if given.size else (0.0, 1.0)
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if high - low < 1e-9 * max(abs(high), abs(low), 1.0):
        low, high = low - 0.5, high + 0.5
    room = 0.05 * (high - low)
    below = 0.0 if zero and low == 0.0 else room
    above = 0.0 if zero and high == 0.0 else room
    return Scale(low - below, high + above, label, marks=marks)


def dates(first: datetime, last: datetime, marks: int = 5) -> Scale:
    """Scale of days since ``first``, marked at the beginnings of years, months or days.

    Parameters
    ----------
    first, last : datetime
        With the same time zone; what is drawn lies between them.
    marks : int
        At most; two at least where the days do not leave more.
    """
    span = max((last - first) / DAY, 1.0 / 24.0)
    low, high = -0.04 * span, 1.04 * span
    ends = first + low * DAY, first + high * DAY
    for step in MONTHS:
        count = (ends[1].year - ends[0].year) * 12 + ends[1].month - ends[0].month
        if count // step <= marks and count // step >= MIN_MARKS:
            text = '%Y' if step % 12 == 0 else '%Y-%m'
            found = _months(ends[0], ends[1], step)
            break
    else:
        text = '%m-%d' if span > LONGEST_BY_HOUR else '%H:%M'
        days = next((d for d in DAYS if span / d <= marks), count * 31 / marks)
        start = ends[0].replace(hour=0, minute=0, second=0, microsecond=0)
        count = int((ends[1] - start) / (days * DAY)) + 1
        found = [start + k * days * DAY for k in range(count)]
    named = [((m - first) / DAY, m.strftime(text)) for m in found if m >= ends[0]]
    label = {'%Y': 'year', '%Y-%m': 'month', '%m-%d': f'{first:%Y}, month-day'}
    return Scale(low, high, label.get(text, f'{first:%Y-%m-%d}'), named=tuple(named))


def _months(low: datetime, high: datetime, step: int) -> list[datetime]:
    """Beginnings of every so many months between two moments."""
    start = low.replace(day=1, hour=0, minute=0, second=0, microsecond=0)
    whole = start.year * 12 + start.month - 1
    numbers = range(-(-whole // step) * step, high.year * 12 + high.month, step)
    moments = [start.replace(year=n // 12, month=n % 12 + 1) for n in numbers]
    return [m for m in moments if low <= m <= high]


def decades(values: ArrayLike, label: str) -> Scale:
    """Logarithmic scale around positive values."""
    given = np.asarray(values, dtype=float)
    given = given[np.isfinite(given) & (given > 0)]
    low, high = (float(given.min()), float(given.max())) if given.size else (0.1, 1.0)
    return Scale(low / 1.15, high * 1.15, label, logarithmic=True)


def heat_step(values: Array) -> float:
    """Width of a class for values (n,): a round number of which six reach the largest."""
    top = float(np.max(values, initial=0.0))
    return round_step(top / LEVELS) if top > 0 else 1.0


def heat_classes(values: Array, step: float) -> NDArray[np.int64]:
    """Class of every value, 0 to 5, shape (n,)."""
    return np.clip((values / step).astype(np.int64), 0, LEVELS - 1)


def _spans(step: float, top: float) -> list[tuple[int, str]]:
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    used = min(LEVELS, int(top / step) + 1)
    return [(k, f'{k * step:.{digits}f} to {(k + 1) * step:.{digits}f}') for k in range(used)]


def heat_words(step: float, length: Array) -> list[tuple[int, str]]:
    """Classes up to the longest of lengths (n,), m, and what they stand for, um."""
    top = 1e6 * float(np.max(length, initial=0.0))
    return [(k, f'{said} µm') for k, said in _spans(step, top)]


def heat_key(step: float, top: float, unit: str) -> str:
    """Key of the classes up to ``top``, as markup."""
    keys = ''.join(
        f'<span class="h{k}"><span class="key"></span>{said} {unit}</span> '
        for k, said in _spans(step, top)
    )
    return f'<p class="soft keys">{keys}</p>'
