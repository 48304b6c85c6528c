# SPDX-License-Identifier: Apache-2.0
"""Paths of machines with rotary axes: axis positions at the corners, driven linearly between.

A part is what is driven with one reflector in view; between parts it is moved by hand. The track
of the reflector on a leg is a curve p(q), q linear from corner to corner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import InputError, ShapeError
from otf_core.model.chain import Sight
from otf_core.model.machine import FULL_TURN, TOOL, Machine
from otf_core.model.motions import AXES, ROTARY
from otf_core.model.path import NominalPath

MIN_MOTION = 1e-9
"""m or rad; corners that differ by less are one."""
LIKE_MM = 50.0
"""Positions of a linear axis that leave its range by more than this many ranges are in mm, most
likely."""
MOST_TURNS = 30.0
"""Turns of an endless axis beyond which its positions are in degrees, most likely."""
LEVER = 0.2
"""m; a rotation counts as travel on this radius."""
SMOOTH = 0.2
"""Change of the unit direction in the axes below which a corner is driven through."""
TURN_RATE = np.radians(15.0)
"""rad/s; rotary axes turn no faster, so that samples at 500 Hz lie 0.03 degrees apart."""
BREAK = 1.9
"""s; the beam is broken this long where a reflector is moved by hand; users are told 2 s."""
TRACK_STEP, TRACK_TURN = 5e-3, 0.03
"""m of travel and rad of rotation between points of a track that stands for the curve."""


@dataclass(frozen=True)
class AxisPath:
    """One part of a run.

    Attributes
    ----------
    axes : tuple of str
        Letters of the axes, in the order of the columns.
    positions : array_like, shape (n, k), m and rad
        Axis positions at the corners, in driving order.
    target : str
        Name of the target in machine.yaml.

    Raises
    ------
    ShapeError
        If the columns do not go with the axes.
    InputError
        If there are fewer than two different corners or a position is not finite.
    """

    axes: tuple[str, ...]
    positions: Array
    target: str = TOOL

    def __post_init__(self) -> None:
        """Check shape and content."""
        q = np.asarray(self.positions, dtype=float)
        object.__setattr__(self, 'positions', q)
        if q.ndim != 2 or q.shape[1] != len(self.axes):
            raise ShapeError(f'positions of {", ".join(self.axes)}: got shape {q.shape}')
        if not np.all(np.isfinite(q)):
            first = int(np.flatnonzero(~np.isfinite(q).all(axis=1))[0])
            raise InputError(f'axis positions: corner {first} is not finite')
        if len(q) < 2 or np.abs(np.diff(q, axis=0)).max() <= MIN_MOTION:
            raise InputError(f'axis positions: {len(q)} corners without any motion between them')

    @classmethod
    def of_points(cls, machine: Machine, points: Array) -> AxisPath:
        """Path of the tool of a machine without rotary axes, from points (n, 3), m.

        Raises
        ------
        InputError
            If the points move along an axis that the machine does not have.
        """
        points = NominalPath(points).points
        for k, axis in enumerate(AXES):
            if axis not in machine.axes and np.ptp(points[:, k]) > MIN_MOTION:
                raise InputError(f'path: moves along {axis}; {machine.name} has no such axis')
        return cls(machine.axis_names, points[:, [AXES.index(a) for a in machine.axis_names]])

    @property
    def is_plain(self) -> bool:
        """Whether it is one of the tool on linear axes, which its points describe."""
        return self.target == TOOL and not set(self.axes) & set(ROTARY)

    @property
    def points(self) -> Array:
        """X, Y and Z at the corners, shape (n, 3), m; 0 for an axis that does not exist."""
        own = [self.positions[:, self.axes.index(a)] if a in self.axes
               else np.zeros(len(self.positions)) for a in AXES]  # fmt: skip
        return np.stack(own, axis=1)

    def of(self, machine: Machine) -> AxisPath:
        """The same in the order of the axes of a machine, without repeated corners.

        Raises
        ------
        InputError
            If axes or target are not those of the machine, or an axis leaves its range.
        """
        if sorted(self.axes) != sorted(machine.axis_names):
            raise InputError(
                f'axis positions are of {", ".join(self.axes)}, the machine {machine.name} has '
                f'{", ".join(machine.axis_names)}; do these positions and machine.yaml belong '
                f'together?'
            )
        if self.target not in machine.targets:
            raise InputError(
                f"target '{self.target}' is not among the targets of machine.yaml "
                f'({", ".join(machine.targets)}); state its link and place there under targets, '
                f'or correct its name in the recording'
            )
        q = self.positions[:, [self.axes.index(a) for a in machine.axis_names]]
        _check_ranges(machine, q)
        moved = np.abs(np.diff(q, axis=0)).max(axis=1) > MIN_MOTION
        return AxisPath(machine.axis_names, q[np.append(True, moved)], self.target)


def travel_per_unit(machine: Machine) -> Array:
    """Travel (k,) that a unit of every axis counts as, m: a rotation on the radius ``LEVER``."""
    return np.array([LEVER if machine.axes[a].rotary else 1.0 for a in machine.axis_names])


def travel_of_legs(machine: Machine, positions: Array) -> Array:
    """Travel of all axes from corner to corner, shape (n - 1,), m; see ``travel_per_unit``."""
    legs = np.diff(positions, axis=0) * travel_per_unit(machine)
    return np.asarray(np.linalg.norm(legs, axis=1))


def driven_length(machine: Machine, positions: Array) -> float:
    """Travel of all axes over all legs, m."""
    return float(travel_of_legs(machine, positions).sum())


def seconds_of_legs(machine: Machine, q: Array, feed: float | Array) -> Array:
    """Times (n - 1,) of the legs between corners, s: none is faster than feed and ``TURN_RATE``.

    Parameters
    ----------
    feed : float or ndarray, shape (n - 1,)
        m/s, of the linear axes.
    """
    legs = np.abs(np.diff(q, axis=0))
    turning = np.array([machine.axes[a].rotary for a in machine.axis_names])
    travel = np.linalg.norm(legs[:, ~turning], axis=1)
    angle = legs[:, turning].max(axis=1, initial=0.0)
    return np.asarray(np.maximum(travel / feed, angle / TURN_RATE))


def driven_through(machine: Machine, positions: Array) -> NDArray[np.bool_]:
    """Which of the corners (n - 2,) between the ends are smooth."""
    legs = np.diff(positions, axis=0) * travel_per_unit(machine)
    unit = legs / np.linalg.norm(legs, axis=1)[:, None]
    return np.asarray(np.linalg.norm(np.diff(unit, axis=0), axis=1) <= SMOOTH)


def _check_ranges(machine: Machine, q: Array) -> None:
    for k, name in enumerate(machine.axis_names):
        axis = machine.axes[name]
        if axis.endless:
            if np.abs(q[:, k]).max() > MOST_TURNS * FULL_TURN:
                raise InputError(
                    f'axis positions: axis {name} turns up to {np.abs(q[:, k]).max():.6g} rad, '
                    f'{np.abs(q[:, k]).max() / FULL_TURN:.0f} turns; is it in degrees?'
                )
            continue
        out = np.maximum(axis.min - q[:, k], q[:, k] - axis.max)
        if out.max() > 1e-3:
            asked = ''
            if axis.rotary and out.max() > 3.0:
                asked = '; is it in degrees?'
            elif not axis.rotary and out.max() > LIKE_MM * (axis.max - axis.min):
                asked = '; is it in mm?'
            raise InputError(
                f'axis positions: corner {int(out.argmax())} leaves the range of axis {name} by '
                f'{out.max():.4g} {axis.unit}{asked}'
            )


def along_legs(axes: Sequence[str], positions: Array, step: float | Array, turn: float) -> Array:
    """Places on a path, in legs from its first corner, close to each other and all corners.

    Parameters
    ----------
    axes : sequence of str
        Letters of the columns.
    positions : ndarray, shape (n, k), m and rad
    step, turn : float
        Most that linear axes travel (m) and rotary ones turn (rad) between two places; ``step``
        may be of every leg.

    Returns
    -------
    ndarray, shape (m,)
        Number of the leg plus the share of it that is done.
    """
    legs, linear = np.abs(np.diff(positions, axis=0)), np.isin(axes, AXES)
    travel = np.linalg.norm(legs[:, linear], axis=1) / step
    angle = legs[:, ~linear].max(axis=1, initial=0.0) / turn
    parts = np.maximum(np.ceil(np.maximum(travel, angle)), 1.0).astype(np.int64)
    first = np.cumsum(parts) - parts
    inner = (np.arange(parts.sum()) - np.repeat(first, parts)) / np.repeat(parts, parts)
    return np.append(np.repeat(np.arange(len(parts)), parts) + inner, float(len(parts)))


def position_at(positions: Array, place: Array) -> Array:
    """Axis positions (m, k) at places (m,) on a path, see ``along_legs``."""
    leg = np.clip(place.astype(np.int64), 0, len(positions) - 2)
    share = (place - leg)[:, None]
    return np.asarray((1.0 - share) * positions[leg] + share * positions[leg + 1])


@dataclass(frozen=True)
class PartsTrack(NominalPath):
    """Track of the reflectors of all parts of a run, as a polyline; between parts a hand move.

    Attributes
    ----------
    parts : tuple of AxisPath
        Axes in the order of the machine.
    ends : tuple of int
        Points of the track up to the end of every part.
    """

    machine: Machine
    parts: tuple[AxisPath, ...]
    ends: tuple[int, ...]

    @cached_property
    def part_lengths(self) -> list[float]:
        """Length of the track of every part, m."""
        along = np.append(0.0, np.cumsum(self.leg_lengths))
        starts = [0, *self.ends[:-1]]
        return [float(along[b - 1] - along[a]) for a, b in zip(starts, self.ends, strict=True)]

    def first_parts(self, count: int) -> PartsTrack:
        """Track of the first parts alone."""
        points = self.points[: self.ends[count - 1]]
        return PartsTrack(points, self.machine, self.parts[:count], self.ends[:count])


def nominal_track(
    machine: Machine,
    parts: Sequence[AxisPath],
    places: Mapping[str, Array] | None = None,
    turn: float = TRACK_TURN,
) -> PartsTrack:
    """Track of the reflectors of all parts in the frame of the tracker's link.

    Parameters
    ----------
    parts : sequence of AxisPath
    places : mapping of target to ndarray, shape (3,), m, optional
        Where reflectors were found to be; else as machine.yaml says.
    turn : float
        rad; most that a rotary axis turns between two points.

    Raises
    ------
    InputError
        If a part is not of this machine, or no reflector moves.
    """
    tracks, driven = [], tuple(part.of(machine) for part in parts)
    for own in driven:
        q = position_at(own.positions, along_legs(own.axes, own.positions, TRACK_STEP, turn))
        sight = Sight.of_target(machine, own.target)
        if places and own.target in places:
            sight = replace(sight, place=places[own.target])
        tracks.append(sight.nominal(q))
    points = np.concatenate(tracks)
    if np.ptp(points, axis=0).max() < 1e-6:
        raise InputError(
            f'the reflector does not move relative to the tracker (link {machine.tracker.link}); '
            f'check targets and tracker: link in machine.yaml'
        )
    ends = np.cumsum([len(track) for track in tracks])
    return PartsTrack(points, machine, driven, tuple(int(end) for end in ends))
