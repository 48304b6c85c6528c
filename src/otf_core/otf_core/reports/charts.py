# SPDX-License-Identifier: Apache-2.0
"""Pictures with two axes or bars: scales, marks in data coordinates, several in a sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import ArrayLike, NDArray

from otf_core.arrays import Array
from otf_core.reports.rendering import escaped

# Scales of axes, of dates and of colour: round steps, marks, classes and their keys.

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
            marks = [(m, m * 10.0**k) for k in powers for m in ROUND[:3]]
            inside = [(m, v) for m, v in marks if self.low <= v <= self.high]
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


def scale_around(values: ArrayLike, label: str, *, zero: bool = False, marks: int = 4) -> Scale:
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
            moments = _months(ends[0], ends[1], step)
            break
    else:
        text = '%m-%d' if span > LONGEST_BY_HOUR else '%H:%M'
        days = next((d for d in DAYS if span / d <= marks), count * 31 / marks)
        start = ends[0].replace(hour=0, minute=0, second=0, microsecond=0)
        count = int((ends[1] - start) / (days * DAY)) + 1
        moments = [start + k * days * DAY for k in range(count)]
    named = [((m - first) / DAY, m.strftime(text)) for m in moments if m >= ends[0]]
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


def heat_key(step: float, top: float, unit: str) -> str:
    """Key of the classes up to ``top``, as markup."""
    keys = ''.join(
        f'<span class="h{k}"><span class="key"></span>{span} {unit}</span> '
        for k, span in _spans(step, top)
    )
    return f'<p class="soft keys">{keys}</p>'


# A picture with two axes: marks in data coordinates become an ``svg`` element.
#
# Marks carry a class for their colour and stroke (``style.STYLE``); nothing here names a colour.

HEAD, SPREAD = 5.0, 0.45
"""px and rad; length and half opening of arrow heads."""


def polyline(points: Array, *, closed: bool = False) -> str:
    """Path data through points, shape (n, 2), px."""
    if not len(points):
        return ''
    text = ('L%.1f %.1f' * len(points)) % tuple(points.reshape(-1).tolist())
    return 'M' + text[1:] + ('z' if closed else '')


def _arrow_heads(a: Array, b: Array) -> Array:
    """Both sides of the heads of arrows a to b (n, 2), shape (n, 2, 2), px."""
    step = a - b
    length = np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    unit = step / length * np.minimum(HEAD, 0.6 * length)
    sides = []
    for turn in (SPREAD, -SPREAD):
        c, s = math.cos(turn), math.sin(turn)
        sides.append(b + unit @ np.array([[c, s], [-s, c]]))
    return np.stack(sides, axis=1)


def arrow_path(ends: Array) -> str:
    """Path data of arrows with heads at the second of their ends (n, 2, 2), px."""
    sides = _arrow_heads(ends[:, 0], ends[:, 1])
    rows = np.concatenate([ends, sides[:, :1], ends[:, 1:], sides[:, 1:]], axis=1)
    text = 'M%.1f %.1fL%.1f %.1fM%.1f %.1fL%.1f %.1fL%.1f %.1f'
    return (text * len(rows)) % tuple(rows.reshape(-1).tolist())


def svg(width: float, height: float, marks: Iterable[str], title: str) -> str:
    """An ``svg`` element; ``title`` is read to those who cannot see it."""
    label = escaped(title)
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" style="max-width:{1.25 * width:g}px" '
        f'role="img" aria-label="{label}">'
        f'{"".join(marks)}</svg>'
    )


def words(x: float, y: float, said: str, kind: str = '', *, turned: bool = False) -> str:
    """Text at a place, px; ``kind`` holds classes such as 'end', 'middle', 'soft', 'strong'."""
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ''
    css = f' class="{kind}"' if kind else ''
    return f'<text x="{x:.1f}" y="{y:.1f}"{css}{turn}>{escaped(said)}</text>'


@dataclass(frozen=True)
class Panel:
    """Axes and the place of data between them.

    Attributes
    ----------
    x, y : Scale
        ``y`` points up.
    left, right, top, bottom : float, px
        Room for labels.
    """

    x: Scale
    y: Scale
    width: float = 340.0
    height: float = 210.0
    left: float = 52.0
    right: float = 14.0
    top: float = 24.0
    bottom: float = 38.0

    def points(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Places in the picture, shape (n, 2), px."""
        across = self.left + self.x.place(x) * (self.width - self.left - self.right)
        down = self.height - self.bottom - self.y.place(y) * (self.height - self.top - self.bottom)
        return np.column_stack(np.broadcast_arrays(across, down))

    def line(self, x: ArrayLike, y: ArrayLike, kind: str) -> str:
        """Line through points."""
        return f'<path class="line {kind}" d="{polyline(self.points(x, y))}"/>'

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, kind: str) -> str:
        """Area between two lines."""
        there, back = self.points(x, low), self.points(x, high)[::-1]
        outline = polyline(np.concatenate([there, back]), closed=True)
        return f'<path class="area {kind}" d="{outline}"/>'

    def dots(self, x: ArrayLike, y: ArrayLike, kind: str) -> str:
        """One dot a point; its size belongs to the class."""
        places = self.points(x, y)
        text = ('M%.1f %.1fh0' * len(places)) % tuple(places.reshape(-1).tolist())
        return f'<path class="dots {kind}" d="{text}"/>'

    def rings(self, x: ArrayLike, y: ArrayLike) -> str:
        """Open circles around points."""
        return ''.join(
            f'<circle class="line open" cx="{a:.1f}" cy="{b:.1f}" r="4.5"/>'
            for a, b in self.points(x, y)
        )

    def boxes(self, x: ArrayLike, y: ArrayLike) -> str:
        """Open squares around points."""
        return ''.join(
            f'<rect class="line ink" x="{a - 5.5:.1f}" y="{b - 5.5:.1f}" width="11" height="11"/>'
            for a, b in self.points(x, y)
        )

    def upright(self, x: float, said: str, kind: str) -> str:
        """Vertical line across the panel, with a word or two at its top."""
        line = self.line([x, x], [self.y.low, self.y.high], kind)
        place = float(self.points(x, self.y.high)[0, 0])
        return line + words(place, self.top - 3.0, said, 'middle soft')

    def ranges(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, kind: str) -> str:
        """Vertical strokes from low to high."""
        ends = np.concatenate([self.points(x, low), self.points(x, high)], axis=1)
        text = ('M%.1f %.1fL%.1f %.1f' * len(ends)) % tuple(ends.reshape(-1).tolist())
        return f'<path class="line {kind}" d="{text}"/>'

    def arrows(self, start: Array, end: Array, kind: str) -> str:
        """Arrows between points, shape (n, 2)."""
        ends = np.stack([self.points(*start.T), self.points(*end.T)], axis=1)
        return f'<path class="line {kind}" d="{arrow_path(ends)}"/>'

    def columns(self, edges: ArrayLike, heights: ArrayLike, kind: str) -> str:
        """Columns from zero between edges (n + 1,)."""
        steps, top = np.asarray(edges, dtype=float), np.asarray(heights, dtype=float)
        foot = np.zeros_like(top)
        a, b = self.points(steps[:-1], foot), self.points(steps[1:], top)
        rows = np.column_stack([a, b[:, 1], b[:, 0], a[:, 1]])
        text = ('M%.1f %.1fV%.1fH%.1fV%.1fz' * len(rows)) % tuple(rows.reshape(-1).tolist())
        return f'<path class="area {kind}" d="{text}"/>'

    def level(self, y: float, kind: str) -> str:
        """Horizontal line across the panel."""
        return self.line([self.x.low, self.x.high], [y, y], kind)

    def draw(self, marks: Iterable[str], title: str, heading: str = '') -> str:
        """The whole picture.

        Parameters
        ----------
        marks : iterable of str
            What the other methods return, from behind to the front.
        title : str
            For readers who cannot see it.
        heading : str
            Stands above the panel.
        """
        head = [words(self.left, 14.0, heading, 'strong')] if heading else []
        return svg(self.width, self.height, [*self._axes(), *marks, *head], title)

    def _axes(self) -> list[str]:
        foot, right = self.height - self.bottom, self.width - self.right
        parts, grid = [], ''
        for value, text in self.y.ticks:
            y = float(self.points(self.x.low, value)[0, 1])
            grid += f'M{self.left:.1f} {y:.1f}H{right:.1f}'
            parts.append(words(self.left - 5.0, y + 3.5, text, 'end'))
        for value, text in self.x.ticks:
            x = float(self.points(value, self.y.low)[0, 0])
            grid += f'M{x:.1f} {foot:.1f}v4'
            parts.append(words(x, foot + 15.0, text, 'middle'))
        middle = 0.5 * (self.left + right)
        return [
            f'<path class="grid" d="{grid}"/>',
            *parts,
            words(middle, self.height - 5.0, self.x.label, 'middle soft'),
            words(11.0, 0.5 * (self.top + foot), self.y.label, 'middle soft', turned=True),
        ]


