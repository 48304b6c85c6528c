# SPDX-License-Identifier: Apache-2.0
"""Load tilt: a workpiece off the axis of a tilting table twists its drive and bearings.

delta = sum over k of L_k (n_a . (e_k(q) x g)) J_a: e_k is a unit vector of the table as it lies
now, g the direction of gravity, -Z of the machine, n_a the direction of the tilting axis and J_a
the displacement per rad of its angular positioning. The torque of a load depends on the angles of
both axes; what depends on the tilting axis alone is in its tables.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.base import Coefficients, Effect, Shape, Size, State, Terms
from otf_core.effects.sizes import vector_size
from otf_core.effects.terms import POSITIONING
from otf_core.model.frames import XYZ
from otf_core.model.machine import BED, TABLE, Machine

LEVEL = 0.9
"""Component along Z from which an axis is upright: gravity has no torque about it."""
DOWN = np.array([0.0, 0.0, -1.0])


def tilting_axes(machine: Machine) -> tuple[str, ...]:
    """Rotary axes on the side of the table that gravity can twist."""
    own = (a for a in machine.chain.table_side if machine.axes[a].rotary)
    return tuple(a for a in own if abs((machine.axes[a].direction or (0, 0, 1))[2]) < LEVEL)


class LoadTilt(Effect):
    """Tilting axis that gives way under an eccentric load."""

    name: ClassVar[str] = 'load_tilt'
    cause: ClassVar[str] = 'the eccentric weight of table and workpiece twists drive and trunnion'
    equation: ClassVar[str] = 'L_k (n_a . (e_k x g)) J_a, k = X, Y, Z of the table'
    coefficients: ClassVar[str] = (
        'L_k_a: twist of axis a while its load, eccentric along k of the table, is at the height '
        'of the axis'
    )
    typical: ClassVar[str] = '5 urad to 50 urad with a heavy workpiece; 2 um to 20 um at 200 mm'
    source: ClassVar[str] = 'torque of an eccentric weight divided by the stiffness of the drive'
    signature: ClassVar[str] = (
        'the tilting axis deviates by an angle that changes with the angle of the table on it'
    )
    needs: ClassVar[str] = (
        'the tracker on the bed, targets on the table, and both axes moving together; for a load '
        'on the axis of the table two runs, with and without it'
    )

    def sizes(self, fitted: Coefficients) -> tuple[Size, ...]:
        """Largest twist."""
        return tuple(
            vector_size(
                fitted,
                [{f'L_{k}_{a}': 1.0} for k in XYZ],
                'rad',
                'largest twist',
                f'of {a}',
                'under a load along',
            )
            for a in fitted.axes
        )

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return L_X_a, L_Y_a, L_Z_a of every tilting axis a."""
        machine, turning = state.machine, state.turning
        axes = tilting_axes(machine)
        columns = np.zeros((len(state), 3, 3 * len(axes)))
        if turning is not None and machine.tracker.link == BED:
            on_table = _on_table(state)[:, None]
            for number, axis in enumerate(axes):
                direction = np.array(machine.axes[axis].direction)
                arm = np.einsum('i,nij->nj', np.cross(DOWN, direction), turning.link) * on_table
                influence = turning.motions[:, :, machine.column(axis), POSITIONING[axis]]
                columns[:, :, 3 * number : 3 * number + 3] = influence[:, :, None] * arm[:, None]
        names = tuple(f'L_{k}_{a}' for a in axes for k in XYZ)
        owners = tuple(a for a in axes for _ in XYZ)
        return Terms(names, ('rad',) * len(names), owners, columns)


def _on_table(state: State) -> Array:
    """Which targets are on the table, shape (n,)."""
    assert state.turning is not None
    links = np.array([t.link == TABLE for t in state.machine.targets.values()])
    return np.asarray(links[state.turning.target])
