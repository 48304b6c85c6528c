# SPDX-License-Identifier: Apache-2.0
"""Nominal paths without optimisation: lines and diagonals; points of a standstill run."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
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


# Points of a standstill run: along the edges of the working volume and spread inside it.
#
# Paper 2.2: 226 calibration points, 150 of them at random places and the others at the edges; 200
# reference points in other places. Inside, the additive recurrence with the plastic constant takes
# the place of random numbers: points spread evenly, the same every time.

PLASTIC = 1.2207440846057596
"""Root of x^4 = x + 1: its inverse powers spread points evenly in three dimensions."""


def spread_points(machine: Machine, count: int, offset: float = 0.5) -> Array:
    """Points spread evenly over the working volume, shape (count, 3), m.

    Another ``offset`` (0 to 1) gives other places.
    """
    steps = PLASTIC ** -np.arange(1.0, 4.0)
    unit = (offset + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.asarray(machine.lower + unit * (machine.upper - machine.lower))


def edge_points(machine: Machine, count: int) -> Array:
    """Points at equal distances along the twelve edges of the volume, corners included.

    Returns
    -------
    ndarray, shape (count, 3), m
    """
    size = machine.upper - machine.lower
    edges = []
    for axis in range(3):
        for ends in product((0.0, 1.0), repeat=2):
            start = np.insert(np.array(ends), axis, 0.0)
            edges.append((start * size, np.eye(3)[axis] * size))
    corners = np.array(list(product((0.0, 1.0), repeat=3))) * size
    inner = max(count - len(corners), 0)
    length = np.array([np.linalg.norm(step) for _, step in edges])
    reach = (np.arange(inner) + 0.5) / max(inner, 1) * length.sum()
    edge = np.minimum(np.searchsorted(np.cumsum(length), reach), len(edges) - 1)
    share = (reach - np.concatenate([[0.0], np.cumsum(length)])[edge]) / length[edge]
    along = [edges[e][0] + s * edges[e][1] for e, s in zip(edge, share, strict=True)]
    return np.asarray(machine.lower + np.array([*corners, *along][:count]))


def standstill_plan(points: Array, feed: float, dwell: float) -> Plan:
    """Drive from point to point at one feed (m/s) and stop at each for ``dwell`` seconds."""
    path = NominalPath(points)
    return Plan(path, np.full(len(points) - 1, feed), np.full(len(points), dwell))
