# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a chain with rotary axes: a product of transforms, exact and of first order.

The position of a reflector, seen from the link that carries the tracker, is a product of the
transforms of the joints on the way from the one to the other, inverse where the way runs from the
bed to the table. Each transform has its errors beside it (docs/conventions.md):

    linear axis a:  target side T_a (I + d_a),  table side (I + d_a) T_a      (its moving carriage)
    rotary axis a:  target side (I + d_a) T_a,  table side T_a (I + d_a)      (its side of the bed)
    location:       T_a -> D T_a D^-1

With R the rotations before the place of an error, L the reflector seen from there and s = -1 where
the joint is met in inverse sense, else 1, first order is

    e = sum over the joints met  s R (t_a + r_a x L) + R_b (D x_b) - R_a (D x_a)

where x_b and x_a are the reflector seen from before and from after the joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ShapeError
from otf_core.model.machine import BED, SPINDLE, TABLE, Axis, Machine
from otf_core.model.motions import DIRECTIONS, location_names

if TYPE_CHECKING:
    from otf_core.model.tables import ErrorTables


_UNIT = np.eye(3)
TILTS: Mapping[str, tuple[tuple[str, Array], ...]] = {
    'X': (),
    'Y': (('C0Y', -_UNIT[0]),),
    'Z': (('B0Z', _UNIT[0]), ('A0Z', -_UNIT[1])),
}
"""Squareness errors of the linear axes, and how the direction of travel changes per rad."""


@dataclass(frozen=True)
class Joint:
    """One joint on the way from the tracker to a reflector.

    Attributes
    ----------
    name : str
        Of its axis.
    inverse : bool
        Met on the way from the bed to the table.
    error_first : bool
        The place of its error motions comes before its transform.
    """

    name: str
    axis: Axis
    inverse: bool
    error_first: bool

    @property
    def sense(self) -> float:
        """-1 where it is met in inverse sense."""
        return -1.0 if self.inverse else 1.0

    @property
    def direction(self) -> Array:
        """Unit vector of its travel or its rotation, shape (3,)."""
        if self.axis.direction is not None:
            return np.array(self.axis.direction)
        return np.asarray(_UNIT['XYZ'.index(self.name)])

    @property
    def centre(self) -> Array:
        """Point about which its rotations act, shape (3,), m."""
        return np.array(self.axis.centre)

    def rotation(self, q: Array) -> Array | None:
        """Rotation matrices (n, 3, 3) at positions (n,), rad; None of a linear axis."""
        return rotations(self.sense * q, self.direction) if self.axis.rotary else None

    def apply(self, q: Array, points: Array, rotation: Array | None) -> Array:
        """Points (n, 3), m, seen from before the joint, of points seen from after it."""
        if rotation is None:
            return np.asarray(points + (self.sense * q)[:, None] * self.direction)
        return _turned(rotation, points - self.centre) + self.centre


