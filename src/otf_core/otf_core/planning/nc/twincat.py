# SPDX-License-Identifier: Apache-2.0
"""Beckhoff TwinCAT 3 CNC: G60 exact stop of one block, G53 without zero offsets, G04 X in seconds.

Source: Beckhoff TF5200 programming manual (Beckhoff Information System), sections on exact stop
(G60/G360/G359), zero offsets (G53 ... G59), dwell time (G04), units (G70/G71), G93/G94, comments
and structure of NC programs; TF5200 coordinate systems, tool offset (D0). G53 is modal there and
moves at a feed, unlike elsewhere; the channel parameter g53_verfuegbar makes it one more offset,
which the program cannot see. Rotary axes: TF5200, G93 (F is the time of a block in s), #TRAFO
ON/OFF (RTCP), modulo axes (an absolute angle is reduced to one turn, so blocks that turn endless
axes are G91).
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.planning.nc.dialect import Dialect, Move, Program, words


class TwinCat(Dialect):
    """TwinCAT 3 CNC (TF5200)."""

    name = 'twincat'
    file_name = 'otf_path.nc'
    stop_word = 'M00'
    unchecked = 'G91 OF MODULO AXES BEYOND ONE TURN'

    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings."""
        zero = 'G53 MUST BE WITHOUT OFFSET: G53_VERFUEGBAR 0 - NO G92, NO CS ACTIVE'
        note = 'KINEMATICS OF THE MACHINE SELECTED: #KIN ID' if program.tcp else zero
        frame = ['G54', '#TRAFO ON'] if program.tcp else ['G53', 'D0']
        modal = [*(['#TRAFO OFF'] if program.turns else []), 'G71 G90 G94 G17 G40', *frame]
        modal += ['G93'] if program.turns else []
        return [f'% OTF_PATH_{program.number}', *map(self.comment, (*header, note)), *modal]

    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line; a block that turns endless axes is incremental as a whole."""
        own, mode = (move.by, 'G91') if move.endless else (move.to, 'G90')
        stop = 'G60 ' if move.stop else ''
        speed = f'F{move.seconds:.3f}' if program.turns else f'F{move.feed}'
        return [f'{stop}{mode} G01 {words(own)} {speed}']

    def end(self, program: Program) -> list[str]:
        """End of the program."""
        return [*(['#TRAFO OFF'] if program.tcp else []), 'G94 G90', 'M30']
