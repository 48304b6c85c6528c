# SPDX-License-Identifier: Apache-2.0
"""Nominal paths without optimisation: lines and diagonals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan

# Path creator: lines, face and space diagonals that make the error motions identifiable.
#
# A lap holds, in several planes of every orientation, both face diagonals, lines of half slope
# (not box diagonals: backlash in the ratio of the axis lengths is invisible on those), edges and
# middle lines, and then space diagonals. Every second lap runs backwards at another feed.

_PLANE = ((0, 0), (1, 1), (1, 0), (0, 1), (0.5, 0), (0.5, 1), (1, 0.5), (0, 0.5), (0, 0))
_SPACE = ((0, 0, 0), (1, 1, 1), (1, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 0), (0, 1, 1), (1, 0, 0),
          (0, 0.5, 1), (1, 1, 0.5), (0.5, 0, 0), (0.5, 1, 1), (1, 0.5, 0), (0, 0, 0.5),
          (1, 0.5, 1), (0, 1, 0.5), (0.5, 0, 1), (0, 0, 0))  # fmt: skip


def lap_of_box(levels: int) -> NDArray[np.float64]:
    """Corner points of one lap in the unit cube, shape (n, 3)."""
    points: list[NDArray[np.float64]] = []
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


def inner_range(
    machine: Machine, config: PlannerConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ends of the axis ranges less the margin, m; ConfigError if it leaves nothing."""
    low, high = machine.lower + config.margin, machine.upper - config.margin
    if np.any(high - low <= 0.1 * (machine.upper - machine.lower)):
        raise ConfigError(f'margin: {config.margin} m leaves too little of the axis ranges')
    return low, high


def plan_path(machine: Machine, config: PlannerConfig) -> Plan:
    """Create the path for one machine.

    Raises
    ------
    ConfigError
        If the margin leaves nothing of an axis.
    """
    low, high = inner_range(machine, config)
    lap = low + lap_of_box(config.levels) * (high - low)
    laps = [lap if k % 2 == 0 else lap[::-1][1:] for k in range(config.passes)]
    # lap starts and ends at the same corner, so forward laps after a reverse one join up too
    laps = [p if k == 0 or k % 2 else p[1:] for k, p in enumerate(laps)]
    path = NominalPath(np.concatenate(laps))
    speeds = [config.feed * (config.feed_ratio if k % 2 else 1.0) for k in range(config.passes)]
    feed = np.repeat(speeds, len(lap) - 1)
    dwell = np.full(len(path.points), config.corner_dwell)
    dwell[[0, -1]] = config.end_dwell
    return Plan(path, feed, dwell)