def rotations(angle: Array, axis: Array) -> Array:
    """Rotation matrices (n, 3, 3) by angles (n,), rad, about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.asarray(_UNIT + sine * cross + rest * (cross @ cross))


def _turned(rotation: Array | None, vectors: Array) -> Array:
    """Vectors (n, 3) turned by matrices (n, 3, 3), or as they are."""
    return vectors if rotation is None else np.asarray(np.einsum('nij,nj->ni', rotation, vectors))


def _then(first: Array | None, second: Array | None) -> Array | None:
    if first is None or second is None:
        return first if second is None else second
    return first @ second


def _crossed(first: Array, second: Array) -> Array:
    """Cross products of vectors (n, 3); quicker than ``numpy.cross`` for many."""
    (a, b, c), (x, y, z) = first.T, second.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)


def _six(rotation: Array | None, sense: float, lever: Array) -> Array:
    """Displacements (n, 3, 6) by small motions (t, r) that act on ``lever`` (n, 3)."""
    six = np.zeros((len(lever), 3, 6))
    for k in range(3):
        six[:, k, k] = 1.0
        after, last = (k + 1) % 3, (k + 2) % 3
        six[:, after, 3 + k] = -lever[:, last]
        six[:, last, 3 + k] = lever[:, after]
    if rotation is not None:
        six = rotation @ six
    return sense * six if sense < 0 else six


@dataclass(frozen=True)
class Sight:
    """What a tracker sees: a reflector from the link that the tracker stands on.

    Attributes
    ----------
    frame : str
        Link of the tracker, ``w`` or ``b``: its frame is that of all positions.
    link : str
        Link of the reflector, ``w`` or ``t``.
    place : ndarray, shape (3,), m
        Of the reflector, all axes at zero.
    """

    machine: Machine
    frame: str
    link: str
    place: Array

    @classmethod
    def of_tool(cls, machine: Machine) -> Sight:
        """The target at ``target_offset`` seen from the table: what tables predict."""
        return cls(machine, TABLE, SPINDLE, machine.target_offset)

    @classmethod
    def of_target(cls, machine: Machine, name: str) -> Sight:
        """A target of machine.yaml seen by the tracker."""
        target = machine.targets[name]
        return cls(machine, machine.tracker.link, target.link, np.array(target.place))

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Joints on the way from the tracker to the reflector."""
        machine, chain = self.machine, self.machine.chain

        def joint(name: str, *, table: bool, inverse: bool) -> Joint:
            axis = machine.axes[name]
            first = table != axis.rotary  # as met from the table to the tool
            return Joint(name, axis, inverse, first != inverse)

        if self.frame == self.link:
            return ()
        table = [joint(n, table=True, inverse=self.frame == BED) for n in chain.table_side]
        target = [joint(n, table=False, inverse=False) for n in chain.target_side]
        if self.frame == BED:
            return tuple(target) if self.link == SPINDLE else tuple(table[::-1])
        return (*table, *target)

    def at(self, q: Array) -> ReflectorView:
        """Position and its derivatives at axis positions (n, k), m and rad."""
        q = np.asarray(q, dtype=float)
        if q.ndim != 2 or q.shape[1] != len(self.machine.axis_names):
            raise ShapeError(
                f'positions of {", ".join(self.machine.axis_names)} need shape '
                f'(n, {len(self.machine.axis_names)}), got {q.shape}'
            )
        return ReflectorView(self, q)

    def nominal(self, q: Array) -> Array:
        """Nominal position of the reflector, shape (n, 3), m."""
        return self.at(q).position


