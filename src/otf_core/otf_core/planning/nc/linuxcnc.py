# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: G61.1 exact stop, G53 per line, G4 P in seconds, must end in M2.

Source: LinuxCNC 2.9 interpreter ``rs274`` (the tests run it): G9 and a missing M2 are errors, G53
goes with G1, G61 alone does not stop between collinear lines. Rotary axes: LinuxCNC G-code
reference (G93: F = 1 / time in min, on every line; G61 keeps to the path). Which kinematics is
active is up to the configuration (switchable kinematics), so the operator switches it.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.arrays import Array
from otf_core.planning.nc.dialect import AxisMove, Dialect, axis_words, words


class LinuxCnc(Dialect):
    """LinuxCNC 2.8 and later."""

    name = 'linuxcnc'
    file_name = 'otf_path.ngc'
    unchecked = 'WHICH M CODES SWITCH THE KINEMATICS'

    def comment(self, text: str) -> str:
        """Comment line."""
        return f'({text})'

    def begin(self, header: Sequence[str]) -> list[str]:
        """Header comments and modal settings."""
        return [*map(self.comment, header), 'G21 G90 G94 G17 G40 G49 G80', 'G61.1']

    def move(self, axes: str, point: Array, feed: int) -> str:
        """Straight line in machine coordinates."""
        return f'G53 G1 {words(axes, point)} F{feed}'

    def dwell(self, seconds: float) -> list[str]:
        """Standstill."""
        return [f'G4 P{seconds:.3f}']

    def wait(self) -> list[str]:
        """Program stop until the operator goes on."""
        return ['M0']

    def end(self) -> list[str]:
        """End of the program."""
        return ['M2']

    def begin_axes(self, header: Sequence[str], number: int, tcp: bool) -> list[str]:
        """Header comments and modal settings."""
        kinematics = 'THE KINEMATICS OF THE ROTARY AXES' if tcp else 'IDENTITY KINEMATICS'
        notes = (
            *header,
            f'SWITCH TO {kinematics} BEFORE - M428, M429 IN THE SAMPLES OF LINUXCNC',
            'WRAPPED_ROTARY MUST BE 0',
            *(['G43 H1: TOOL 1 OF THE TOOL TABLE HAS THE LENGTH OF TARGET-OFFSET'] if tcp else []),
        )
        length = 'G43 H1' if tcp else 'G49'
        modal = [f'G21 G90 G94 G17 G40 {length} G80', *(['G54'] if tcp else []), 'G61', 'G93']
        return [*map(self.comment, notes), *modal]

    def move_axes(self, move: AxisMove, tcp: bool) -> list[str]:
        """Straight line in absolute angles; stops by G61.1."""
        frame = '' if tcp else 'G53 '
        stop = 'G61.1' if move.stop else 'G61'
        return [f'{stop} {frame}G1 {axis_words(move.to)} F{move.per_minute:.3f}']

    def end_axes(self, tcp: bool) -> list[str]:
        """End of the program."""
        return [*(['G49'] if tcp else []), 'G94', 'M2']
