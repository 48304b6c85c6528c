# SPDX-License-Identifier: Apache-2.0
"""Beckhoff TwinCAT 3 CNC: G360 exact stop (modal), G53 without zero offsets, G04 X in seconds.

Source: Beckhoff TF5200 programming manual (Beckhoff Information System), sections on exact stop
(G60/G360/G359), zero offsets (G53 ... G59), dwell time (G04), units (G70/G71), G93/G94, comments
and structure of NC programs; TF5200 coordinate systems, tool offset (D0). G53 is modal there and
moves at a feed, unlike elsewhere; the channel parameter g53_verfuegbar makes it one more offset,
which the program cannot see. G60 alone would stop at the end of one block only.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import Dialect, words


class TwinCat(Dialect):
    """TwinCAT 3 CNC (TF5200)."""

    name = 'twincat'
    file_name = 'otf_path.nc'

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
