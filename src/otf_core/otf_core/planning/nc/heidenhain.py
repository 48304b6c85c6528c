# SPDX-License-Identifier: Apache-2.0
"""HEIDENHAIN Klartext: numbered lines, signs on all positions, M91 per line, dwell by cycle 9.

Klartext has no exact stop; the dwell at a corner is what stops the machine, so a plan without
one is refused. Cycle 9 takes 0 s to 3600 s; its title is free text in the language of the control.

Rotary axes: TNC 620 programming manual 5/2013, 11.4 (M126 to M129; M128 is reset before M91), TNC
410 (M116, M117: F of a rotary axis is in degrees/min without M116), both as DIN/ISO manuals.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import AxisMove, Dialect, axis_words, words

SHORTEST_STOP = 0.1
"""s; the dwell that stops at a corner."""


class Heidenhain(Dialect):
    """HEIDENHAIN iTNC 530, TNC 620/640, TNC7."""

    name = 'heidenhain'
    file_name = 'OTFPATH.H'
    longest_dwell = 3600.0
    needs_dwell = True
    unchecked = 'I WITH M91, AND F OF BLOCKS THAT MOVE LINEAR AND ROTARY AXES'

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
        """Number the lines from 0; the last one names the program as the first does."""
        lines = [*lines[:-1], lines[0].replace('BEGIN', 'END', 1)]
        return [f'{k} {line}' for k, line in enumerate(lines)]

    def begin_axes(self, header: Sequence[str], number: int, tcp: bool) -> list[str]:
        """Header comments; M functions that switch TCP and feeds over."""
        notes = [*header, 'FUNCTION RESET TCPM AND PLANE RESET FIRST WHERE THEY WERE USED']
        if not tcp:
            notes.append('POSITIONS REFER TO THE MACHINE DATUM - M91 - CALL TOOL 0 BEFORE')
        modal = ['M129', 'M127', 'M117', *(['M128'] if tcp else [])]
        return [f'BEGIN PGM OTFPATH_{number} MM', *map(self.comment, notes), *modal]

    def move_axes(self, move: AxisMove, tcp: bool) -> list[str]:
        """Straight line; endless axes by increments; the dwell stops."""
        parts = [
            axis_words(move.absolute, sign=True),
            axis_words(move.turned, sign=True, prefix='I'),
        ]
        feed = max(1, round(move.length * move.per_minute))
        text = ' '.join(['L', *filter(None, parts), f'R0 F{feed}', *([] if tcp else ['M91'])])
        return [text, *(self.dwell(SHORTEST_STOP) if move.stop else [])]

    def end_axes(self, tcp: bool) -> list[str]:
        """End of the program; ``finished`` gives END the name of BEGIN."""
        return [*(['M129'] if tcp else []), 'M30', 'END PGM OTFPATH MM']
