# SPDX-License-Identifier: Apache-2.0
"""FANUC: G09 exact stop of one block, G04 X in seconds, G54 set equal to machine coordinates.

G53 moves at rapid only, so feed moves need a work offset: the operator sets G54 and the external
offset to zero; the program cannot check it and does not overwrite it. G04 P would count
milliseconds without decimal point; X with one counts seconds on mills and lathes alike.

Rotary axes: FANUC operator's manual B-62764EN/01, 5 (G93: F = 1 / time in min, 0.001 to 9999.999);
B-63534EN/02, 20.2 (roll-over: an absolute angle is reduced to one turn, an increment is driven
whole, so blocks that turn endless axes are G91); B-63942EN/02, appendix B (G43.4 H, cancelled by
G49).
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.planning.nc.dialect import Dialect, Move, Program, plain, words


class Fanuc(Dialect):
    """FANUC series 0i and 30i, G code system of milling machines."""

    name = 'fanuc'
    file_name = 'O1001.NC'
    stop_word = 'M00'
    unchecked = 'G93 WITH G91'

    def comment(self, text: str) -> str:
        """Comment line: capitals only."""
        return f'({plain(text).upper()})'

    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings."""
        note = (
            'G54: WORKPIECE ZERO; H01: LENGTH OF THE REFLECTOR'
            if program.tcp
            else 'SET G54 AND THE EXTERNAL OFFSET TO ZERO: G54 MUST EQUAL MACHINE COORD.'
        )
        start = ['%', f'O{1000 + program.number} (OTF PATH)', *map(self.comment, (*header, note))]
        modal = [f'G21 G90 {program.feed_mode} G17 G40 G49 G80', 'G54', 'G64']
        return [*start, *modal, *(['G43.4 H01'] if program.tcp else [])]

    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line; a block that turns endless axes is incremental as a whole."""
        own, mode = (move.by, 'G91') if move.endless else (move.to, 'G90')
        stop = 'G09 ' if move.stop else ''
        point = '' if program.turns else '.'
        return [f'{stop}{mode} G01 {words(own)} {move.speed(program)}{point}']

    def end(self, program: Program) -> list[str]:
        """End of the program."""
        return ['G94 G90 G49', 'M30', '%']

    def file_of(self, number: int) -> str:
        """Name after the number of the program."""
        return f'O{1000 + number}.NC'
