# SPDX-License-Identifier: Apache-2.0
"""Bearing tilt: the run-out of a rotary axis grows as another one tilts it.

delta = sin(q_b) sum over m of (S_m sin(q_a) + C_m cos(q_a)) J_m, m the tilts of axis a about the
two directions across it, b the rotary axis that tilts a. A tilt that depends on q_b alone moves
all that is on axis a alike: it is in the tables of b.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.model.machine import Machine
from otf_core.model.motions import DIRECTIONS

ACROSS = {'A': 'BC', 'B': 'AC', 'C': 'AB'}


def tilted_axis(machine: Machine) -> tuple[str, str] | None:
    """Rotary axis that another one tilts, and that one; None where there is none."""
    table = [a for a in machine.chain.table_side if machine.axes[a].rotary]
    target = [a for a in machine.chain.target_side if machine.axes[a].rotary]
    if len(table) == 2:
        return table[0], table[1]  # the table's own comes first, it is carried by the second
    return (target[1], target[0]) if len(target) == 2 else None


class BearingTilt(Effect):
    """Tilt motion of one rotary axis that depends on the position of the other."""

    name: ClassVar[str] = 'bearing_tilt'
    cause: ClassVar[str] = 'a bearing yields to a side load caused by the other rotary axis'
    equation: ClassVar[str] = 'sin(q_b) (S_m sin(q_a) + C_m cos(q_a)) J_m, m = tilts of a'
    coefficients: ClassVar[str] = 'S_m, C_m: amplitudes of the tilt motion m of a at q_b = 90 deg'
    typical: ClassVar[str] = '5 urad to 20 urad'
    source: ClassVar[str] = 'ISO 230-7 (tilt error motion), at another tilt of the axis'
    signature: ClassVar[str] = 'circles of the axis wobble more the more it is tilted'
    needs: ClassVar[str] = 'circles of the one axis at several positions of the other, three nests'
    stays_in_place: ClassVar[bool] = True

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Amplitude of the tilt motion that is strongest."""
        motion = fitted.strongest.split('_')[1]
        parts = ({f'S_{motion}': 1.0}, {f'C_{motion}': 1.0})
        pair = tilted_axis(fitted.machine)
        other = f'{pair[1]} at ' if pair else ''
        return (Size(f'of {motion}', parts, 'rad', f'amplitude with {other}90 deg'),)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return S_m and C_m of both tilt motions."""
        machine, turning = state.machine, state.turning
        pair = tilted_axis(machine)
        if turning is None or pair is None:
            return Terms((), (), (), np.zeros((len(state), 3, 0)))
        axis, other = pair
        own, by = state.q[:, machine.column(axis)], np.sin(state.q[:, machine.column(other)])
        names, columns = [], []
        for letter in ACROSS[axis]:
            influence = turning.motions[:, :, machine.column(axis), DIRECTIONS.index(letter)]
            for part, wave in (('S', np.sin(own)), ('C', np.cos(own))):
                names.append(f'{part}_E{letter}{axis}')
                columns.append(influence * (by * wave)[:, None])
        count = len(names)
        return Terms(tuple(names), ('rad',) * count, (axis,) * count, np.stack(columns, axis=2))
