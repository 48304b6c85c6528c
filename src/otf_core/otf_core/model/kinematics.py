# SPDX-License-Identifier: Apache-2.0
"""Rigid-body kinematics of the target: first order (fitted) and exact (simulated).

Machines with rotary axes: see ``joints``. What follows is the case of three linear axes, where the
position of the target is that of the axes.

First order, docs/conventions.md: e(q) = sum over axes a of t_a(q_a) + r_a(q_a) x L_a(q), plus
squareness (-C0Y y + B0Z z, -A0Z z, 0). Exact: the same chain with full rotation matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import ShapeError
from otf_core.model import joints
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES, DIRECTIONS, MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.tables import ErrorTables

Points = NDArray[np.float64]

_UNIT = np.eye(3)


def _checked(q: Points) -> Points:
    q = np.asarray(q, dtype=float)
    if q.ndim != 2 or q.shape[1] != 3:
        raise ShapeError(f'positions need shape (n, 3), got {q.shape}')
    return q


def lever(machine: Machine, axis: str, q: Points) -> Points:
    """Lever arm L_a of the rotations of one axis.

    Parameters
    ----------
    axis : str
        X, Y or Z.
    q : ndarray, shape (n, 3), m
        Programmed axis positions.

    Returns
    -------
    ndarray, shape (n, 3), m
    """
    q, carried = _checked(q), machine.chain.lever_axes(axis)
    arm = np.empty_like(q)
    for k, (name, offset) in enumerate(zip(AXES, machine.target_offset, strict=True)):
        arm[:, k] = offset + q[:, k] if name in carried else offset
    return arm


def motion_influence(machine: Machine, motion: ErrorMotion, q: Points) -> Points:
    """Displacement of the target per unit of one error motion.

    Parameters
    ----------
    q : ndarray, shape (n, 3), m

    Returns
    -------
    ndarray, shape (n, 3)
        Dimensionless for translations, m/rad for rotations.
    """
    q = _checked(q)
    unit = _UNIT[motion.along]
    if motion.is_translation:
        return np.broadcast_to(unit, q.shape)
    return turn_arms(motion.along, lever(machine, motion.axis, q))


def has_constant_lever(machine: Machine, motion: ErrorMotion, low: Points, high: Points) -> bool:
    """Return whether no other axis, from ``low`` to ``high`` (3,), m, changes how a rotation acts.

    It is a translation for whoever moves in these ranges with one target offset.
    """
    q = np.tile(low, (4, 1))
    q[1:] += np.diag(high - low)
    q[:, motion.place] = low[motion.place]
    return bool(np.ptp(motion_influence(machine, motion, q), axis=0).max() < 1e-12)


def turn_arms(along: int, arm: Points) -> Points:
    """Vector product of a unit vector of the machine frame with lever arms (n, 3).

    Several times faster than ``numpy.cross``, which counts where positions come one by one.
    """
    displacement = np.zeros_like(arm)
    _add_turned(displacement, along, arm, 1.0)
    return displacement


def _add_turned(total: Points, along: int, arm: Points, angle: Points | float) -> None:
    """Add the displacements by small angles (n,) about one axis of the machine frame."""
    after, last = (along + 1) % 3, (along + 2) % 3
    total[:, after] -= angle * arm[:, last]
    total[:, last] += angle * arm[:, after]


def squareness_influence(name: str, q: Points) -> Points:
    """Displacement of the target per rad of C0Y, B0Z or A0Z; shape (n, 3), m/rad."""
    q = _checked(q)
    zero = np.zeros(len(q))
    if name == 'C0Y':
        columns = (-q[:, 1], zero, zero)
    elif name == 'B0Z':
        columns = (q[:, 2], zero, zero)
    else:
        columns = (zero, -q[:, 2], zero)
    return np.stack(columns, axis=1)


def nominal_position(machine: Machine, q: Points) -> Points:
    """Nominal position (n, 3), m, of the target at axis positions (n, k), m and rad."""
    if machine.rotary_names:
        return joints.Sight.of_tool(machine).nominal(q)
    return _checked(q)


def displacement(tables: ErrorTables, q: Points) -> Points:
    """First-order volumetric error.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad
        Programmed axis positions.

    Returns
    -------
    ndarray, shape (n, 3), m
        Actual minus nominal position of the target relative to the table, in its frame.
    """
    if tables.machine.rotary_names:
        return joints.Sight.of_tool(tables.machine).at(q).displacement(tables)
    q = _checked(q)
    total = np.zeros_like(q)
    arms = {axis: lever(tables.machine, axis, q) for axis in AXES}
    for motion in MOTIONS:
        error = tables.motions[motion].at(q[:, motion.place])
        if motion.is_translation:
            total[:, motion.along] += error
        else:
            _add_turned(total, motion.along, arms[motion.axis], error)
    for name in SQUARENESS:
        total += tables.squareness[name].value * squareness_influence(name, q)
    return total


def _axis_directions(tables: ErrorTables) -> dict[str, Points]:
    c0y, b0z, a0z = (tables.squareness[k].value for k in SQUARENESS)
    return {
        'X': np.array([1.0, 0.0, 0.0]),
        'Y': np.array([-np.sin(c0y), np.cos(c0y), 0.0]),
        'Z': np.array(
            [np.sin(b0z), -np.sin(a0z), np.sqrt(1 - np.sin(b0z) ** 2 - np.sin(a0z) ** 2)]
        ),
    }


def exact_position(tables: ErrorTables, q: Points) -> Points:
    """Position of the target relative to the table by full homogeneous transforms.

    Target side: travel, translation error, rotation. Table side: translation error and rotation
    act on what lies between that axis and the target, its own travel included.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad

    Returns
    -------
    ndarray, shape (n, 3), m
        In the machine frame; equals q where all errors are zero. With rotary axes in the frame of
        the table, ``nominal_position`` where all errors are zero.
    """
    if tables.machine.rotary_names:
        return joints.exact_position(tables, joints.Sight.of_tool(tables.machine), q)
    from scipy.spatial.transform import Rotation  # loaded on use: predicting needs none

    q = _checked(q)
    machine, directions = tables.machine, _axis_directions(tables)
    point = np.tile(machine.target_offset, (len(q), 1))
    for axis in reversed(machine.chain.table_side + machine.chain.target_side):
        q_axis = q[:, AXES.index(axis)]
        travel = q_axis[:, None] * directions[axis]
        values = np.stack([tables.motions[f'E{d}{axis}'].at(q_axis) for d in DIRECTIONS], axis=1)
        rotation = Rotation.from_rotvec(values[:, 3:])
        if axis in machine.chain.target_side:
            point = travel + values[:, :3] + rotation.apply(point)
        else:
            point = values[:, :3] + rotation.apply(travel + point)
    return np.asarray(point - machine.target_offset)
