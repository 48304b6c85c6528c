# SPDX-License-Identifier: Apache-2.0
"""Points of a standstill run: along the edges of the working volume and spread inside it.

Paper 2.2: 226 calibration points, 150 of them inside and the others at the edges. Inside, the
additive recurrence with the plastic constant takes the place of random numbers.
"""

from itertools import product

import numpy as np

from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan

PLASTIC = 1.2207440846057596
"""Root of x^4 = x + 1: its inverse powers spread points evenly in three dimensions."""


def spread_points(machine, count, offset=0.5):
    """Points spread evenly over the working volume, shape (count, 3), m.

    Another ``offset`` (0 to 1) gives other places.
    """
    steps = PLASTIC ** -np.arange(1.0, 4.0)
    unit = (offset + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.asarray(machine.lower + unit * (machine.upper - machine.lower))


def edge_points(machine, count):
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


def standstill_plan(points, feed, dwell):
    """Drive from point to point at one feed (m/s) and stop at each for ``dwell`` seconds."""
    path = NominalPath(points)
    return Plan.along(path.points, np.full(len(points) - 1, feed), np.full(len(points), dwell))
