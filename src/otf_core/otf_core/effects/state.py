# SPDX-License-Identifier: Apache-2.0
"""The state of measured points: of path pieces for the fit, of samples for the simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.effects.base import State
from otf_core.effects.history import path_history
from otf_core.model.courses import Courses
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.nodes import axis_nodes
from otf_core.model.path import sides_of_travel
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
    """One point in the middle of the volume: for names and units of terms."""
    corners = np.stack([machine.lower, machine.upper])
    middle = corners.mean(axis=0)
    place = middle - np.array([1.0, 0.0, 0.0])
    pose = RigidTransform(np.eye(3), place)
    leg, ones = np.zeros(1, dtype=np.int64), np.ones(1)
    nodes = {a: axis_nodes(machine.axes[a]) for a in machine.axis_names}
    return state_on_path(machine, corners, leg, middle[None], ones, ones, pose, nodes)
