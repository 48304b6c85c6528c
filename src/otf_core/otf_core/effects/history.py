# SPDX-License-Identifier: Apache-2.0
"""What happened before on the path: travel since a reversal, time since a stop, laps.

Between corners the target moves along straight lines, so the travel of an axis since it last
reversed is known from the path alone; the moment at which a leg began is that of its first point
less the way from the corner at the speed there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.frames import XYZ
from otf_core.model.path import MOVING
from otf_core.tracking.curves import Lines

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
