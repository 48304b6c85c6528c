# SPDX-License-Identifier: Apache-2.0
"""Bars with names and values, each of one or several parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from otf_core.reports.drawing.panel import svg, words

ROW, THICK = 19.0, 12.0
"""px; distance and thickness of bars."""
LETTER = 6.2
"""px; about the width of a letter."""


@dataclass(frozen=True)
class Bar:
    """A bar.

    Attributes
    ----------
    name : str
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
    rows : sequence of Bar
    title : str
        For readers who cannot see it.
    names : float, px
        Room for the names.
    width : float, px
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
