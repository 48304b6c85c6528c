# SPDX-License-Identifier: Apache-2.0
"""The state of measured points: of path pieces for the fit, of samples for the simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.effects.terms import State, Turning
from otf_core.model.axis_path import travel_per_unit
from otf_core.model.chain import Sight
from otf_core.model.frames import XYZ, RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import MOVING, sides_of_travel
from otf_core.model.signals import Courses
from otf_core.model.tables import ErrorTables
from otf_core.tracking.curves import Lines, PathShape, straight_shape

# What happened before on the path: travel since a reversal, time since a stop, laps. Between
# corners the target moves along straight lines, so the travel of an axis since it last reversed
# is known from the path alone; the moment at which a leg began is that of its first point less
# the way from the corner at the speed there.

SLOWEST = 1e-3
"""m/s; least speed with which the way from a corner is turned into a time."""
SAME_POINT = 1e-4
"""m; raster by which lines are told apart when laps are counted."""


def travel_at_start(unit: Array, length: Array) -> Array:
    """Travel of each axis since it last reversed, where each leg begins, shape (m, 3), m.

    Parameters
    ----------
    unit : ndarray, shape (m, 3)
        Unit directions of the legs in driving order.
    length : ndarray, shape (m,), m
    """
    sense = np.where(np.abs(unit) > MOVING, np.sign(unit), 0.0)
    travels = np.zeros_like(unit)
    for axis in range(3):
        last, travel = 0.0, 0.0
        for leg, now in enumerate(sense[:, axis].tolist()):
            if now and now != last:
                last, travel = now, 0.0
            travels[leg, axis] = travel
            travel += abs(float(unit[leg, axis])) * float(length[leg])
    return travels


def lap_numbers(corners: Array) -> Array:
    """How often the line of each leg was driven before, in either sense, shape (m,)."""
    raster = np.rint(corners / SAME_POINT).astype(np.int64).tolist()
    seen: dict[frozenset[tuple[int, ...]], int] = {}
    numbers = np.zeros(max(len(raster) - 1, 0))
    for leg in range(len(numbers)):
        line = frozenset((tuple(raster[leg]), tuple(raster[leg + 1])))
        numbers[leg] = seen.get(line, 0)
        seen[line] = seen.get(line, 0) + 1
    return numbers


def path_history(
    lines: Lines,
    leg: Index,
    q: Array,
    speed: Array,
    time: Array,
    starts: Array | None = None,
) -> dict[str, Array]:
    """Inputs of points on a path that depend on what was driven before.

    Parameters
    ----------
    leg : ndarray of int64, shape (n,)
        In driving order.
    q : ndarray, shape (n, 3), m
    speed, time : ndarray, shape (n,), m/s and s
    starts : ndarray, shape (m,), s, optional
        When the legs began, where that is known; NaN elsewhere.
    """
    if not len(leg):
        return {}
    along = np.clip(lines.along(q, leg), 0.0, lines.length[leg])
    start = travel_at_start(lines.unit, lines.length)
    since = start[leg] + np.abs(lines.unit[leg]) * along[:, None]
    bounds = np.flatnonzero(np.diff(leg, prepend=leg[0] - 1))
    count = np.diff(np.append(bounds, len(leg)))
    began = time[bounds] - along[bounds] / np.maximum(speed[bounds], SLOWEST)
    if starts is not None:
        known = starts[leg[bounds]]
        began = np.where(np.isfinite(known), known, began)
    return {
        **{f'since_reversal_{a.lower()}': since[:, k] for k, a in enumerate(XYZ)},
        'since_stop': np.maximum(time - np.repeat(began, count), 0.0),
        'acceleration': _acceleration(speed, time, bounds, bounds + count - 1),
        'lap': lap_numbers(lines.corners)[leg],
        'leg': leg.astype(np.float64),
    }


def joint_history(
    axes: Sequence[str], part: Index, stretch: Index, q: Array, side: Array, time: Array
) -> dict[str, Array]:
    """The same of points of a machine with rotary axes, as far as the points themselves tell.

    Parameters
    ----------
    axes : sequence of str
        Names of the axes, in the order of the columns.
    part, stretch : ndarray of int64, shape (n,)
        In driving order.
    q, side : ndarray, shape (n, k)
        Positions, m and rad, and senses of the last travel.
    time : ndarray, shape (n,), s
    """
    step = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    other_part = np.diff(part, prepend=-1) != 0
    since_reversal = {}
    for k, axis in enumerate(axes):
        new = other_part | (np.diff(side[:, k], prepend=0.0) != 0.0)
        travel = np.cumsum(np.where(other_part, 0.0, step[:, k]))
        begin = np.maximum.accumulate(np.where(new, np.arange(len(q)), 0))
        since_reversal[f'since_reversal_{axis.lower()}'] = travel - travel[begin]
    begin = np.maximum.accumulate(
        np.where(np.diff(stretch, prepend=-1) != 0, np.arange(len(q)), 0)
    )
    nothing = np.zeros(len(q))
    return {
        **since_reversal,
        'since_stop': time - time[begin],
        'acceleration': nothing,
        'lap': nothing,
        'leg': stretch.astype(np.float64),
    }


def _acceleration(speed: Array, time: Array, first: Index, last: Index) -> Array:
    """Change of speed along the legs between first and last points, shape (n,), m/s^2."""
    if len(time) < 2 or not np.all(np.diff(time) > 0.0):
        return np.zeros(len(time))
    acceleration = np.gradient(speed, time)
    for ends, step in ((first, 1), (last, -1)):  # the next leg tells nothing of this one
        inside = np.where(last > first, ends + step, ends)
        width = np.where(last > first, time[inside] - time[ends], 1.0)
        acceleration[ends] = (speed[inside] - speed[ends]) / width
    return acceleration


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
