# SPDX-License-Identifier: Apache-2.0
"""Lines to prove a compensation on: drawn in the volume, none of them one that was fitted."""

from __future__ import annotations

import numpy as np

from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan

POINTS = 13
SHORTEST = 0.3
"""Share of the space diagonal; shorter lines are drawn again."""
INNER = 0.03
"""Share of every axis kept free at either end."""
DWELL = 0.3
"""s; at every corner point."""
MOST_TRIES = 10_000


def check_plan(machine: Machine, feed: float, rng: np.random.Generator) -> Plan:
    """Draw lines through the whole volume.

    Parameters
    ----------
    machine : Machine
    feed : float
        m/s
    rng : numpy.random.Generator
    """
    size = machine.upper - machine.lower
    low, high = machine.lower + INNER * size, machine.upper - INNER * size
    points = [rng.uniform(low, high)]
    for _ in range(MOST_TRIES):
        point = rng.uniform(low, high)
        if np.linalg.norm(point - points[-1]) > SHORTEST * np.linalg.norm(size):
            points.append(point)
        if len(points) == POINTS:
            break
    return Plan(
        NominalPath(np.array(points)), np.full(len(points) - 1, feed), np.full(len(points), DWELL)
    )
