# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a chain of linear and rotary axes: a product of transforms, exact and first order.

The position of a reflector, seen from the link that carries the tracker, is a product of the
transforms of the joints on the way from the one to the other, inverse where the way runs from the
bed to the table. Each transform has its errors beside it (docs/conventions.md):

    linear axis a:  target side T_a (I + d_a),  table side (I + d_a) T_a      (its moving carriage)
    rotary axis a:  target side (I + d_a) T_a,  table side T_a (I + d_a)      (its side of the bed)
    location:       T_a -> D T_a D^-1

With R the rotations before the place of an error, L the reflector seen from there and s = -1 where
the joint is met in inverse sense, else 1, first order is

    e = sum over the joints met  s R (t_a + r_a x L) + R_b (D x_b) - R_a (D x_a)

where x_b and x_a are the reflector seen from before and from after the joint. Squareness turns the
direction of travel of a linear axis. Without a rotary axis every R is the identity, and positions
are counted from ``target_offset``: that of the target is q itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ShapeError
from otf_core.model.evaluation import evenly_spread
from otf_core.model.machine import BED, SPINDLE, TABLE, Axis, Machine
from otf_core.model.motions import DIRECTIONS, ErrorMotion, is_motion, location_names

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

    def tilt(self, tables: ErrorTables) -> Array:
        """Change of the direction of a linear axis by squareness errors, shape (3,)."""
        tilts = TILTS[self.name]
        return sum((tables.scalar(n) * v for n, v in tilts if n in tables.squareness), np.zeros(3))

    def line(self, tables: ErrorTables) -> Array:
        """Small motion (1, 6), m and rad, of the line of a rotary axis by location errors."""
        six = np.zeros((1, 6))
        for name in location_names(self.name):
            six[0, DIRECTIONS.index(name[0])] = tables.scalar(name)
        return six

    def rotation(self, q: Array) -> Array | None:
        """Rotation matrices (n, 3, 3) at positions (n,), rad; None of a linear axis."""
        return rotations(self.sense * q, self.direction) if self.axis.rotary else None

    def apply(self, q: Array, points: Array, rotation: Array | None) -> Array:
        """Points (n, 3), m, seen from before the joint, of points seen from after it."""
        if rotation is None:
            return np.asarray(points + np.outer(self.sense * self.direction, q).T)
        return _turned(rotation, points - self.centre) + self.centre


