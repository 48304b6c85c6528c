# SPDX-License-Identifier: Apache-2.0
"""What the machine is to drive: corner points, feeds, standstills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.config import PlannerConfig
from otf_core.errors import InputError
from otf_core.model.machine import AXES, Machine
from otf_core.model.path import NominalPath

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """What the machine is to drive.

    Attributes
    ----------
    path : NominalPath
        n corner points.
    feed : ndarray, shape (n - 1,), m/s
        Programmed speed of every leg.
    dwell : ndarray, shape (n,), s
        Standstill at every corner point.
    """

    path: NominalPath
    feed: NDArray[np.float64]
    dwell: NDArray[np.float64]

    @property
    def duration(self) -> float:
        """Driving time without acceleration, s."""
        return float(np.sum(self.path.leg_lengths / self.feed) + self.dwell.sum())


def plan_for_path(path: NominalPath, config: PlannerConfig) -> Plan:
    """Drive a given path at one feed: ``config.feed``, ``corner_dwell`` and ``end_dwell``."""
    n = len(path.points)
    dwell = np.full(n, config.corner_dwell)
    dwell[[0, -1]] = config.end_dwell
    return Plan(path, np.full(n - 1, config.feed), dwell)


def check_inside(path: NominalPath, machine: Machine) -> None:
    """Refuse a path that leaves the axis ranges; InputError names point and axis."""
    for k, axis in enumerate(AXES):
        beyond = np.maximum(
            machine.lower[k] - path.points[:, k], path.points[:, k] - machine.upper[k]
        )
        if beyond.max() > 1e-9:
            raise InputError(
                f'path: point {int(beyond.argmax())} leaves the range of axis {axis} by '
                f'{1e3 * beyond.max():.3f} mm'
            )
