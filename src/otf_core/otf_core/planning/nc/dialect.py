# SPDX-License-Identifier: Apache-2.0
"""What a dialect is: points in mm to 1 um, feeds in mm/min, stops; see ``programs`` for the order.

Programs of machines with rotary axes (``axis_programs``) have angles in degrees and a time for
every block. Endless axes are moved by increments where a control reduces absolute angles to one
turn. Light: the command line loads it for the names of the dialects.
"""

from __future__ import annotations

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from otf_core.arrays import Array
from otf_core.errors import ConfigError

_WIDTH = 70


@dataclass(frozen=True)
class AxisMove:
    """One block of a machine with rotary axes.

    Attributes
    ----------
    to : mapping of axis to float, mm and degrees
        Positions of all axes at its end.
    by : mapping of axis to float, mm and degrees
        Increments of the axes that move.
    endless : tuple of str
        Endless axes among them.
    length : float
        Travel, mm and degrees: of the linear axes, where none moves of the rotary ones.
    stop : bool
        Exact stop at the end.
    """

    to: Mapping[str, float]
    by: Mapping[str, float]
    endless: tuple[str, ...]
    seconds: float
    length: float
    stop: bool

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


class Dialect(ABC):
    """How one control writes a program.

    Attributes
    ----------
    name : str
        As given on the command line.
    longest_dwell : float
        s.
    needs_dwell : bool
        True where only a dwell makes the machine stop exactly at a corner.
    unchecked : str
        What of a program for rotary axes no manual at hand confirmed.
    """

    name: str
    file_name: str
    longest_dwell: float = 9999.0
    needs_dwell: bool = False
    unchecked: str = ''

    @abstractmethod
    def comment(self, text: str) -> str:
        """Comment line."""

    @abstractmethod
    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings: mm, absolute, feed per minute, exact stop."""

    @abstractmethod
    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates.

        Parameters
        ----------
        axes : str
            Axes that are programmed, of 'XYZ'.
        point : ndarray, shape (3,), mm
        feed : int
            mm/min.
        """

    @abstractmethod
    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""

    @abstractmethod
    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""

    @abstractmethod
    def end(self) -> list[str]:
        """End of the program."""

    def begin_axes(self, header: Sequence[str], number: int, tcp: bool) -> list[str]:
        """Begin program ``number`` for rotary axes: a time per block, TCP off or on.

        TCP off: machine coordinates. TCP on: coordinates of the workpiece.

        Raises
        ------
        ConfigError
            If the dialect has no programs for rotary axes.
        """
        raise ConfigError(f'--dialect {self.name}: has no programs for rotary axes')

    def move_axes(self, move: AxisMove, tcp: bool) -> list[str]:
        """Straight line in the positions of all axes; see ``begin_axes``."""
        raise ConfigError(f'--dialect {self.name}: has no programs for rotary axes')

    def end_axes(self, tcp: bool) -> list[str]:
        """End of a program for rotary axes, TCP off; see ``begin_axes``."""
        raise ConfigError(f'--dialect {self.name}: has no programs for rotary axes')

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


def words(axes: str, point: Array, sign: bool = False) -> str:
    """Axis words in mm: ``X10.000 Y20.000``; ``sign`` writes a plus too."""
    style = f'{"+" if sign else ""}.3f'
    values = {a: round(float(point['XYZ'.index(a)]), 3) + 0.0 for a in axes}
    return ' '.join(f'{a}{value:{style}}' for a, value in values.items())


def axis_words(values: Mapping[str, float], sign: bool = False, prefix: str = '') -> str:
    """Axis words in mm and degrees: ``X10.000 C90.000``, in the order given."""
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
