# SPDX-License-Identifier: Apache-2.0
"""What a dialect is: points in mm to 1 um, feeds in mm/min, stops; see ``programs`` for the order.

Light: the command line loads it for the names of the dialects.
"""

from __future__ import annotations

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Sequence

from otf_core.arrays import Array

_WIDTH = 70


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
    decimals : int
        Of positions in mm.
    """

    name: str
    file_name: str
    longest_dwell: float = 9999.0
    needs_dwell: bool = False
    decimals: int = 3

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

    def finished(self, lines: list[str]) -> list[str]:
        """Last change to all lines, such as line numbers."""
        return lines


def words(axes: str, point: Array, sign: bool = False, decimals: int = 3) -> str:
    """Axis words in mm: ``X10.000 Y20.000``; ``sign`` writes a plus too."""
    style = f'{"+" if sign else ""}.{decimals}f'
    values = {a: round(float(point['XYZ'.index(a)]), decimals) + 0.0 for a in axes}
    return ' '.join(f'{a}{value:{style}}' for a, value in values.items())


def plain(text: str) -> str:
    """Text that every control takes in a comment: ASCII, no brackets, semicolon or percent."""
    letters = (
        text.encode('ascii', 'replace').decode().translate(str.maketrans('()[]{};%', '--------'))
    )
    return ' '.join(letters.split())


def comment_lines(text: str) -> list[str]:
    """Plain text in lines that every control takes whole, broken between words."""
    return textwrap.wrap(plain(text), _WIDTH, break_on_hyphens=False)
