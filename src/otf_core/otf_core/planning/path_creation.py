# SPDX-License-Identifier: Apache-2.0
"""Laps of lines and diagonals that make the errors of linear axes identifiable.

A lap holds, in several planes of every orientation, both face diagonals, lines of half slope
(not box diagonals: backlash in the ratio of the axis lengths is invisible on those), edges and
middle lines, and then space diagonals. Every second lap runs backwards at another feed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight
from otf_core.model.machine import Machine
from otf_core.model.plan import Part, Plan

_PLANE = ((0, 0), (1, 1), (1, 0), (0, 1), (0.5, 0), (0.5, 1), (1, 0.5), (0, 0.5), (0, 0))
_SPACE = ((0, 0, 0), (1, 1, 1), (1, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 0), (0, 1, 1), (1, 0, 0),
          (0, 0.5, 1), (1, 1, 0.5), (0.5, 0, 0), (0.5, 1, 1), (1, 0.5, 0), (0, 0, 0.5),
          (1, 0.5, 1), (0, 1, 0.5), (0.5, 0, 1), (0, 0, 0))  # fmt: skip
LINES = 'lines'
"""Words of parts that move linear axes alone."""


def lap_of_box(levels: int, axes: int = 3) -> Array:
    """Corner points of one lap in the unit cube, square or line, shape (n, axes)."""
    if axes < 3:
        return np.array(_PLANE if axes == 2 else ((0,), (1,), (0,)), dtype=float)
    points: list[Array] = []
    for normal in (2, 1, 0):
        in_plane = [a for a in range(3) if a != normal]
        for level in np.linspace(0, 1, levels):
            corners = np.full((len(_PLANE), 3), level)
            corners[:, in_plane] = _PLANE
            points.extend(corners)
        points.append(np.zeros(3))
    points.extend(np.array(_SPACE))
    lap = np.array(points)
    moved = np.concatenate([[True], np.any(np.diff(lap, axis=0) != 0, axis=1)])
    return np.asarray(lap[moved])


def linear_names(machine: Machine) -> list[str]:
    """Linear axes of a machine."""
    return [a for a in machine.axis_names if not machine.axes[a].rotary]


def rest(machine: Machine) -> Array:
    """Positions (k,) at which axes that a part does not need stand: 0, else mid-range."""
    own = [machine.axes[a] for a in machine.axis_names]
    return np.array([0.0 if a.min <= 0.0 <= a.max else 0.5 * (a.min + a.max) for a in own])


def inner_range(machine: Machine, axes: Sequence[str], margin: float) -> tuple[Array, Array]:
    """Ends of the ranges of linear axes less a margin, m; ConfigError if it leaves nothing."""
    columns = [machine.column(a) for a in axes]
    low, high = machine.lower[columns] + margin, machine.upper[columns] - margin
    if np.any(high - low <= 0.1 * (machine.upper - machine.lower)[columns]):
        raise ConfigError(f'margin: {margin} m leaves too little of the axis ranges')
    return low, high


def box_lap(machine: Machine, axes: Sequence[str], levels: int, margin: float = 0.0) -> Array:
    """One lap of some linear axes over their ranges, corners (n, k); the others at rest.

    Raises
    ------
    ConfigError
        If the margin leaves nothing of an axis.
    """
    low, high = inner_range(machine, axes, margin)
    share = lap_of_box(levels, len(axes))
    q = np.tile(rest(machine), (len(share), 1))
    q[:, [machine.column(a) for a in axes]] = low + share * (high - low)
    return q


def plan_path(machine: Machine, config: PlannerConfig) -> Plan:
    """Plan laps of the linear axes, one part for every target that they move before the tracker.

    Raises
    ------
    ConfigError
        If the margin leaves nothing of an axis, or no target moves.
    """
    parts = []
    for name in machine.targets:
        seen = {j.name for j in Sight.of_target(machine, name).joints}
        axes = [a for a in linear_names(machine) if a in seen]
        if axes:
            lap = box_lap(machine, axes, config.levels, config.margin)
            parts.append(_laps(AxisPath(machine.axis_names, lap, name), config))
    if not parts:
        raise ConfigError(f'targets: no axis moves one before a tracker on {machine.tracker.link}')
    return Plan(tuple(parts))


def _laps(lap: AxisPath, config: PlannerConfig) -> Part:
    """Laps forward and backward, which begin and end at the same corner."""
    q, count = lap.positions, config.passes
    laps = [q, *(q[:: -1 if k % 2 else 1][1:] for k in range(1, count))]
    speeds = [config.feed * (config.feed_ratio if k % 2 else 1.0) for k in range(count)]
    corners = np.concatenate(laps)
    dwell = np.full(len(corners), config.corner_dwell)
    dwell[[0, -1]] = config.end_dwell
    path = AxisPath(lap.axes, corners, lap.target)
    return Part(path, np.repeat(speeds, len(q) - 1), dwell, LINES)
