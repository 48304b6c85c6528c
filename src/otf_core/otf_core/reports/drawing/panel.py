# SPDX-License-Identifier: Apache-2.0
"""A picture with two axes: marks in data coordinates become an ``svg`` element.

Marks carry a class for their colour and stroke (``style.STYLE``); nothing here names a colour.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from otf_core.arrays import Array
from otf_core.reports.drawing.scale import Scale
from otf_core.reports.drawing.style import text as typeset

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
    label = typeset(title)
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" style="max-width:{1.25 * width:g}px" '
        f'role="img" aria-label="{label}">'
        f'{"".join(marks)}</svg>'
    )


def words(x: float, y: float, said: str, kind: str = '', *, turned: bool = False) -> str:
    """Text at a place, px; ``kind`` holds classes such as 'end', 'middle', 'soft', 'strong'."""
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ''
    css = f' class="{kind}"' if kind else ''
    return f'<text x="{x:.1f}" y="{y:.1f}"{css}{turn}>{typeset(said)}</text>'


@dataclass(frozen=True)
class Panel:
    """Axes and the place of data between them.

    Attributes
    ----------
    x, y : Scale
        ``y`` points up.
    width, height : float, px
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
