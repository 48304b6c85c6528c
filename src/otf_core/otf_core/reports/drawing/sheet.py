# SPDX-License-Identifier: Apache-2.0
"""Pictures as a file: several in a grid, with a heading, a key and what they show in words."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

from otf_core.files.writing import write_text
from otf_core.reports.drawing.panel import words
from otf_core.reports.drawing.style import MARKS

GAP, EDGE, LINE = 12.0, 16.0, 16.0
"""px; between pictures, around them, from line to line of text."""
SIZE = re.compile(r'<svg[^>]*viewBox="0 0 ([\d.]+) ([\d.]+)"')
WIDEST = re.compile(r' style="max-width:[^"]*"')
LETTERS = 6.0
"""px; about the width of a letter."""

Key = Sequence[tuple[str, str]]
"""Class of a colour, and what it stands for."""


def _size(picture: str) -> tuple[float, float]:
    found = SIZE.match(picture)
    assert found is not None, 'not of drawing.panel.svg'
    return float(found[1]), float(found[2])


def _placed(picture: str, x: float, y: float) -> str:
    width, height = _size(picture)
    place = f'<svg x="{x:.1f}" y="{y:.1f}" width="{width:g}" height="{height:g}" '
    return place + WIDEST.sub('', picture, count=1).removeprefix('<svg ')


def sheet(
    pictures: Sequence[str], columns: int, title: str, caption: str = '', key: Key = ()
) -> str:
    """A whole SVG file.

    Parameters
    ----------
    pictures : sequence of str
        As ``drawing.panel.svg`` returns them; row by row.
    columns : int
    title, caption : str
    key : sequence of (class, text)
    """
    rows = [pictures[k : k + columns] for k in range(0, len(pictures), columns)]
    wide = [max(_size(row[k])[0] for row in rows if k < len(row)) for k in range(len(rows[0]))]
    width = sum(wide) + GAP * (len(wide) - 1) + 2 * EDGE
    parts, y = [words(EDGE, EDGE + 10.0, title, 'strong')], EDGE + 18.0
    if key:
        x = EDGE
        for kind, said in key:
            if x > EDGE and x + 24.0 + LETTERS * len(said) > width - EDGE:
                x, y = EDGE, y + LINE
            parts.append(
                f'<rect class="area {kind}" x="{x:.1f}" y="{y:.1f}" width="10" height="10"/>'
            )
            parts.append(words(x + 15.0, y + 9.0, said))
            x += 34.0 + LETTERS * len(said)
        y += LINE + 6.0
    for row in rows:
        x = EDGE
        for picture, space in zip(row, wide, strict=False):
            parts.append(_placed(picture, x, y))
            x += space + GAP
        y += max(_size(p)[1] for p in row) + GAP
    for line in textwrap.wrap(caption, int((width - 2 * EDGE) / LETTERS)):
        parts.append(words(EDGE, y + 10.0, line, 'soft'))
        y += LINE
    height = y + EDGE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width:g}" height="{height:g}"><style>{MARKS}</style>'
        f'<rect width="100%" height="100%" fill="var(--paper)"/>{"".join(parts)}</svg>\n'
    )


def write_sheet(
    folder: str | Path,
    name: str,
    pictures: Sequence[str],
    columns: int,
    title: str,
    caption: str = '',
    key: Key = (),
) -> Path:
    """Write a sheet as NAME.svg, whole or not at all."""
    path = Path(folder) / f'{name}.svg'
    write_text(path, sheet(pictures, columns, title, caption, key))
    return path
