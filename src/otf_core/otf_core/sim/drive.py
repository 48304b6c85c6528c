# SPDX-License-Identifier: Apache-2.0
"""The drive: programmed axis positions over time, see ``plan.Timing``, and how they change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.axis_path import position_at, travel_per_unit
from otf_core.model.machine import Machine
from otf_core.model.plan import Part, Plan, Timing

STRAIGHT = 1e-6
"""Change of the unit direction below which a stop lies on a straight line."""


@dataclass(frozen=True)
class Motion:
    """How a drive moves at n moments.

    Attributes
    ----------
    leg : ndarray of int64, shape (n,)
        While standing the one just driven, at the start the first.
    q, rates : ndarray, shape (n, k)
        Positions, m and rad, and speeds, m/s and rad/s.
    line : ndarray of int64, shape (n,)
        Number of the line between two corners that are stopped at and are no straight line.
    from_corner, to_corner : ndarray, shape (n,), m
        Travel of all axes since its start and to its end.
    """

    leg: Index
    q: Array
    rates: Array
    line: Index
    from_corner: Array
    to_corner: Array


class Drive:
    """Programmed motion along one part.

    Parameters
    ----------
    part : Part
        Axes in the order of the machine, no corner repeated.
    acceleration : float, m/s^2

    Attributes
    ----------
    unit : ndarray, shape (n - 1, k)
        Directions of the legs, a rotation counted as travel on a radius.
    corners : ndarray of int64
        Those at which lines begin and end, see `Motion`.
    duration : float, s
    """

    def __init__(self, machine: Machine, part: Part, acceleration: float) -> None:
        self.part, self._timing = part, Timing.of(machine, part, acceleration)
        self.duration = self._timing.duration
        legs = np.diff(part.path.positions, axis=0) * travel_per_unit(machine)
        self._travel = np.append(0.0, np.cumsum(np.linalg.norm(legs, axis=1)))
        self.unit = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        turned = np.linalg.norm(np.diff(self.unit, axis=0), axis=1) > STRAIGHT
        turned = np.concatenate([[True], turned, [True]])
        self.corners = np.flatnonzero(turned & part.halts(machine))

    def at(self, time: Array) -> Array:
        """Programmed positions (n, k) at times (n,), s, since the start of the first dwell."""
        return self.motion(time).q

    def motion(self, time: Array) -> Motion:
        """State of the motion at times (n,), s, since the start of the first dwell."""
        timing, positions, corners = self._timing, self.part.path.positions, self.corners
        way, stretch = timing.way_at(time), timing.stretch_at(time)
        leg = np.searchsorted(timing.reach, way) - 1
        own = [np.searchsorted(timing.stretch, stretch, side) for side in ('left', 'right')]
        leg = np.clip(leg, own[0], own[1] - 1)
        length = np.diff(timing.reach)
        place = np.clip((way - timing.reach[leg]) / length[leg], 0.0, 1.0) + leg
        elapsed = np.clip(time - timing.start[stretch], 0.0, timing.moving[stretch])
        ramp = timing.acceleration * np.minimum(elapsed, timing.moving[stretch] - elapsed)
        speed = np.minimum(timing.peak[stretch], ramp)
        travel = np.interp(place, np.arange(len(self._travel)), self._travel)
        line = np.searchsorted(corners, leg, side='right') - 1
        return Motion(
            leg,
            position_at(positions, place),
            (speed / length[leg])[:, None] * np.diff(positions, axis=0)[leg],
            line,
            travel - self._travel[corners[line]],
            self._travel[corners[line + 1]] - travel,
        )


def drives_of(machine: Machine, plan: Plan, acceleration: float) -> tuple[Drive, ...]:
    """The drive of every part of a plan.

    Raises
    ------
    InputError
        If the plan is not of this machine, or leaves the range of an axis.
    """
    return tuple(Drive(machine, part, acceleration) for part in plan.of(machine).parts)
