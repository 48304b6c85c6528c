# SPDX-License-Identifier: Apache-2.0
"""Sections to one HTML page that needs nothing else: no network, no fonts, no files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from otf_core.files.writing import tidy, write_text
from otf_core.reports.rendering import TEMPLATES, State, join_names, micro, place, running_head, write_result
from otf_core.reports.rendering import escaped as text

# Numbers of reports as text: micrometres and microradians, positions in millimetres.

INFINITE_DOF = 1e6
"""Degrees of freedom that are given as infinite."""


def micro(value: float, digits: int = 2) -> str:
    """A value in millionths: um for m, urad for rad."""
    return f'{1e6 * value + 0.0:.{digits}f}'


def micro_unit(unit: str) -> str:
    """Name of millionths of a unit."""
    return 'um' if unit == 'm' else 'urad'


def whole_dof(dof: float) -> int | None:
    """Effective degrees of freedom, cut to the next lower integer (GUM G.4.1); None: infinite."""
    return int(dof) if dof < INFINITE_DOF else None


def dof_words(dof: float) -> str:
    """The same in words."""
    whole = whole_dof(dof)
    return 'infinite' if whole is None else str(whole)


def place(point: Iterable[float]) -> str:
    """A point, m, in words, in mm."""
    return ', '.join(f'{a} {millimetres(v)}' for a, v in zip('XYZ', point, strict=True)) + ' mm'


def millimetres(value: float) -> str:
    """A position, m, in mm to 0.1 mm, without zeros at its end."""
    return f'{tidy(round(1e3 * value, 1)):g}'


def join_names(names: Iterable[str]) -> str:
    """Names with commas and a last 'and'."""
    texts = list(names)
    return ' and '.join([', '.join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


# A section of a report: one object for page, terminal and ``--json``.


@dataclass(frozen=True)
class State:
    """A state in words, in the colour of its mood: 'good', 'bad', 'open' or none."""

    words: str
    mood: str = ''


Cell = str | tuple[str, ...] | State
"""Plain text; of several lines the first is set off from the rest."""


@dataclass(frozen=True)
class Table:
    """Rows under heads, all plain text.

    Attributes
    ----------
    numbers : tuple of int
        Columns that are set to the right.
    folded : str
        Not empty: shown on request, under these words.
    stacked : bool
        On a phone the cells of a row stand one below the other, each after its head.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numbers: tuple[int, ...] = ()
    title: str = ''
    folded: str = ''
    stacked: bool = False

    def __post_init__(self) -> None:
        """Refuse, as a ValueError, a row that has not one cell under each head."""
        if odd := [row for row in self.rows if len(row) != len(self.head)]:
            raise ValueError(f'{len(odd[0])} cells under {len(self.head)} heads: {odd[0]}')


def table_to_text(table: Table) -> list[str]:
    """Return the rows of a table in columns, for a terminal."""

    def plain(cell: Cell) -> str:
        if isinstance(cell, State):
            return cell.words
        return cell if isinstance(cell, str) else ' '.join(cell)

    rows = [[plain(cell) for cell in row] for row in (table.head, *table.rows)]
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        '  '.join(
            cell.rjust(w) if k in table.numbers else cell.ljust(w)
            for k, (cell, w) in enumerate(zip(row, wide, strict=True))
        ).rstrip()
        for row in rows
    ]


@dataclass(frozen=True)
class Picture:
    """Pictures of one caption: markup that needs nothing from elsewhere.

    Attributes
    ----------
    parts : tuple of str
        SVG elements or other markup, set side by side where there is room.
    caption : str
        Plain text.
    columns : int
        Parts side by side on a wide page.
    key : str
        What colours mean, as markup.
    hint : str
        What the reader can do on a screen; not printed.
    """

    parts: tuple[str, ...]
    caption: str
    columns: int = 1
    title: str = ''
    key: str = ''
    hint: str = ''


def no_pictures() -> Sequence[Picture]:
    """Nothing to draw."""
    return ()


@dataclass(frozen=True)
class Section:
    """What a report says about one thing.

    Attributes
    ----------
    name : str
        Key in ``--json``, and anchor in the page.
    title : str
        Heading; empty for the first screen.
    words : tuple of str
        Sentences of the page, plain text; ``um`` and ``urad`` are set as µm and µrad.
    data : mapping
        The same as numbers in SI units, plain data.
    text : tuple of str
        Lines for a terminal; empty where it shows nothing of this.
    draw : callable
        Returns the pictures; called for pages only.
    script : str
        JavaScript that the pictures want; the page is complete without it.
    """

    name: str
    title: str
    words: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    text: tuple[str, ...] = ()
    draw: Callable[[], Sequence[Picture]] = no_pictures
    script: str = ''


def sections_to_dict(sections: Iterable[Section]) -> dict[str, Any]:
    """Return the data of sections by name, as ``--json`` shows them."""
    return {s.name: dict(s.data) for s in sections if s.data}


def sections_to_text(sections: Iterable[Section]) -> str:
    """Return what a terminal shows."""
    return '\n'.join(line for s in sections for line in s.text).rstrip('\n')


TWO_COLUMN_LETTERS = 400
"""Letters of a section's words from which they stand in two columns."""
LONG_FIGURE = 6
"""Parts of a figure beyond which paper may break it between its rows."""
COLUMNS = {1: '', 2: ' two', 3: ' three'}


