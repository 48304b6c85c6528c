# SPDX-License-Identifier: Apache-2.0
"""What the machine is to drive: parts with corners, feeds and standstills, and when it is where.

A part is driven with one target in view; between two parts the reflector is moved by hand. Its
axes move linearly from corner to corner. Corners with a dwell are stopped at; of the others
smooth ones are driven through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from otf_core.arrays import Array, Index
from otf_core.config import PlannerConfig
from otf_core.errors import InputError, ShapeError
from otf_core.model.axis_path import MIN_MOTION, AxisPath, driven_through, seconds_of_legs
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.path import NominalPath

STOPS = 'stops'
"""How the words of a part begin that is there for its standstills."""


@dataclass(frozen=True)
class Part:
    """What is driven with one target in view.

    Attributes
    ----------
    path : AxisPath
        Target, and axis positions at n corners.
    feed : array_like, shape (n - 1,), m/s
        Programmed speed of the linear axes on every leg; see ``axis_path.seconds_of_legs``.
    dwell : array_like, shape (n,), s
        Standstill at every corner; where it is 0, smooth corners are driven through.
    words : str
        What it is; of ``STOPS`` the standstills are what counts.

    Raises
    ------
    ShapeError
        If feed or dwell do not go with the corners.
    InputError
        If a feed is not finite and above 0, or a dwell not finite or negative; names leg or point.
    """

    path: AxisPath
    feed: NDArray[np.float64]
    dwell: NDArray[np.float64]
    words: str = ''

    def __post_init__(self) -> None:
        """Check shapes and values."""
        points = len(self.path.positions)
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
    def stops(self) -> bool:
        """Whether it is judged by its standstills alone."""
        return self.words.startswith(STOPS)

    @property
    def target(self) -> str:
        """Name of the target in view."""
        return self.path.target

    def of(self, machine: Machine) -> Part:
        """The same in the order of the axes of a machine, dwells at repeated corners added up.

        Raises
        ------
        InputError
            If axes or target are not those of the machine, or an axis leaves its range.
        """
        moved = np.abs(np.diff(self.path.positions, axis=0)).max(axis=1) > MIN_MOTION
        first = np.flatnonzero(np.append(True, moved))
        dwell = np.add.reduceat(self.dwell, first)
        return replace(self, path=self.path.of(machine), feed=self.feed[moved], dwell=dwell)

    def halts(self, machine: Machine) -> NDArray[np.bool_]:
        """Corners (n,) that are not driven through."""
        smooth = driven_through(machine, self.path.positions) & (self.dwell[1:-1] == 0.0)
        return np.concatenate([[True], ~smooth, [True]])


@dataclass(frozen=True)
class Plan:
    """What the machine is to drive.

    Examples
    --------
    >>> points = [[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0]]
    >>> slow = otf_core.Plan.along(points, feed=[0.1, 0.05], dwell=[2.0, 0.5, 2.0])
    >>> slow.parts[0].feed.tolist()
    [0.1, 0.05]
    """

    parts: tuple[Part, ...]

    @classmethod
    def along(cls, points: ArrayLike, feed: ArrayLike, dwell: ArrayLike) -> Plan:
        """Plan along corner points of the target ``tool`` on a machine with three linear axes.

        Parameters
        ----------
        points : array_like, shape (n, 3), m
        feed : array_like, shape (n - 1,), m/s
        dwell : array_like, shape (n,), s

        Raises
        ------
        ShapeError, InputError
            See `Part`.
        """
        path = AxisPath(AXES, NominalPath(np.asarray(points, dtype=float)).points)
        return cls((Part(path, np.asarray(feed), np.asarray(dwell)),))

    @property
    def is_plain(self) -> bool:
        """Whether it is one part of the tool on linear axes alone, which its points describe."""
        return len(self.parts) == 1 and self.parts[0].path.is_plain

    @property
    def path(self) -> NominalPath:
        """Points of a plain plan."""
        return NominalPath(self.parts[0].path.points)

    @property
    def feed(self) -> Array:
        """Feeds of its legs, (n - 1,), m/s."""
        return self.parts[0].feed

    @property
    def dwell(self) -> Array:
        """Dwells at its points, (n,), s."""
        return self.parts[0].dwell

    def of(self, machine: Machine) -> Plan:
        """The same for a machine, see `Part.of`."""
        return Plan(tuple(part.of(machine) for part in self.parts))

    def duration(self, machine: Machine, acceleration: float) -> float:
        """Time of all parts with their dwells, without moves by hand, s.

        Parameters
        ----------
        acceleration : float
            m/s^2, of the linear axes.
        """
        return sum(Timing.of(machine, part, acceleration).duration for part in self.parts)


def _check(where: str, values: Array, good: NDArray[np.bool_], rule: str) -> None:
    finite = np.isfinite(values)
    wrong = np.flatnonzero(~(finite & good))
    if wrong.size:
        first = int(wrong[0])
        reason = rule if finite[first] else 'must be finite'
        raise InputError(f'{where} {first}: {reason}, got {values[first]:g}')


def part_along(
    machine: Machine, path: AxisPath, config: PlannerConfig, words: str = '', dwell: float = 0.0
) -> Part:
    """Drive a path at one feed with the dwells of the configuration.

    Smooth corners between legs that turn rotary axes are driven through: no control stops at
    chords of a circle.

    Parameters
    ----------
    dwell : float
        s; above 0 it is that of all corners but the ends.

    Raises
    ------
    InputError
        If the path is not of this machine.
    """
    path = path.of(machine)
    rotary = [machine.axes[a].rotary for a in machine.axis_names]
    turns = np.any(np.diff(path.positions, axis=0)[:, rotary] != 0.0, axis=1)
    smooth = driven_through(machine, path.positions) & turns[1:] & turns[:-1]
    inner = np.where(smooth, 0.0, config.corner_dwell) if dwell == 0.0 else dwell
    halts = np.full(len(path.positions), config.end_dwell)
    halts[1:-1] = inner
    return Part(path, np.full(len(halts) - 1, config.feed), halts, words)


def plan_along(machine: Machine, paths: Sequence[AxisPath], config: PlannerConfig) -> Plan:
    """Drive given paths; see ``part_along``."""
    return Plan(tuple(part_along(machine, path, config) for path in paths))


def check_inside(plan: Plan, machine: Machine) -> None:
    """Refuse a plan that leaves the axis ranges; InputError names point and axis."""
    for part in plan.parts:
        for k, axis in enumerate(machine.axis_names):
            q, spec = part.path.positions[:, k], machine.axes[axis]
            beyond = np.maximum(spec.min - q, q - spec.max)
            if beyond.max() > 1e-9 and not spec.endless:
                excess, unit = (beyond.max(), 'rad') if spec.rotary else (1e3 * beyond.max(), 'mm')
                raise InputError(
                    f'path: point {int(beyond.argmax())} leaves the range of axis {axis} by '
                    f'{excess:.3f} {unit}'
                )


@dataclass(frozen=True)
class Timing:
    """When a part is where: trapezoidal speed on every stretch between two halts.

    t(w) after way w on a stretch of size L with peak speed v and acceleration a: sqrt(2 w / a)
    while speeding up, w / v + v / (2 a) at constant speed, mirrored while slowing down;
    v = min(feed, sqrt(a L)).

    Attributes
    ----------
    reach : ndarray, shape (n,), m
        Way to every corner: its time at full speed times the feed.
    stretch : ndarray of int64, shape (n - 1,)
        Stretch of every leg.
    low, size : ndarray, shape (s,), m
        Way to the start of every stretch, and its own.
    peak, moving, start : ndarray, shape (s,), m/s, s, s
        Highest speed, driving time, and departure, counted from the start of the first dwell.
    acceleration : float
        m/s^2, of the linear axes.
    duration : float
        s, all dwells included.
    """

    reach: Array
    stretch: Index
    low: Array
    size: Array
    peak: Array
    moving: Array
    start: Array
    acceleration: float
    duration: float

    @classmethod
    def of(cls, machine: Machine, part: Part, acceleration: float) -> Timing:
        """Time a part whose axes are in the order of the machine."""
        way = part.feed * seconds_of_legs(machine, part.path.positions, part.feed)
        reach, halts = np.append(0.0, np.cumsum(way)), part.halts(machine)
        corners = np.flatnonzero(halts)
        low, size = reach[corners[:-1]], np.diff(reach[corners])
        feed = np.maximum.reduceat(part.feed, corners[:-1])
        peak = np.minimum(feed, np.sqrt(size * acceleration))
        moving = size / peak + peak / acceleration
        start = np.cumsum(part.dwell[corners[:-1]] + np.append(0.0, moving[:-1]))
        duration = float(start[-1] + moving[-1] + part.dwell[-1])
        stretch = np.cumsum(halts[:-1]) - 1
        return cls(reach, stretch, low, size, peak, moving, start, acceleration, duration)

    def at(self, way: Array, stretch: Any) -> Array:
        """Times (m,), s, at ways (m,), m, on stretches (m,), or on one."""
        along = way - self.low[stretch]
        peak, moving, a = self.peak[stretch], self.moving[stretch], self.acceleration
        ramp, remainder = 0.5 * peak**2 / a, self.size[stretch] - along
        elapsed = np.select(
            [along < ramp, remainder < ramp],
            [
                np.sqrt(2 * np.maximum(along, 0.0) / a),
                moving - np.sqrt(2 * np.maximum(remainder, 0.0) / a),
            ],
            along / peak + 0.5 * peak / a,
        )
        return np.asarray(self.start[stretch] + elapsed)

    def stretch_at(self, time: Array) -> Index:
        """Stretch at times (m,), s; while standing the one just driven, at the start the first."""
        return np.clip(np.searchsorted(self.start, time, side='right') - 1, 0, None)

    def way_at(self, time: Array) -> Array:
        """Ways (m,), m, at times (m,), s."""
        k = self.stretch_at(time)
        elapsed = np.clip(time - self.start[k], 0.0, self.moving[k])
        peak, remaining, a = self.peak[k], self.moving[k] - elapsed, self.acceleration
        ramp = peak / a
        along = np.select(
            [elapsed < ramp, remaining < ramp],
            [0.5 * a * elapsed**2, self.size[k] - 0.5 * a * remaining**2],
            peak * (elapsed - 0.5 * ramp),
        )
        return np.asarray(self.low[k] + along)
