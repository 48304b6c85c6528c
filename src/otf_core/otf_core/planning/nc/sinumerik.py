# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl, 828D: G9 with G601 exact stop fine, SUPA per block, G4 F own block.

Source: SINUMERIK 840D sl programming manuals (G9/G601 fundamentals, G4 F in seconds, SUPA
suppresses all frames for one block, G710 metric for lengths and feed). Rotary axes: SINUMERIK ONE
programming manual 12/2019, 2.7 (G93: F2 drives a block in 0.5 min); 840D sl job planning 06/2009,
6.2 (TRAORI); 808D programming manual, 1.2 (IC for one axis, whatever G90 says). G9 stops at the
end of one block, by the criterion of G601; G64 drives through the others.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.planning.nc.dialect import Dialect, Move, Program, plain, words


class Sinumerik(Dialect):
    """SINUMERIK 840D sl and 828D, G code."""

    name = 'sinumerik'
    file_name = 'OTF_PATH.MPF'
    dwell_form = 'G4 F{:.3f}'
    unchecked = 'TRAFOOF'

    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings."""
        note = 'WORKPIECE COORDINATES' if program.tcp else 'MACHINE COORDINATES - SUPA, D0'
        off = ['TRAFOOF'] if program.turns else []
        modal = [f'G17 G40 G710 G90 {program.feed_mode}', 'G64 G601']
        frame = ['G54', 'TRAORI'] if program.tcp else ['D0']
        return [*map(self.comment, (*header, note)), *off, *modal, *frame]

    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line; endless axes by increments."""
        by = [f'{a}=IC({round(v, 3) + 0.0:.3f})' for a, v in move.turned.items()]
        mode = [*(['G9'] if move.stop else []), *([] if program.tcp else ['SUPA']), 'G1']
        return [' '.join([*mode, words(move.absolute), *by, move.speed(program)])]

    def end(self, program: Program) -> list[str]:
        """End of the program."""
        return [*(['TRAFOOF'] if program.tcp else []), 'G94', 'M30']

    def say(self, text: str) -> list[str]:
        """Message on the screen until the next one."""
        return [*super().say(text), f'MSG("{plain(text).replace(chr(34), "-")[:120]}")']
