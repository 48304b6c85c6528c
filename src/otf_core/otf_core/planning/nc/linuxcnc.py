# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: G61.1 exact stop, G53 per line, G4 P in seconds, must end in M2.

Source: LinuxCNC 2.9 interpreter ``rs274`` (the tests run it): G9 and a missing M2 are errors, G53
goes with G1, G61 alone does not stop between collinear lines.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import Dialect, words


class LinuxCnc(Dialect):
    """LinuxCNC 2.8 and later."""

    name = 'linuxcnc'
    file_name = 'otf_path.ngc'

    def comment(self, text: str) -> str:
        """Comment line."""
        return f'({text})'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings."""
        return [*map(self.comment, header), 'G21 G90 G94 G17 G40 G49 G80', 'G61.1']

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates."""
        return f'G53 G1 {words(axes, point, decimals=self.decimals)} F{feed}'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [f'G4 P{seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['M0']

    def end(self) -> list[str]:
        """End of the program."""
        return ['M2']
