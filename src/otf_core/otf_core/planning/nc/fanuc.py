# SPDX-License-Identifier: Apache-2.0
"""FANUC: G61 exact stop mode, G04 X in seconds, G54 set equal to machine coordinates.

G53 moves at rapid only, so feed moves need a work offset: the operator sets G54 and the external
offset to zero; the program cannot check it and does not overwrite it. G04 P would count
milliseconds without decimal point; X with one counts seconds on mills and lathes alike.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import Dialect, plain, words


class Fanuc(Dialect):
    """FANUC series 0i and 30i, G code system of milling machines."""

    name = 'fanuc'
    file_name = 'O1001.NC'

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
