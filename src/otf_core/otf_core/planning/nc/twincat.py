# SPDX-License-Identifier: Apache-2.0
"""Beckhoff TwinCAT 3 CNC: G360 exact stop (modal), G53 without zero offsets, G04 X in seconds.

Source: Beckhoff TF5200 programming manual (Beckhoff Information System), sections on exact stop
(G60/G360/G359), zero offsets (G53 ... G59), dwell time (G04), units (G70/G71), G93/G94, comments
and structure of NC programs; TF5200 coordinate systems, tool offset (D0). G53 is modal there and
moves at a feed, unlike elsewhere; the channel parameter g53_verfuegbar makes it one more offset,
which the program cannot see. G60 alone would stop at the end of one block only. Rotary axes:
TF5200, G93 (F is the time of a block in s), #TRAFO ON/OFF (RTCP), modulo axes (an absolute angle
is reduced to one turn, so blocks that turn endless axes are G91).
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import AxisMove, Dialect, axis_words, words


class TwinCat(Dialect):
    """TwinCAT 3 CNC (TF5200)."""

    name = 'twincat'
    file_name = 'otf_path.nc'
    unchecked = 'G91 OF MODULO AXES BEYOND ONE TURN'

    def comment(self, text: str) -> str:
        """Comment line."""
        return f'; {text}'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings."""
        notes = (*header, 'G53 MUST BE WITHOUT OFFSET: G53_VERFUEGBAR 0 - NO G92, NO CS ACTIVE')
        modal = ['G71 G90 G94 G17 G40', 'G53', 'D0', 'G360']
        return ['% OTF_PATH', *map(self.comment, notes), *modal]

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates."""
        return f'G01 {words(axes, point)} F{feed}'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [f'G04 X{seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['M00']

    def end(self) -> list[str]:
        """End of the program."""
        return ['G359', 'M30']

    def begin_axes(self, header: Sequence[str], number: int, tcp: bool) -> list[str]:
        """Header comments and modal settings."""
        notes = [*header, 'KINEMATICS OF THE MACHINE SELECTED: #KIN ID'] if tcp else [
            *header, 'G53 MUST BE WITHOUT OFFSET: G53_VERFUEGBAR 0 - NO G92, NO CS ACTIVE'
        ]  # fmt: skip
        frame = ['G54', '#TRAFO ON'] if tcp else ['G53', 'D0']
        modal = ['#TRAFO OFF', 'G71 G90 G94 G17 G40', *frame, 'G93']
        return [f'% OTF_PATH_{number}', *map(self.comment, notes), *modal]

    def move_axes(self, move: AxisMove, tcp: bool) -> list[str]:
        """Straight line; a block that turns endless axes is incremental as a whole."""
        own, mode = (move.by, 'G91') if move.endless else (move.to, 'G90')
        stop = 'G60 ' if move.stop else ''
        return [f'{stop}{mode} G01 {axis_words(own)} F{move.seconds:.3f}']

    def end_axes(self, tcp: bool) -> list[str]:
        """End of the program."""
        return [*(['#TRAFO OFF'] if tcp else []), 'G94 G90', 'M30']
