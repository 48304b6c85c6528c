# SPDX-License-Identifier: Apache-2.0
"""How a smooth function of inputs may act on the measured point: columns per unit of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.effects.terms import Shape, State, Terms
from otf_core.model.frames import XYZ

Acting = Callable[[State, Shape], Terms]
"""What the function is multiplied with, one term for every direction or rotation."""

VECTOR, DIRECTION, RIGID_TRACKER, RIGID_TABLE = (
    'vector',
    'direction',
    'rigid_tracker',
    'rigid_table',
)


def _unit_columns(state: State) -> Array:
    return np.broadcast_to(np.eye(3), (len(state), 3, 3))


def vector(state: State, shape: Shape) -> Terms:
    """Shifts along X, Y, Z."""
    return Terms.of(XYZ, 'm', _unit_columns(state), XYZ)


def rigid_tracker(state: State, shape: Shape) -> Terms:
    """Shifts, and turns about the tracker."""
    return _rigid(state, state.beam)


def rigid_table(state: State, shape: Shape) -> Terms:
    """Shifts, and turns about the zero point of the machine."""
    return _rigid(state, state.point)


def _rigid(state: State, arm: Array) -> Terms:
    shifts = Terms.of([f'M_{a}' for a in XYZ], 'm', _unit_columns(state))
    return Terms.joined(shifts, turns(arm))


def turns(arm: Array) -> Terms:
    """Turns W_X, W_Y, W_Z of vectors (n, 3)."""
    columns = np.stack([np.cross(e, arm) for e in np.eye(3)], axis=2)
    return Terms.of([f'W_{a}' for a in XYZ], 'rad', columns)


def turned_by_axis(state: State, shape: Shape) -> Terms:
    """Turns about the tracker, tilt_X_by_X ... tilt_Z_by_Z: those of each axis that moves."""
    return _turns_by_axis(state, state.beam, 'tilt')


def turned_about_zero_by_axis(state: State, shape: Shape) -> Terms:
    """Turns about the zero point of the machine, turn_X_by_X ... turn_Z_by_Z, see above."""
    return _turns_by_axis(state, state.q, 'turn')


def _turns_by_axis(state: State, arm: Array, head: str) -> Terms:
    turned = [np.cross(e, arm) for e in np.eye(3)]
    axes = state.machine.axis_names
    names = tuple(f'{head}_{k}_by_{a}' for k in XYZ for a in axes)
    columns = np.stack([turn for turn in turned for _ in axes], axis=2)
    return Terms.of(names, 'rad', columns, axes * 3)


RIGID_MOTIONS: tuple[Acting, ...] = (
    vector, rigid_tracker, rigid_table, turned_by_axis, turned_about_zero_by_axis,
)  # fmt: skip
"""Ways to act that shift or turn tracker, table or target as a whole."""
ACTING: dict[str, Acting] = {
    VECTOR: vector,
    RIGID_TRACKER: rigid_tracker,
    RIGID_TABLE: rigid_table,
}
"""Ways to act that need no effect."""


@dataclass(frozen=True)
class Along:
    """Shift along one direction.

    Attributes
    ----------
    direction : tuple of three floats
        Unit vector, machine frame.
    """

    direction: tuple[float, float, float]

    def __call__(self, state: State, shape: Shape) -> Terms:
        """Return the one term."""
        column = np.broadcast_to(np.array(self.direction)[:, None], (len(state), 3, 1))
        return Terms.of(['along'], 'm', column)


def acting_name(acts: Acting | None) -> str:
    """Name of a way to act, as files have it."""
    if isinstance(acts, Along):
        return DIRECTION
    return next(name for name, known in ACTING.items() if known is acts)