def rotations(angle: Array, axis: Array) -> Array:
    """Rotation matrices (n, 3, 3) by angles (n,), rad, about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.asarray(_UNIT + sine * cross + rest * (cross @ cross))


def _repeated(vector: Array, count: int) -> Array:
    """One vector (3,) as many, (n, 3); columns lie together, which is twice as fast."""
    return np.repeat(vector[:, None], count, axis=1).T


def _turned(rotation: Array | None, vectors: Array) -> Array:
    """Vectors (n, 3) turned by matrices (n, 3, 3), or as they are."""
    return vectors if rotation is None else np.asarray(np.einsum('nij,nj->ni', rotation, vectors))


def _then(first: Array | None, second: Array | None) -> Array | None:
    if first is None or second is None:
        return first if second is None else second
    return first @ second


def _displaced(rotation: Array | None, six: Array, lever: Array) -> Array:
    """Displacements (n, 3) by small motions (n, 6) that act on ``lever``, before rotations."""
    (t_x, t_y, t_z, a, b, c), (x, y, z) = six.T, lever.T
    moved = np.array([t_x + b * z - c * y, t_y + c * x - a * z, t_z + a * y - b * x]).T
    return _turned(rotation, moved)


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

    @property
    def origin(self) -> Array:
        """Place from which positions are counted, shape (3,), m."""
        return np.zeros(3) if self.machine.rotary_names else self.machine.target_offset

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
        self.sight, self.q = sight, q
        self._own = [q[:, sight.machine.column(j.name)] for j in sight.joints]
        self._turn = [j.rotation(x) for j, x in zip(sight.joints, self._own, strict=True)]
        self._frame: list[Array | None] = [None]  # rotations before each joint, then of the link
        for turn in self._turn:
            self._frame.append(_then(self._frame[-1], turn))

    @property
    def inner(self) -> Array | None:
        """Rotations (n, 3, 3) of the link of the reflector; None where none turns."""
        return self._frame[-1]

    @property
    def position(self) -> Array:
        """Nominal position, shape (n, 3), m."""
        return self._seen[0]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose errors move the reflector."""
        return tuple(j.name for j in self.sight.joints)

    @cached_property
    def _seen(self) -> list[Array]:
        """The reflector (n, 3), m, seen from before each joint, then from its own link."""
        joints = list(zip(self.sight.joints, self._own, self._turn, strict=True))
        seen = [_repeated(self.sight.place - self.sight.origin, len(self.q))]
        for joint, own, turn in reversed(joints):
            seen.append(joint.apply(own, seen[-1], turn))
        return seen[::-1]

    def _arm(self, k: int, place: int) -> Array:
        """The reflector seen from before (0) or after (1) a joint, from where rotations act."""
        pivot = self.sight.joints[k].centre - self.sight.origin
        return self._seen[k + place] - pivot if pivot.any() else self._seen[k + place]

    @cached_property
    def places(self) -> dict[str, tuple[Array | None, Array]]:
        """Where the errors of every axis met act.

        Rotations (n, 3, 3) before that place, None where none turns, and the lever arm (n, 3), m,
        of the reflector from there.
        """
        places = {}
        for k, joint in enumerate(self.sight.joints):
            after = 0 if joint.error_first else 1
            places[joint.name] = self._frame[k + after], self._arm(k, after)
        return places

    @cached_property
    def velocity(self) -> Array:
        """Derivative of the position by every axis of the machine, shape (n, 3, k)."""
        machine = self.sight.machine
        columns = np.zeros((len(self.q), 3, len(machine.axis_names)))
        for k, joint in enumerate(self.sight.joints):
            moved = np.broadcast_to(joint.direction, self.position.shape)
            if joint.axis.rotary:
                moved = np.cross(joint.direction, self._arm(k, 0))
            column = machine.column(joint.name)
            columns[:, :, column] = joint.sense * _turned(self._frame[k], np.asarray(moved))
        return columns

    @cached_property
    def motions(self) -> dict[str, Array]:
        """Displacement per unit of the six motions of every axis met, shape (n, 3, 6)."""
        joints = zip(self.sight.joints, self.places.values(), strict=True)
        return {j.name: _six(turn, j.sense, lever) for j, (turn, lever) in joints}

    @cached_property
    def scalars(self) -> dict[str, Array]:
        """Displacement (n, 3) per unit of squareness and location errors met, by name."""
        influences: dict[str, Array] = {}
        for k, (joint, own) in enumerate(zip(self.sight.joints, self._own, strict=True)):
            if not joint.axis.rotary:
                for name, tilt in TILTS[joint.name]:
                    if name in self.sight.machine.squareness:
                        moved = np.outer(joint.sense * tilt, own).T
                        influences[name] = _turned(self._frame[k], moved)
                continue
            moved = _six(self._frame[k], 1.0, self._arm(k, 0))
            moved -= _six(self._frame[k + 1], 1.0, self._arm(k, 1))
            for name in location_names(joint.name):
                influences[name] = moved[:, :, DIRECTIONS.index(name[0])]
        return influences

    def influence(self, name: str) -> Array:
        """Displacement (n, 3) per unit of one error motion, squareness or location error.

        Zero where the reflector does not meet its axis.
        """
        if not is_motion(name):
            return self.scalars.get(name, np.zeros((len(self.q), 3)))
        motion = ErrorMotion.of(name)
        moved = _repeated(np.zeros(3), len(self.q))
        if motion.axis not in self.axes:
            return moved
        turn, lever = self.places[motion.axis]
        sense = self.sight.joints[self.axes.index(motion.axis)].sense
        if motion.is_translation:
            moved[:, motion.along] = sense
        else:
            after, last = (motion.along + 1) % 3, (motion.along + 2) % 3
            moved[:, after], moved[:, last] = -sense * lever[:, last], sense * lever[:, after]
        return _turned(turn, moved)

    def displacement(self, tables: ErrorTables) -> Array:
        """First-order error of the position, shape (n, 3), m."""
        total = _repeated(np.zeros(3), len(self.q))
        for k, (joint, own) in enumerate(zip(self.sight.joints, self._own, strict=True)):
            turn, lever = self.places[joint.name]
            total += joint.sense * _displaced(turn, six_errors(tables, joint.name, own), lever)
            if joint.axis.rotary:
                line = joint.line(tables)
                total += _displaced(self._frame[k], line, self._arm(k, 0))
                total -= _displaced(self._frame[k + 1], line, self._arm(k, 1))
            else:
                tilted = np.outer(joint.sense * joint.tilt(tables), own).T
                total += _turned(self._frame[k], tilted)
        return total


