# SPDX-License-Identifier: Apache-2.0
"""FANUC: G61 exact stop mode, G04 X in seconds, G54 set equal to machine coordinates.

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

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import AxisMove, Dialect, axis_words, plain, words


class Fanuc(Dialect):
    """FANUC series 0i and 30i, G code system of milling machines."""

    name = 'fanuc'
    file_name = 'O1001.NC'
    unchecked = 'G93 WITH G91'

    def comment(self, text: str) -> str:
        """Comment line: capitals only."""
        return f'({plain(text).upper()})'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings."""
        notes = (*header, 'SET G54 AND THE EXTERNAL OFFSET TO ZERO: G54 MUST EQUAL MACHINE COORD.')
        modal = ['G21 G90 G94 G17 G40 G49 G80', 'G54', 'G61']
        return ['%', 'O1001 (OTF PATH)', *map(self.comment, notes), *modal]

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in G54."""
        return f'G01 {words(axes, point)} F{feed}.'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [f'G04 X{seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['M00']

    def end(self) -> list[str]:
        """End of the program, back to cutting mode."""
        return ['G64', 'M30', '%']

    def begin_axes(self, header: Sequence[str], number: int, tcp: bool) -> list[str]:
        """Header comments and modal settings."""
        note = (
            'G54: WORKPIECE ZERO; H01: LENGTH OF THE REFLECTOR'
            if tcp
            else 'SET G54 AND THE EXTERNAL OFFSET TO ZERO: G54 MUST EQUAL MACHINE COORD.'
        )
        start = ['%', f'O{self._number(number)} (OTF PATH)', *map(self.comment, (*header, note))]
        modal = ['G21 G90 G94 G17 G40 G49 G80', 'G54', 'G64']
        return [*start, *modal, *(['G43.4 H01'] if tcp else []), 'G93']

    def move_axes(self, move: AxisMove, tcp: bool) -> list[str]:
        """Straight line; a block that turns endless axes is incremental as a whole."""
        own, mode = (move.by, 'G91') if move.endless else (move.to, 'G90')
        stop = 'G09 ' if move.stop else ''
        return [f'{stop}{mode} G01 {axis_words(own)} F{move.per_minute:.3f}']

    def end_axes(self, tcp: bool) -> list[str]:
        """End of the program."""
        return ['G94 G90 G49', 'M30', '%']

    def file_of(self, number: int) -> str:
        """Name after the number of the program."""
        return f'O{self._number(number)}.NC'

    @staticmethod
    def _number(number: int) -> int:
        return 1000 + number
