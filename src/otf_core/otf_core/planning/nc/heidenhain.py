# SPDX-License-Identifier: Apache-2.0
"""HEIDENHAIN Klartext: numbered lines, signs on all positions, M91 per line, dwell by cycle 9.

Klartext has no exact stop; a dwell at a corner is what stops the machine. Cycle 9 takes 0 s to
3600 s; its title is free text in the language of the control.

Rotary axes: TNC 620 programming manual 5/2013, 11.4 (M126 to M129; M128 is reset before M91), TNC
410 (M116, M117: F of a rotary axis is in degrees/min without M116), both as DIN/ISO manuals.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.planning.nc.dialect import LEAST_DWELL, Dialect, Move, Program, words

SHORTEST_STOP = 0.1
"""s; the dwell that stops at a corner where a plan has none."""


class Heidenhain(Dialect):
    """HEIDENHAIN iTNC 530, TNC 620/640, TNC7."""

    name = 'heidenhain'
    file_name = 'OTFPATH.H'
    stop_word = 'STOP M0'
    longest_dwell = 3600.0
    unchecked = 'I WITH M91, AND F OF BLOCKS THAT MOVE LINEAR AND ROTARY AXES'

    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings."""
        notes = [*header]
        modal = []
        if program.turns:
            notes.append('FUNCTION RESET TCPM AND PLANE RESET FIRST WHERE THEY WERE USED')
            modal = ['M129', 'M127', 'M117', *(['M128'] if program.tcp else [])]
        if not program.tcp:
            notes.append('POSITIONS REFER TO THE MACHINE DATUM - M91 - CALL TOOL 0 BEFORE')
        return [f'BEGIN PGM OTFPATH_{program.number} MM', *map(self.comment, notes), *modal]

    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line; endless axes by increments; a dwell stops."""
        parts = [words(move.absolute, sign=True), words(move.turned, sign=True, prefix='I')]
        feed = f'R0 F{max(1, move.feed)}'
        text = ' '.join(['L', *filter(None, parts), feed, *([] if program.tcp else ['M91'])])
        halts = move.stop and move.dwell < LEAST_DWELL
        return [text, *(self.dwell(SHORTEST_STOP) if halts else [])]

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return ['CYCL DEF 9.0 DWELL TIME', f'CYCL DEF 9.1 DWELL {seconds:.3f}']

    def end(self, program: Program) -> list[str]:
        """End of the program; ``finished`` gives END the name of BEGIN."""
        return [*(['M129'] if program.tcp else []), 'M30', 'END PGM OTFPATH MM']

    def finished(self, lines: list[str]) -> list[str]:
        """Number the lines from 0; the last one names the program as the first does."""
        lines = [*lines[:-1], lines[0].replace('BEGIN', 'END', 1)]
        return [f'{k} {line}' for k, line in enumerate(lines)]
