# SPDX-License-Identifier: Apache-2.0
"""A section of a report: one object for page, terminal and ``--json``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


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
    head : tuple of str
    rows : tuple of tuple of Cell
    numbers : tuple of int
        Columns that are set to the right.
    title : str
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
    title : str
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
    tables : tuple of Table
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