def nominal_position(machine: Machine, q: Array) -> Array:
    """Nominal position (n, 3), m, of the target at axis positions (n, k), m and rad.

    In the frame of the table; q itself for a machine with three linear axes.
    """
    return Sight.of_tool(machine).nominal(q)


def displacement(tables: ErrorTables, q: Array) -> Array:
    """First-order volumetric error.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad
        Programmed axis positions.

    Returns
    -------
    ndarray, shape (n, 3), m
        Actual minus nominal position of the target relative to the table, in its frame.

    Raises
    ------
    ShapeError
        If the positions are not those of the axes of the machine.
    """
    return Sight.of_tool(tables.machine).at(q).displacement(tables)


def has_constant_lever(machine: Machine, motion: ErrorMotion, low: Array, high: Array) -> bool:
    """Return whether no other axis, from ``low`` to ``high`` (k,), changes how a rotation acts.

    It is a translation of its axis for whoever moves in these ranges with one target offset.
    """
    q, own = evenly_spread(low, high, 16), machine.column(motion.axis)
    q[:, own] = low[own]
    return bool(np.ptp(turn_as_translation(machine, motion, q), axis=0).max() < 1e-12)


def turn_as_translation(machine: Machine, motion: ErrorMotion, q: Array) -> Array:
    """Translations (n, 3), m/rad, of an axis that act at q (n, k) as one of its rotations."""
    six = Sight.of_tool(machine).at(q).motions[motion.axis]
    return np.asarray(np.einsum('nji,nj->ni', six[:, :, :3], six[:, :, 3 + motion.along]))


def six_errors(tables: ErrorTables, axis: str, q: Array) -> Array:
    """Errors (n, 6), m and rad, of an axis at positions (n,), by its six tables."""
    own = tables.machine.axes[axis].wrapped(q)
    return np.array([tables.motions[f'E{d}{axis}'].at(own) for d in DIRECTIONS]).T


def exact_position(tables: ErrorTables, q: Array, sight: Sight | None = None) -> Array:
    """Position of a reflector by full transforms, with all errors.

    Parameters
    ----------
    q : ndarray, shape (n, k), m and rad
    sight : Sight, optional
        Of the reflector; the target seen from the table unless given.

    Returns
    -------
    ndarray, shape (n, 3), m
        In the frame of the link of the tracker; ``nominal`` where all errors are zero.
    """
    sight = sight or Sight.of_tool(tables.machine)
    view = sight.at(q)
    points = _repeated(sight.place - sight.origin, len(q))
    for joint in reversed(sight.joints):
        own = view.q[:, sight.machine.column(joint.name)]
        six, origin = six_errors(tables, joint.name, own), joint.centre - sight.origin
        if not joint.error_first:
            points = _moved(six, origin, points, inverse=joint.inverse)
        points = _exact_joint(tables, joint, own, points)
        if joint.error_first:
            points = _moved(six, origin, points, inverse=joint.inverse)
    return points


def _exact_joint(tables: ErrorTables, joint: Joint, own: Array, points: Array) -> Array:
    if not joint.axis.rotary:
        across = np.sin(joint.tilt(tables))
        along = joint.direction * np.sqrt(1.0 - across @ across)
        return np.asarray(points + (joint.sense * own)[:, None] * (along + across))
    line = joint.line(tables)
    points = _moved(line, joint.centre, points, inverse=True)
    points = joint.apply(own, points, joint.rotation(own))
    return _moved(line, joint.centre, points, inverse=False)


def _moved(six: Array, origin: Array, points: Array, *, inverse: bool) -> Array:
    """Points (n, 3) moved by translations and rotation vectors (n, 6) about an origin."""
    from scipy.spatial.transform import Rotation  # loaded on use: predicting needs none

    turn = Rotation.from_rotvec(six[:, 3:])
    if inverse:
        return np.asarray(turn.inv().apply(points - six[:, :3] - origin) + origin)
    return np.asarray(turn.apply(points - origin) + origin + six[:, :3])
