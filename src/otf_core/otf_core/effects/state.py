# SPDX-License-Identifier: Apache-2.0
"""The state of measured points: of path pieces for the fit, of samples for the simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.effects.history import joint_history, path_history
from otf_core.effects.terms import State, Turning
from otf_core.model.axis_path import travel_per_unit
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import sides_of_travel
from otf_core.model.signals import Courses
from otf_core.model.tables import ErrorTables
from otf_core.tracking.curves import Lines, PathShape, straight_shape


def state_on_path(
    machine: Machine,
    corners: Array,
    leg: NDArray[np.int64],
    q: Array,
    speed: Array,
    time: Array,
    T_machine_tracker: RigidTransform,
    nodes: Mapping[str, Array],
    tables: ErrorTables | None = None,
    duration: float = 0.0,
    shape: PathShape | None = None,
    signals: Courses | None = None,
    starts: Array | None = None,
) -> State:
    """Describe points of a path.

    Parameters
    ----------
    corners : ndarray, shape (m + 1, 3), m
        Leg j runs from corner j to corner j + 1.
    leg : ndarray of int64, shape (n,)
    q : ndarray, shape (n, 3), m
        Nominal positions on those legs.
    speed : ndarray, shape (n,), m/s
    time : ndarray, shape (n,), s
    nodes : mapping of axis to ndarray, m
    duration : float, s
        Length of the recording; 0 stands for the time of the last point.
    shape : PathShape, optional
        Which legs are chords of curves; none without it.
    signals : Courses, optional
        Recorded beside the samples.
    starts : ndarray, shape (m,), s, optional
        When the legs began; as their first points tell if not given, or where NaN.
    """
    lines = Lines.of(shape or straight_shape(corners))
    unit, stretch = lines.unit, lines.shape.stretch
    along = lines.start[leg] + np.clip(lines.along(q, leg), 0.0, lines.length[leg])
    after = np.searchsorted(stretch, stretch[leg], side='right')
    history = path_history(lines, leg, q, speed, time, starts)
    return State(
        machine=machine,
        q=q,
        direction=unit[leg],
        speed=speed,
        time=time,
        from_corner=along,
        to_corner=lines.total[leg] - along,
        side=sides_of_travel(unit)[leg],
        before=unit[np.maximum(stretch[leg] - 1, 0)],
        after=unit[np.minimum(after, len(unit) - 1)],
        beam=q - T_machine_tracker.translation,
        R_machine_tracker=T_machine_tracker.rotation,
        nodes=nodes,
        tables=tables,
        duration=duration,
        more=history if signals is None else signals.beside(history),
    )


STANDS = 1e-9
"""Share of the speed of the axes below which one of them stands."""


def state_in_parts(
    machine: Machine,
    targets: Sequence[str],
    places: Mapping[str, Array],
    part: Index,
    stretch: Index,
    q: Array,
    rates: Array,
    side: Array,
    time: Array,
    pose: RigidTransform,
    nodes: Mapping[str, Array],
    tables: ErrorTables | None = None,
    duration: float = 0.0,
    spread: Array | None = None,
) -> State:
    """Describe points of a run of a machine with rotary axes.

    Parameters
    ----------
    targets : sequence of str
        Of every part.
    places : mapping of target to ndarray, shape (3,), m
    part, stretch : ndarray of int64, shape (n,)
        Part of every point, and smooth stretch of its path, counted through the run.
    q : ndarray, shape (n, k), m and rad
    rates : ndarray, shape (n, k), m/s and rad/s
    side : ndarray, shape (n, k)
        Sense of the last travel of every axis.
    time : ndarray, shape (n,), s
    pose : RigidTransform
        Tracker to the link that it stands on.
    nodes : mapping of axis to ndarray, m and rad
    spread : ndarray, shape (n, k), m and rad, optional
        Standard deviation of the positions that a point stands for.
    """
    axes = machine.axis_names
    turning, speed = _turning(machine, targets, places, part, q, rates, pose)
    if spread is not None:
        turning = replace(turning, spread=spread)
    along = rates * travel_per_unit(machine)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.where(np.abs(along) > STANDS * size, along, 0.0)
    direction = along / np.maximum(size, 1e-300)
    zero = np.zeros(len(q))
    return State(
        machine=machine,
        q=q,
        direction=direction,
        speed=speed,
        time=time,
        from_corner=zero,
        to_corner=zero,
        side=side,
        before=direction,
        after=direction,
        beam=turning.point - pose.translation,
        R_machine_tracker=pose.rotation,
        nodes=nodes,
        tables=tables,
        duration=duration,
        more=joint_history(axes, part, stretch, q, side, time),
        turning=turning,
    )


def _turning(
    machine: Machine,
    targets: Sequence[str],
    places: Mapping[str, Array],
    part: Index,
    q: Array,
    rates: Array,
    pose: RigidTransform,
) -> tuple[Turning, Array]:
    """What a machine with rotary axes adds, and speeds of the target, shape (n,), m/s."""
    count = len(q)
    point, velocity, facing = (np.zeros((count, 3)) for _ in range(3))
    motions = np.zeros((count, 3, len(machine.axis_names), 6))
    link = np.tile(np.eye(3), (count, 1, 1))
    for number, name in enumerate(targets):
        own = part == number
        if not own.any():
            continue
        sight = Sight(machine, machine.tracker.link, machine.targets[name].link, places[name])
        seen = sight.at(q[own])
        point[own] = seen.position
        velocity[own] = np.einsum('nij,nj->ni', seen.velocity, rates[own])
        if seen.inner is not None:
            link[own] = seen.inner
        to_tracker = pose.translation - point[own][0]
        axis = link[own][0].T @ (to_tracker / np.linalg.norm(to_tracker))
        facing[own] = link[own] @ axis
        for letter, six in seen.motions.items():
            motions[own, :, machine.column(letter)] = six
    numbers = np.array([list(machine.targets).index(name) for name in targets])
    again = np.array([list(targets[:k]).count(name) for k, name in enumerate(targets)])
    spread = np.zeros_like(q)
    turning = Turning(
        point, rates, motions, link, part, numbers[part], again[part], facing, spread
    )
    return turning, np.linalg.norm(velocity, axis=1)


def state_of_travel(machine: Machine, q: Array, direction: Array) -> State:
    """Points of which only place and direction of travel are known.

    For effects that depend on nothing else; all the rest is zero.

    Parameters
    ----------
    q, direction : ndarray, shape (n, 3), m and 1
    """
    zero, vector = np.zeros(len(q)), np.zeros_like(q)
    return State(
        machine=machine,
        q=q,
        direction=direction,
        speed=zero,
        time=zero,
        from_corner=zero,
        to_corner=zero,
        side=direction,
        before=direction,
        after=direction,
        beam=vector,
        R_machine_tracker=np.eye(3),
        nodes={},
    )


def probe_state(machine: Machine) -> State:
    """Targets in the middle of all ranges, every axis moving: for names and units of terms."""
    names, axes = list(machine.targets), range(len(machine.axis_names))
    middle = np.tile(0.5 * (machine.lower + machine.upper), (len(names), 1))
    ones = np.ones((len(names), len(axes)))
    part = np.arange(len(names))
    return state_in_parts(
        machine,
        names,
        {n: np.array(t.place) for n, t in machine.targets.items()},
        part,
        part,
        middle,
        ones,
        ones,
        np.ones(len(names)),
        RigidTransform(np.eye(3), np.array([-1.0, 0.0, 0.0])),
        {a: axis_nodes(machine.axes[a]) for a in machine.axis_names},
    )
