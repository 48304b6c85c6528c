# SPDX-License-Identifier: Apache-2.0
"""HEIDENHAIN Klartext: numbered lines, signs on all positions, M91 per line, dwell by cycle 9.

Klartext has no exact stop; the dwell at a corner is what stops the machine, so a plan without
one is refused. Cycle 9 takes 0 s to 3600 s; its title is free text in the language of the control.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import Dialect, words


class Heidenhain(Dialect):
    """HEIDENHAIN iTNC 530, TNC 620/640, TNC7."""

    name = 'heidenhain'
    file_name = 'OTFPATH.H'
    longest_dwell = 3600.0
    needs_dwell = True

    def comment(self, text: str) -> str:
        """Comment line."""
        return f'; {text}'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments; mm stands in the first line, Klartext is absolute."""
        notes = (*header, 'POSITIONS REFER TO THE MACHINE DATUM - M91 - CALL TOOL 0 BEFORE')
        return ['BEGIN PGM OTFPATH MM', *map(self.comment, notes)]

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates."""
        return f'L {words(axes, point, sign=True)} R0 F{feed} M91'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return ['CYCL DEF 9.0 DWELL TIME', f'CYCL DEF 9.1 DWELL {seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['STOP M0']

    def end(self) -> list[str]:
        """End of the program."""
        return ['M30', 'END PGM OTFPATH MM']

    def finished(self, lines: list[str]) -> list[str]:
        """Number the lines from 0."""
        return [f'{k} {line}' for k, line in enumerate(lines)]