@dataclass(frozen=True)
class Heading:
    """Top of a page.

    Attributes
    ----------
    title : str
        What the page is, and of what.
    sentence : str
        The verdict; may be empty.
    badges : tuple of State
        The verdict in a word or two; one badge for each question that is answered.
    tiles : tuple of (what, value, remark)
        The numbers that count.
    running : str
        Head of every printed page: machine, run, date; the title if empty.
    """

    title: str
    sentence: str
    badges: tuple[State, ...] = ()
    tiles: tuple[tuple[str, str, str], ...] = ()
    running: str = ''


def _cell(cell: Cell, number: bool, head: str = '') -> str:
    """A cell; ``head`` is said again in it where a narrow page sets rows one below the other."""
    kind = (' class="number"' if number else '') + (f' data-head="{text(head)}"' if head else '')
    if isinstance(cell, str):
        return f'<td{kind}>{text(cell)}</td>'
    if isinstance(cell, State):
        return f'<td{kind}><b class="{cell.mood}">{text(cell.words)}</b></td>'
    first, *rest = cell
    more = ''.join(f'<div class="soft">{text(line)}</div>' for line in rest)
    return f'<td{kind}>{f"<b>{text(first)}</b>" if first else ""}{more}</td>'


def _table(table: Table) -> str:
    right = set(table.numbers)
    named = ''.join(
        f'<th class="number">{text(h)}</th>' if k in right else f'<th>{text(h)}</th>'
        for k, h in enumerate(table.head)
    )
    several = any(isinstance(cell, tuple) for row in table.rows for cell in row)
    cards = table.stacked or several
    heads = table.head if cards else ('',) * len(table.head)
    rows = ''.join(
        f'<tr>{"".join(_cell(c, k in right, heads[k]) for k, c in enumerate(row))}</tr>'
        for row in table.rows
    )
    title = f'<caption>{text(table.title)}</caption>' if table.title else ''
    thead = f'<thead><tr>{named}</tr></thead>' if any(table.head) else ''
    kind = ' class="cards"' if cards else '' if thead else ' class="facts"'
    body = f'<div class="scroll"><table{kind}>{title}{thead}<tbody>{rows}</tbody></table></div>'
    if table.folded:
        return f'<details><summary>{text(table.folded)}</summary>{body}</details>'
    return body


def _picture(picture: Picture) -> str:
    title = f'<h3>{text(picture.title)}</h3>' if picture.title else ''
    kind = COLUMNS[picture.columns]
    hint = f' <span class="screen">{text(picture.hint)}</span>' if picture.hint else ''
    caption_text = text(picture.caption) + hint
    caption = f'<figcaption>{caption_text}</figcaption>' if caption_text else ''
    long = ' class="long"' if len(picture.parts) > LONG_FIGURE else ''
    parts = ''.join(f'<div>{part}</div>' for part in picture.parts)
    shown = f'<div class="pictures{kind}">{parts}</div>'
    return f'<figure{long}>{title}{picture.key}{shown}{caption}</figure>'


def _tables(tables: Sequence[Table]) -> str:
    """Tables one below the other; those without heads beside each other where there is room."""
    parts = []
    for bare, group in groupby(tables, key=lambda t: not any(t.head) and not t.folded):
        content = ''.join(map(_table, group))
        beside = bare and content.count('<table') > 1
        parts.append(f'<div class="sheet">{content}</div>' if beside else content)
    return ''.join(parts)


def _words(lines: Sequence[str]) -> str:
    """Paragraphs; many of them stand in two columns where the page is wide."""
    if not lines:
        return ''
    many = len(lines) > 1 and sum(map(len, lines)) > TWO_COLUMN_LETTERS
    kind = 'words many' if many else 'words'
    return f'<div class="{kind}">{"".join(f"<p>{text(line)}</p>" for line in lines)}</div>'


def _section(section: Section) -> str:
    """A section; on the first screen, which has no title, pictures come before words."""
    title = f'<h2>{text(section.title)}</h2>' if section.title else ''
    words = _words(section.words)
    pictures = ''.join(map(_picture, section.draw()))
    tables = _tables(section.tables)
    order = f'{words}{pictures}' if title else f'{pictures}{words}'
    return f'<section id="{text(section.name)}">{title}{order}{tables}</section>'


def page_html(heading: Heading, sections: Sequence[Section]) -> str:
    """Return the whole page."""
    named = ''.join(f'<a href="#{text(s.name)}">{text(s.title)}</a>' for s in sections if s.title)
    first, rest = sections[:1], sections[1:]
    scripts = ''.join(f'<script>{s.script}</script>' for s in sections if s.script)
    tiles = ''.join(
        f'<div class="tile"><span>{text(a)}</span><b>{text(b)}</b><span>{text(c)}</span></div>'
        for a, b, c in heading.tiles
    )
    badges = ''.join(
        f'<span class="badge {badge.mood}">{text(badge.words)}</span>' for badge in heading.badges
    )
    style = STYLE + running_head(heading.running or heading.title)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{text(heading.title)}</title><style>{style}</style></head><body><main>\n'
        f'<h1>{text(heading.title)} <span class="badges">{badges}</span></h1>'
        + (f'<p class="verdict">{text(heading.sentence)}</p>\n' if heading.sentence else '')
        + (f'<div class="tiles">{tiles}</div>\n' if tiles else '')
        + '\n'.join(map(_section, first))
        + f'\n<nav aria-label="sections">{named}</nav>\n'
        + '\n'.join(map(_section, rest))
        + f'\n</main>{scripts}</body></html>\n'
    )


def write_result(folder: Path, stem: str, page: str, data: Mapping[str, Any]) -> list[Path]:
    """Write report.html and, last, STEM.json."""
    write_text(folder / 'report.html', page)
    write_text(folder / f'{stem}.json', json.dumps(data, indent=1, allow_nan=False) + '\n')
    return [folder / 'report.html', folder / f'{stem}.json']
