# SPDX-License-Identifier: Apache-2.0
"""What the machine is to drive: corner points, feeds, standstills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.errors import InputError, ShapeError
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath


@dataclass(frozen=True)
class Plan:
    """What the machine is to drive.

    Attributes
    ----------
    path : NominalPath
        n corner points.
    feed : array_like, shape (n - 1,), m/s
        Programmed speed of every leg.
    dwell : array_like, shape (n,), s
        Standstill at every corner point.

    Raises
    ------
    ShapeError
        If feed or dwell do not go with the points.
    InputError
        If a feed is not finite and above 0, or a dwell not finite or negative; names leg or point.

    Examples
    --------
    >>> path = otf_core.NominalPath([[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0]])
    >>> slow = otf_core.Plan(path, feed=[0.1, 0.05], dwell=[2.0, 0.5, 2.0])
    >>> round(slow.duration, 9)  # s, without acceleration
    11.5
    """

    path: NominalPath
    feed: NDArray[np.float64]
    dwell: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check shapes and values."""
        points = len(self.path.points)
        for name, count in (('feed', points - 1), ('dwell', points)):
            values = np.asarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, values)
            if values.shape != (count,):
                raise ShapeError(
                    f'{name}: a plan of {points} points needs shape ({count},), got {values.shape}'
                )
        _check('feed: leg', self.feed, self.feed > 0, 'must be above 0')
        _check('dwell: point', self.dwell, self.dwell >= 0, 'must not be negative')

    @property
    def duration(self) -> float:
        """Driving time without acceleration, s."""
        return float(np.sum(self.path.leg_lengths / self.feed) + self.dwell.sum())


@dataclass(frozen=True)
class AxisPlan:
    """What a machine with rotary axes is to drive.

    Attributes
    ----------
    parts : tuple of AxisPath
        Between two of them the reflector is moved by hand.
    feed : tuple of float, m/s
        Programmed speed of the linear axes in every part; see ``axis_path.seconds_of_legs``.
    dwell : tuple of float, s
        Standstill at every corner of a part that is not driven through.
    stops : tuple of bool
        Whether a part is stopped at smooth corners, too; else they are driven through.
    duration : float, s
        Driving time, without hand moves.

    Raises
    ------
    ShapeError
        If feeds or dwells do not go with the parts.
    InputError
        If a feed is not finite and above 0, or a dwell not finite or negative; names the part.
    """

    parts: tuple[AxisPath, ...]
    feed: tuple[float, ...]
    dwell: tuple[float, ...]
    stops: tuple[bool, ...]
    duration: float

    def __post_init__(self) -> None:
        """Check numbers and values."""
        for name in ('feed', 'dwell', 'stops'):
            count = len(getattr(self, name))
            if count != len(self.parts):
                raise ShapeError(f'{name}: {count} values for {len(self.parts)} parts')
        feed, dwell = np.array(self.feed), np.array(self.dwell)
        _check('feed: part', feed, feed > 0, 'must be above 0')
        _check('dwell: part', dwell, dwell >= 0, 'must not be negative')


def _check(where: str, values: Array, good: NDArray[np.bool_], rule: str) -> None:
    finite = np.isfinite(values)
    wrong = np.flatnonzero(~(finite & good))
    if wrong.size:
        first = int(wrong[0])
        reason = rule if finite[first] else 'must be finite'
        raise InputError(f'{where} {first}: {reason}, got {values[first]:g}')


def plan_for_path(path: NominalPath, config: PlannerConfig) -> Plan:
    """Drive a given path at one feed: ``config.feed``, ``corner_dwell`` and ``end_dwell``."""
    n = len(path.points)
    dwell = np.full(n, config.corner_dwell)
    dwell[[0, -1]] = config.end_dwell
    return Plan(path, np.full(n - 1, config.feed), dwell)


def check_inside(path: NominalPath, machine: Machine) -> None:
    """Refuse a path that leaves the axis ranges; InputError names point and axis."""
    for k, axis in enumerate(machine.axis_names):
        beyond = np.maximum(
            machine.lower[k] - path.points[:, k], path.points[:, k] - machine.upper[k]
        )
        if beyond.max() > 1e-9:
            raise InputError(
                f'path: point {int(beyond.argmax())} leaves the range of axis {axis} by '
                f'{1e3 * beyond.max():.3f} mm'
            )
