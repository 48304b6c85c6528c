# SPDX-License-Identifier: Apache-2.0
"""Where the tracker stands and which positions of a reflector on the table it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.joints import Sight
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.motions import AXES
from otf_core.planning.rotary_paths import positions_of

SMR_ANGLE = np.radians(30.0)
"""rad; half-angle of the cone of beams that a spherically mounted reflector returns."""
SIGHT_STEPS, FACINGS = 24, 400
"""Positions of every rotary axis, and directions of a reflector, among which sight is judged."""
LEAST_OPEN = 0.8
"""Share of the positions of the rotary axes in which the table must not hide a reflector."""


@dataclass(frozen=True)
class SightShare:
    """In which share of the positions of the rotary axes a reflector on the table is seen.

    Attributes
    ----------
    open : float
        The table does not stand between reflector and tracker.
    facings : tuple of float
        Share seen with 1, 2, ... facings of the reflector, each turned by hand once.
    """

    open: float
    facings: tuple[float, ...]


def sight_share(
    machine: Machine, name: str, place: Array, half_angle: float = SMR_ANGLE, facings: int = 8
) -> SightShare:
    """Judge where a tracker on the bed stands for a reflector on the table.

    The table's normal is taken as Z where all axes are at zero. Facings are chosen one after the
    other, each as the direction that adds most.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin in the frame of the bed.
    half_angle : float
        rad; of the cone of beams that the reflector returns.
    """
    sight = Sight.of_target(machine, name)
    turning = [a for a in machine.chain.table_side if a in machine.rotary_names]
    own = [np.linspace(machine.axes[a].min, machine.axes[a].max, SIGHT_STEPS) for a in turning]
    mesh = [m.ravel() for m in np.meshgrid(*own)]
    seen = sight.at(positions_of(machine, **dict(zip(turning, mesh, strict=True))))
    beam = np.asarray(place) - seen.position
    beam /= np.linalg.norm(beam, axis=1)[:, None]
    if seen.inner is not None:
        beam = np.einsum('nij,ni->nj', seen.inner, beam)  # as the table sees it
    free = beam[:, 2] > 0.0
    k = np.arange(FACINGS) + 0.5
    height, round_about = 1.0 - k / FACINGS, np.pi * (1.0 + 5.0**0.5) * k
    level = np.sqrt(1.0 - height**2)
    facing = np.stack([level * np.cos(round_about), level * np.sin(round_about), height], axis=1)
    within = (beam @ facing.T > np.cos(half_angle)) & free[:, None]
    covered, shares = np.zeros(len(beam), dtype=bool), []
    for _ in range(facings):
        best = int(np.argmax((within & ~covered[:, None]).sum(axis=0)))
        covered |= within[:, best]
        shares.append(float(covered.mean()))
    return SightShare(float(free.mean()), tuple(shares))


def sights(machine: Machine, place: Array) -> dict[str, SightShare]:
    """``sight_share`` of every target on the table, for a tracker on the bed."""
    if machine.tracker.link != BED:
        return {}
    own = [name for name, target in machine.targets.items() if target.link == TABLE]
    return {name: sight_share(machine, name, place) for name in own}


def check_side(machine: Machine, place: Array) -> None:
    """Refuse a place of the tracker from which the table hides its reflectors.

    Raises
    ------
    ConfigError
        Says in which share of the positions, and on which side the tracker must stand.
    """
    for name, sight in sights(machine, place).items():
        if sight.open < LEAST_OPEN:
            good = ', '.join(f'{v:.2f}' for v in default_tracker_place(machine))
            raise ConfigError(
                f'tracker_place: the table hides {name} in {100 * (1 - sight.open):.0f} % of the '
                f'positions of its rotary axes; stand on the side to which it tilts, such as '
                f'{good} m'
            )


def default_tracker_place(machine: Machine) -> Array:
    """Default place of a tracker, shape (3,), m: high, on the side to which the table tilts.

    Tilting brings the table's normal to one side; on the other side the table hides its
    reflectors.
    """
    ends = np.array([(machine.axes[a].min, machine.axes[a].max) for a in AXES])
    side = np.array([-1.0, -1.0, 0.0])
    table = [a for a in machine.chain.table_side if a in machine.rotary_names]
    for name in table:
        axis = machine.axes[name]
        across = np.cross(np.array(axis.direction), [0.0, 0.0, 1.0])
        if np.linalg.norm(across) > 0.5:  # an axis that tilts the table
            # the target turns by +q relative to the table: the table turns by -q
            most = axis.max if abs(axis.max) > abs(axis.min) else axis.min
            side = -np.sign(most) * np.cross(np.array(axis.direction), [0.0, 0.0, 1.0])
            side = side + 0.7 * np.cross(side, [0.0, 0.0, 1.0])
    middle = ends.mean(axis=1)
    reach = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0]) + 0.5
    return np.asarray(middle + reach * np.array([*side[:2] / np.linalg.norm(side[:2]), 0.5]))