class ReflectorView:
    """A reflector at axis positions, nominal, and how errors move it.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad
    """

    def __init__(self, sight: Sight, q: Array) -> None:
        self.sight, self.q, machine = sight, q, sight.machine
        self._own = [q[:, machine.column(j.name)] for j in sight.joints]
        self._rotation = [j.rotation(x) for j, x in zip(sight.joints, self._own, strict=True)]
        points = np.tile(np.asarray(sight.place, dtype=float), (len(q), 1))
        after, before = [], []
        for joint, own, turn in self._joints(reverse=True):
            after.append(points)
            points = joint.apply(own, points, turn)
            before.append(points)
        self.position = points
        """Nominal position, shape (n, 3), m."""
        self._after, self._before = after[::-1], before[::-1]
        self._outer: list[Array | None] = []
        total: Array | None = None
        for turn in self._rotation:
            self._outer.append(total)
            total = _then(total, turn)
        self.inner = total
        """Rotations (n, 3, 3) of the link of the reflector; None where none turns."""

    def _joints(self, *, reverse: bool = False) -> list[tuple[Joint, Array, Array | None]]:
        joints = list(zip(self.sight.joints, self._own, self._rotation, strict=True))
        return joints[::-1] if reverse else joints

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose errors move the reflector."""
        return tuple(j.name for j in self.sight.joints)

    @cached_property
    def velocity(self) -> Array:
        """Derivative of the position by every axis of the machine, shape (n, 3, k)."""
        machine = self.sight.machine
        columns = np.zeros((len(self.q), 3, len(machine.axis_names)))
        for k, joint in enumerate(self.sight.joints):
            moved = np.broadcast_to(joint.direction, self.position.shape)
            if joint.axis.rotary:
                moved = np.cross(joint.direction, self._before[k] - joint.centre)
            column = machine.column(joint.name)
            columns[:, :, column] = joint.sense * _turned(self._outer[k], np.asarray(moved))
        return columns

    @cached_property
    def motions(self) -> dict[str, Array]:
        """Displacement per unit of the six motions of every axis met, shape (n, 3, 6)."""
        influences = {}
        for k, joint in enumerate(self.sight.joints):
            turn, lever = self._place_of_errors(k)
            influences[joint.name] = _six(turn, joint.sense, lever)
        return influences

    @cached_property
    def scalars(self) -> dict[str, Array]:
        """Displacement (n, 3) per unit of squareness and location errors met, by name."""
        influences: dict[str, Array] = {}
        for k, (joint, own, turn) in enumerate(self._joints()):
            if not joint.axis.rotary:
                for name, tilt in TILTS[joint.name]:
                    moved = joint.sense * own[:, None] * tilt
                    influences[name] = _turned(self._outer[k], moved)
                continue
            before = _six(self._outer[k], 1.0, self._before[k] - joint.centre)
            inner = _then(self._outer[k], turn)
            moved = before - _six(inner, 1.0, self._after[k] - joint.centre)
            for name in location_names(joint.name):
                influences[name] = moved[:, :, DIRECTIONS.index(name[0])]
        return influences

    def _place_of_errors(self, k: int) -> tuple[Array | None, Array]:
        """Rotations before the place of the error of a joint, and the lever of the reflector."""
        joint = self.sight.joints[k]
        if joint.error_first:
            turn, seen = self._outer[k], self._before[k]
        else:
            turn, seen = _then(self._outer[k], self._rotation[k]), self._after[k]
        return turn, seen - joint.centre if joint.axis.rotary else seen

    def displacement(self, tables: ErrorTables) -> Array:
        """First-order error of the position, shape (n, 3), m."""
        total = np.zeros_like(self.position)
        for k, (joint, own, turn) in enumerate(self._joints()):
            six = six_errors(tables, joint.name, own)
            outer, lever = self._place_of_errors(k)
            moved = six[:, :3] + _crossed(six[:, 3:], lever)
            total += joint.sense * _turned(outer, moved)
            if not joint.axis.rotary:
                for name, tilt in TILTS[joint.name]:
                    moved = (joint.sense * tables.scalar(name) * own)[:, None] * tilt
                    total += _turned(self._outer[k], moved)
                continue
            line = np.zeros(6)
            for name in location_names(joint.name):
                line[DIRECTIONS.index(name[0])] = tables.scalar(name)
            inner = _then(self._outer[k], turn)
            for sign, frame, seen in (
                (1.0, self._outer[k], self._before[k]),
                (-1.0, inner, self._after[k]),
            ):
                moved = line[:3] + _crossed(line[3:], seen - joint.centre)
                total += sign * _turned(frame, moved)
        return total


def six_errors(tables: ErrorTables, axis: str, q: Array) -> Array:
    """Errors (n, 6), m and rad, of an axis at positions (n,), by its six tables."""
    own = tables.machine.axes[axis].wrapped(q)
    return np.stack([tables.motions[f'E{d}{axis}'].at(own) for d in DIRECTIONS], axis=1)


def exact_position(tables: ErrorTables, sight: Sight, q: Array) -> Array:
    """Position of a reflector by full transforms, with all errors, shape (n, 3), m.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad
    """
    q = np.asarray(q, dtype=float)
    points = np.tile(np.asarray(sight.place, dtype=float), (len(q), 1))
    for joint in reversed(sight.joints):
        own = q[:, sight.machine.column(joint.name)]
        six = six_errors(tables, joint.name, own)
        origin = joint.centre if joint.axis.rotary else np.zeros(3)
        if not joint.error_first:
            points = _moved(six, origin, points, inverse=joint.inverse)
        points = _exact_joint(tables, joint, own, points)
        if joint.error_first:
            points = _moved(six, origin, points, inverse=joint.inverse)
    return points


def _exact_joint(tables: ErrorTables, joint: Joint, own: Array, points: Array) -> Array:
    if not joint.axis.rotary:
        tilt = sum((tables.scalar(n) * v for n, v in TILTS[joint.name]), np.zeros(3))
        across = np.sin(tilt)
        along = joint.direction * np.sqrt(1.0 - across @ across)
        return np.asarray(points + (joint.sense * own)[:, None] * (along + across))
    six = np.zeros((1, 6))
    for name in location_names(joint.name):
        six[0, DIRECTIONS.index(name[0])] = tables.scalar(name)
    points = _moved(six, joint.centre, points, inverse=True)
    points = joint.apply(own, points, joint.rotation(own))
    return _moved(six, joint.centre, points, inverse=False)


def _moved(six: Array, origin: Array, points: Array, *, inverse: bool) -> Array:
    """Points (n, 3) moved by translations and rotation vectors (n, 6) about an origin."""
    from scipy.spatial.transform import Rotation  # loaded on use: predicting needs none

    turn = Rotation.from_rotvec(six[:, 3:])
    if inverse:
        return np.asarray(turn.inv().apply(points - six[:, :3] - origin) + origin)
    return np.asarray(turn.apply(points - origin) + origin + six[:, :3])