# Bars with names and values, each of one or several parts.

ROW, THICK = 19.0, 12.0
"""px; distance and thickness of bars."""
LETTER = 6.2
"""px; about the width of a letter."""


@dataclass(frozen=True)
class Bar:
    """A bar.

    Attributes
    ----------
    parts : tuple of (size, class)
        In one unit; drawn one behind the other.
    words : str
        At the end of the bar, beyond its mark only where they would stand over it.
    mark : float, optional
        A stroke at this size, e.g. what is expected.
    ends : tuple of two floats, optional
        An interval, drawn as a stroke along the bar.
    """

    name: str
    parts: tuple[tuple[float, str], ...]
    words: str
    mark: float | None = None
    ends: tuple[float, float] | None = None

    @property
    def size(self) -> float:
        """Whole length."""
        return sum(size for size, _ in self.parts)


def _scale(row: Bar, room: float) -> float:
    """Largest scale at which a bar and its words have room, px of a unit."""
    reach = max(row.size, row.mark or 0.0, *(row.ends or ()), 1e-300)
    return max(room - LETTER * len(row.words) - 14.0, 0.2 * room) / reach


def bars(
    rows: Sequence[Bar],
    title: str,
    *,
    names: float = 50.0,
    width: float = 400.0,
    beside: Sequence[Bar] = (),
    heading: str = '',
) -> str:
    """Picture of bars on one scale.

    Parameters
    ----------
    title : str
        For readers who cannot see it.
    names : float, px
        Room for the names.
    beside : sequence of Bar
        Bars of a picture beside this one, which has the same scale.
    heading : str
        Stands above the bars.
    """
    scale = min([_scale(row, width - names) for row in (*rows, *beside)], default=1.0)
    top = ROW if heading else 0.0
    marks = [words(0.0, 14.0, heading, 'strong')] if heading else []
    for k, row in enumerate(rows):
        y, x = top + k * ROW + 3.0, names
        marks.append(words(names - 6.0, y + 10.0, row.name, 'end'))
        for size, kind in row.parts:
            marks.append(
                f'<rect class="area {kind}" x="{x:.1f}" y="{y:.1f}" width="{size * scale:.1f}" '
                f'height="{THICK:g}"/>'
            )
            x += size * scale
        if row.ends is not None:
            low, high = (names + end * scale for end in row.ends)
            marks.append(f'<path class="line ink" d="M{low:.1f} {y + 6:.1f}H{high:.1f}"/>')
            x = max(x, high)
        if row.mark is not None:
            at = names + row.mark * scale
            marks.append(f'<path class="line ink" d="M{at:.1f} {y - 2:.1f}v{THICK + 4:.1f}"/>')
            if x + 12.0 + LETTER * len(row.words) > at:
                x = max(x, at)
        marks.append(words(x + 6.0, y + 10.0, row.words))
    return svg(width, top + len(rows) * ROW + 4.0, marks, title)
