# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC: G61.1 exact stop, G53 per line, G4 P in seconds, must end in M2.

Source: LinuxCNC 2.9 interpreter ``rs274`` (the tests run it): G9 and a missing M2 are errors, G53
goes with G1, G61 alone does not stop between collinear lines. Rotary axes: LinuxCNC G-code
reference (G93: F = 1 / time in min, on every line; G61 keeps to the path). Which kinematics is
active is up to the configuration (switchable kinematics), so the operator switches it.
"""

from __future__ import annotations

from collections.abc import Sequence

from otf_core.planning.nc.dialect import Dialect, Move, Program, words


class LinuxCnc(Dialect):
    """LinuxCNC 2.8 and later."""

    name = 'linuxcnc'
    file_name = 'otf_path.ngc'
    comment_form, dwell_form = '({})', 'G4 P{:.3f}'
    unchecked = 'WHICH M CODES SWITCH THE KINEMATICS'

    def begin(self, header: Sequence[str], program: Program) -> list[str]:
        """Header comments and modal settings."""
        modal = [f'G21 G90 {program.feed_mode} G17 G40 {"G43 H1" if program.tcp else "G49"} G80']
        if not program.turns:
            return [*map(self.comment, header), *modal]
        kinematics = 'THE KINEMATICS OF THE ROTARY AXES' if program.tcp else 'IDENTITY KINEMATICS'
        switch = f'SWITCH TO {kinematics} BEFORE - M428, M429 IN THE SAMPLES OF LINUXCNC'
        notes = [*header, switch, 'WRAPPED_ROTARY MUST BE 0']
        if program.tcp:
            notes.append('G43 H1: TOOL 1 OF THE TOOL TABLE HAS THE LENGTH OF TARGET-OFFSET')
            modal.append('G54')
        return [*map(self.comment, notes), *modal]

    def move(self, move: Move, program: Program) -> list[str]:
        """Straight line in absolute angles; stops by G61.1."""
        mode, frame = 'G61.1' if move.stop else 'G61', '' if program.tcp else 'G53 '
        return [f'{mode} {frame}G1 {words(move.to)} {move.speed(program)}']

    def end(self, program: Program) -> list[str]:
        """End of the program."""
        return [*(['G49'] if program.tcp else []), 'G94', 'M2']
