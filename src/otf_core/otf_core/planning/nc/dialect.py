# SPDX-License-Identifier: Apache-2.0
"""What a dialect is: blocks in mm and degrees to 0.001, feeds or times, stops; see ``programs``.

Where only linear axes exist a block has a feed in mm/min; with rotary ones it has a time, since a
feed means nothing where they move. Endless axes are moved by increments where a control reduces
absolute angles to one turn. Light: the command line loads it for the names of the dialects.
"""

from __future__ import annotations

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_WIDTH = 70
LEAST_DWELL = 1e-3
"""s; controls take no shorter ones."""


@dataclass(frozen=True)
class Program:
    """What a program is for.

    Attributes
    ----------
    number : int
        From 1.
    turns : bool
        The machine has rotary axes: every block has a time.
    tcp : bool
        The control holds the tool centre point, in coordinates of the workpiece; else positions
        are those of the axes.
    """

    number: int = 1
    turns: bool = False
    tcp: bool = False

    @property
    def feed_mode(self) -> str:
        """G94, feed per minute, or G93, time of a block."""
        return 'G93' if self.turns else 'G94'


@dataclass(frozen=True)
class Move:
    """One block.

    Attributes
    ----------
    to : mapping of axis to float, mm and degrees
        Positions of all axes that are programmed, at its end.
    by : mapping of axis to float, mm and degrees
        Increments of the axes that move.
    endless : tuple of str
        Endless axes among them.
    length : float
        Travel, mm and degrees: of the linear axes, where none moves of the rotary ones.
    stop : bool
        Exact stop at the end.
    dwell : float
        s, standstill after it.
    """

    to: Mapping[str, float]
    by: Mapping[str, float]
    endless: tuple[str, ...]
    seconds: float
    length: float
    stop: bool = True
    dwell: float = 0.0

    @property
    def absolute(self) -> dict[str, float]:
        """Positions of all axes but endless ones that move."""
        return {a: v for a, v in self.to.items() if a not in self.endless}

    @property
    def turned(self) -> dict[str, float]:
        """Increments of endless axes that move."""
        return {a: self.by[a] for a in self.endless}

    @property
    def per_minute(self) -> float:
        """Inverse time, 1/min."""
        return 60.0 / self.seconds

    @property
    def feed(self) -> int:
        """Feed along the linear axes, mm/min, or of rotary ones alone, degrees/min."""
        return round(self.length * self.per_minute)

    def speed(self, program: Program) -> str:
        """Word of the feed, or of the inverse time."""
        return f'F{self.per_minute:.3f}' if program.turns else f'F{self.feed}'


class Dialect(ABC):
    """How one control writes a program.

    Attributes
    ----------
    name : str
        As given on the command line.
    comment_form, dwell_form, stop_word : str
        A comment, a standstill in s, and a stop until the operator goes on.
    longest_dwell : float
        s.
    unchecked : str
        What of a program for rotary axes no manual at hand confirmed.
    """

    name: str
    file_name: str
    comment_form: str = '; {}'
    dwell_form: str = 'G04 X{:.3f}'
    stop_word: str = 'M0'
    longest_dwell: float = 9999.0
    unchecked: str = ''

    def comment(self, text: str) -> str:
        """Comment line."""
        return self.comment_form.format(text)

    @abstractmethod
    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings: mm, absolute, feed or time, TCP off or on."""

    @abstractmethod
    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line in the positions of all axes, machine coordinates unless TCP is on."""

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [self.dwell_form.format(seconds)]

    @abstractmethod
    def end(self, program: Program) -> list[str]:
        """End of the program."""

    def say(self, text: str) -> list[str]:
        """Tell the operator what to do at the stop that follows."""
        return [self.comment(line) for line in comment_lines(text)]

    def file_of(self, number: int) -> str:
        """Name of the file of program ``number``, from 1."""
        stem, dot, ending = self.file_name.partition('.')
        return f'{stem}_{number}{dot}{ending}'

    def finished(self, lines: list[str]) -> list[str]:
        """Last change to all lines, such as line numbers."""
        return lines


def words(values: Mapping[str, float], sign: bool = False, prefix: str = '') -> str:
    """Axis words in mm and degrees: ``X10.000 C90.000``; ``sign`` writes a plus too."""
    style = f'{"+" if sign else ""}.3f'
    return ' '.join(f'{prefix}{a}{round(v, 3) + 0.0:{style}}' for a, v in values.items())


def plain(text: str) -> str:
    """Text that every control takes in a comment: ASCII, no brackets, semicolon or percent."""
    letters = (
        text.encode('ascii', 'replace').decode().translate(str.maketrans('()[]{};%', '--------'))
    )
    return ' '.join(letters.split())


def comment_lines(text: str) -> list[str]:
    """Plain text in lines that every control takes whole, broken between words."""
    return textwrap.wrap(plain(text), _WIDTH, break_on_hyphens=False)
