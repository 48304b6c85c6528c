# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D sl, 828D: G60 with G601 exact stop fine (modal), SUPA per block, G4 F own block.

Source: SINUMERIK 840D sl programming manuals (G60/G601 fundamentals, G4 F in seconds, SUPA
suppresses all frames for one block, G710 metric for lengths and feed).
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import Dialect, words


class Sinumerik(Dialect):
    """SINUMERIK 840D sl and 828D, G code."""

    name = 'sinumerik'
    file_name = 'OTF_PATH.MPF'

    def comment(self, text: str) -> str:
        """Comment line."""
        return f'; {text}'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings."""
        notes = (*header, 'POSITIONS ARE MACHINE COORDINATES - SUPA, D0 - LINEAR AXES X Y Z')
        return [*map(self.comment, notes), 'G17 G40 G710 G90 G94', 'G60 G601', 'D0']

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates."""
        return f'SUPA G1 {words(axes, point)} F{feed}'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [f'G4 F{seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['M0']

    def end(self) -> list[str]:
        """End of the program."""
        return ['M30']
