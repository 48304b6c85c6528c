# SPDX-License-Identifier: Apache-2.0
"""Where the tracker stands, and in which positions it sees a reflector.

The table hides its reflectors from below, the spindle those that it holds from behind, within
``BEHIND`` of the line from the reflector to it. Of the beams that are left, a reflector returns
those within its half-angle; the operator turns it to several facings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight
from otf_core.model.frames import XYZ
from otf_core.model.machine import BED, SPINDLE, TABLE, Machine
from otf_core.planning.chains import linear_middle, longest_run, positions_of

SIGHT_STEPS, DIRECTIONS = 24, 600
"""Positions of every rotary axis, and directions of a reflector, among which sight is judged."""
LEAST_OPEN = 0.8
"""Share of the positions of the rotary axes in which nothing must hide a reflector."""
WORTH_MOVING = 0.1
"""More of the positions that another place must show for one to be refused."""
BEHIND = np.radians(30.0)
"""rad about the line from a reflector to the spindle in which the spindle hides it."""
PLACE_DISTANCE = 0.3
"""m; of the usual place of the tracker from a working volume without rotary axes."""
MOST_FACINGS = 8
ENOUGH = 0.9
"""Share of the positions that facings are counted up to."""
HAND_TURN = 20.0
"""s for turning a reflector in its nest to the next facing."""


@dataclass(frozen=True)
class SightShare:
    """In which share of the positions of the rotary axes a reflector is seen.

    Attributes
    ----------
    open : float
        Neither table nor spindle stands between reflector and tracker.
    facings : tuple of float
        Share seen with 1, 2, ... facings of the reflector, each turned by hand once.
    ranges : mapping of axis to (float, float)
        rad; of every rotary axis the range about its rest in which nothing hides it.
    """

    open: float
    facings: tuple[float, ...]
    ranges: dict[str, tuple[float, float]]


def _mesh(machine: Machine, name: str) -> tuple[list[str], list[Array], Array]:
    """Rotary axes between tracker and reflector, their positions, and all of them together."""
    seen = [j.name for j in Sight.of_target(machine, name).joints]
    turning = [a for a in seen if a in machine.rotary_names]
    own = [np.linspace(machine.axes[a].min, machine.axes[a].max, SIGHT_STEPS) for a in turning]
    mesh = [m.ravel() for m in np.meshgrid(*own, indexing='ij')]
    return turning, own, positions_of(machine, **dict(zip(turning, mesh, strict=True)))


def beams(machine: Machine, name: str, place: Array, q: Array) -> Array:
    """Unit vectors (n, 3) from a reflector to the tracker, in the frame of the reflector's link.

    A reflector of the spindle stays where it is in the middle of the linear axes: they follow.
    """
    sight = Sight.of_target(machine, name)
    seen = sight.at(q)
    at = seen.position
    if machine.targets[name].link == SPINDLE:
        at = sight.nominal(linear_middle(machine)[None])
    beam = np.broadcast_to(np.asarray(place) - at, seen.position.shape)
    beam = beam / np.linalg.norm(beam, axis=1)[:, None]
    return beam if seen.inner is None else np.asarray(np.einsum('nij,ni->nj', seen.inner, beam))


def _lowest(machine: Machine, name: str) -> tuple[float, float]:
    """Sign of Z away from what hides a reflector, and the least component of a beam along it."""
    return (1.0, 0.0) if machine.targets[name].link == TABLE else (-1.0, -float(np.cos(BEHIND)))


def in_view(machine: Machine, name: str, beam: Array) -> NDArray[np.bool_]:
    """Tell of which beams (n, 3) of a reflector neither table nor spindle stands in the way."""
    sign, least = _lowest(machine, name)
    return np.asarray(sign * beam[:, 2] > least)


def sight_share(
    machine: Machine,
    name: str,
    place: Array,
    half_angle: float | None = None,
    facings: int = MOST_FACINGS,
) -> SightShare:
    """Judge where a tracker stands for a reflector.

    Normal of the table and axis of the spindle are taken as Z where all axes are at zero. Facings
    are chosen one after the other, each as the direction that adds most.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin in the frame of the tracker's link.
    half_angle : float, optional
        rad; of the cone of beams that the reflector returns; by default that of machine.yaml.
    """
    turning, own, q = _mesh(machine, name)
    beam = beams(machine, name, place, q)
    sign, least = _lowest(machine, name)
    free = in_view(machine, name, beam)
    angle = machine.surroundings.half_angle if half_angle is None else half_angle
    k = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    height, about = 1.0 - k * (1.0 - least), np.pi * (1.0 + 5.0**0.5) * DIRECTIONS * k
    level = np.sqrt(1.0 - height**2)
    facing = np.stack([level * np.cos(about), level * np.sin(about), sign * height], axis=1)
    within = (beam @ facing.T > np.cos(angle)) & free[:, None]
    covered, shares = np.zeros(len(beam), dtype=bool), []
    for _ in range(facings):
        best = int(np.argmax((within & ~covered[:, None]).sum(axis=0)))
        covered |= within[:, best]
        shares.append(float(covered.mean()))
    by_axis = free.reshape([len(v) for v in own])
    ranges = {
        axis: _range_about(at, np.all(by_axis, axis=tuple(i for i in range(len(own)) if i != k)))
        for k, (axis, at) in enumerate(zip(turning, own, strict=True))
    }
    return SightShare(float(free.mean()), tuple(shares), ranges)


def _range_about(at: Array, free: NDArray[np.bool_]) -> tuple[float, float]:
    """Ends of the longest run of positions that are free; equal where none is."""
    run = at[longest_run(free)]
    return (float(run[0]), float(run[-1])) if len(run) else (float(at[0]), float(at[0]))


def facings_needed(sight: SightShare) -> int:
    """Facings after which a reflector is seen in ``ENOUGH`` of the positions; else all tried."""
    enough = (k for k, share in enumerate(sight.facings, 1) if share >= ENOUGH)
    return next(enough, len(sight.facings))


def sights(machine: Machine, place: Array) -> dict[str, SightShare]:
    """``sight_share`` of the targets that rotary axes turn before the tracker, of nests once."""
    return {
        name: sight_share(machine, name, place)
        for name, target in machine.targets.items()
        if target.nest in ('', name)
        and any(j.axis.rotary for j in Sight.of_target(machine, name).joints)
    }


def least_open(machine: Machine, place: Array) -> float:
    """Least share of the positions in which nothing hides a reflector."""
    shares = []
    for name in machine.targets:
        if any(j.axis.rotary for j in Sight.of_target(machine, name).joints):
            beam = beams(machine, name, place, _mesh(machine, name)[2])
            shares.append(float(np.mean(in_view(machine, name, beam))))
    return min(shares, default=1.0)


def check_side(machine: Machine, place: Array) -> None:
    """Refuse a place of the tracker from which table or spindle hides reflectors.

    Raises
    ------
    ConfigError
        Says in which share of the positions, and on which side the tracker must stand.
    """
    for name, sight in sights(machine, place).items():
        if sight.open < LEAST_OPEN:
            other = default_tracker_place(machine)
            if least_open(machine, other) < sight.open + WORTH_MOVING:
                continue  # no place is much better: the plan says what is hidden
            what = 'table' if machine.targets[name].link == TABLE else 'spindle'
            good = ', '.join(f'{v:.2f}' for v in other)
            raise ConfigError(
                f'tracker_place: the {what} hides {name} in {100 * (1 - sight.open):.0f} % of the '
                f'positions of its rotary axes; stand {_side(what)}, such as {good} m'
            )


def _side(what: str) -> str:
    return 'on the side to which it tilts' if what == 'table' else 'where the reflector faces'


def linear_ends(machine: Machine) -> tuple[Array, Array]:
    """Ends of the ranges of X, Y and Z, (3,) each, m; 0 for an axis that does not exist."""
    own = [machine.axes.get(a) for a in XYZ]
    return (
        np.array([axis.min if axis else 0.0 for axis in own]),
        np.array([axis.max if axis else 0.0 for axis in own]),
    )


def default_tracker_place(machine: Machine) -> Array:
    """Default place of a tracker, shape (3,), m.

    Without rotary axes in front of the volume (-Y) at half height; else high, on the side to which
    the table tilts. Tilting brings the table's normal to one side; on the other side the table
    hides its reflectors. Where they are hidden from there too, the place about the machine from
    which they are hidden least.
    """
    ends = np.stack(linear_ends(machine), axis=1)
    if not machine.rotary_names:
        place = ends.mean(axis=1)
        place[1] = ends[1, 0] - PLACE_DISTANCE
        return np.asarray(place)
    side = np.array([-1.0, -1.0, 0.0])
    if machine.tracker.link == BED:
        for name in (a for a in machine.chain.table_side if a in machine.rotary_names):
            axis = machine.axes[name]
            across = np.cross(np.array(axis.direction), [0.0, 0.0, 1.0])
            if np.linalg.norm(across) > 0.5:  # an axis that tilts the table
                # the target turns by +q relative to the table: the table turns by -q
                most = axis.max if abs(axis.max) > abs(axis.min) else axis.min
                side = -np.sign(most) * across
                side = side + 0.7 * np.cross(side, [0.0, 0.0, 1.0])
    reach = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0]) + 0.5

    def at(side: Array, height: float) -> Array:
        flat = side[:2] / np.linalg.norm(side[:2])
        return np.asarray(ends.mean(axis=1) + reach * np.array([*flat, height]))

    usual = at(side, 0.5)
    if least_open(machine, usual) >= LEAST_OPEN:
        return usual
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    places = [usual]
    places += [at(np.array([np.cos(t), np.sin(t)]), h) for h in (0.5, 0.1, 1.0) for t in turns]
    return max(places, key=lambda place: least_open(machine, place))
