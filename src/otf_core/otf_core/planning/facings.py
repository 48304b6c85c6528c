# SPDX-License-Identifier: Apache-2.0
"""What is driven with a reflector that returns a narrow cone of beams, one facing after another.

The table stands still in the middle of a facing while the operator turns the reflector in its nest
to the tracker. From there every chain runs in straight lines to where the beam leaves the cone, in
both senses. Each facing is a target of its own, since turning moves the centre of the reflector by
some micrometres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.errors import ConfigError
from otf_core.model.chain import Sight
from otf_core.model.machine import TABLE, Machine, facing_names
from otf_core.model.plan import STOPS
from otf_core.planning.chains import (
    STOP_TIME,
    STOP_TURN,
    Chain,
    clear_of_table,
    positions_of,
)
from otf_core.planning.line_of_sight import beams, in_view

AIM = np.radians(3.0)
"""rad by which the operator's aim may be off; chains stay so far within the cone."""
MESH = np.radians(7.5)
"""rad between the positions among which the middles of facings are chosen."""
ALONG = 90
"""Positions that a line from the middle of a facing to the end of the ranges is examined at."""
SHORTEST = np.radians(10.0)
"""rad; a chain that turns no axis by more is left out."""


@dataclass(frozen=True)
class _Nest:
    """A reflector on the table with what moves it before the tracker.

    Attributes
    ----------
    turning, linear : sequence of str
        Axes between it and the tracker.
    wait : mapping of axis to float
        Where the axes of the spindle stand.
    """

    machine: Machine
    name: str
    place: Array
    turning: Sequence[str]
    linear: Sequence[str]
    wait: Mapping[str, float]

    def positions(self, axes: Mapping[str, Array | float]) -> Array:
        """Axis positions (n, k)."""
        return positions_of(self.machine, **{**self.wait, **axes})

    def beams(self, q: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Unit vectors (n, 3) to the tracker, and where the table does not hide the reflector."""
        beam = beams(self.machine, self.name, self.place, q)
        return beam, in_view(self.machine, self.name, beam)


def facing_chains(machine: Machine, place: Array) -> list[Chain]:
    """Chains with reflectors on the table that are turned in their nests.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin in the frame of the tracker's link.
    """
    chains: list[Chain] = []
    for name, target in machine.targets.items():
        if target.nest != name or target.link != TABLE:
            continue
        seen = [j.name for j in Sight.of_target(machine, name).joints]
        turning = [a for a in seen if a in machine.rotary_names]
        linear = [a for a in seen if a not in turning]
        if not turning:
            continue
        wait = {a: v for a, v in clear_of_table(machine, name).items() if a not in linear}
        nest = _Nest(machine, name, np.asarray(place), turning, linear, wait)
        middles = _middles(nest, target.facings)
        for own, middle in zip(facing_names(name, target.facings), middles, strict=False):
            chains += _chains_of_facing(nest, own, middle)
    return chains


def _middles(nest: _Nest, count: int) -> list[dict[str, float]]:
    """Positions of the rotary axes at which the reflector is turned to the tracker.

    One after the other, each as the one from which most is seen that others do not show.

    Raises
    ------
    ConfigError
        If the table hides the reflector everywhere.
    """
    axes = [nest.machine.axes[a] for a in nest.turning]
    own = [np.linspace(a.min, a.max, int(np.ceil((a.max - a.min) / MESH)) + 1) for a in axes]
    mesh = np.array([m.ravel() for m in np.meshgrid(*own, indexing='ij')])
    beam, free = nest.beams(nest.positions(dict(zip(nest.turning, mesh, strict=True))))
    if not free.any():
        raise ConfigError(f'targets: {nest.name}: the table hides it from the tracker everywhere')
    within = (beam @ beam.T > np.cos(_cone(nest.machine))) & free & free[:, None]
    covered, middles = np.zeros(len(beam), dtype=bool), []
    for _ in range(count):
        new = (within & ~covered).sum(axis=1)
        best = int(np.argmax(new))
        if not new[best]:
            break
        covered |= within[best]
        middles.append(dict(zip(nest.turning, mesh[:, best].tolist(), strict=True)))
    return middles


def _cone(machine: Machine) -> float:
    """Half-angle within which beams are returned wherever the operator aims, rad."""
    own = machine.surroundings.half_angle
    return float(max(own - AIM, 0.5 * own))


def _chains_of_facing(nest: _Nest, name: str, middle: Mapping[str, float]) -> list[Chain]:
    """Each axis by itself, and two at once along both diagonals, through the middle."""
    whole = {a: nest.machine.axes[a] for a in (*nest.turning, *nest.linear)}
    at = {a: middle.get(a, 0.5 * (own.min + own.max)) for a, own in whole.items()}
    reach = {a: _ends(nest, at, {a: 1.0}) for a in whole}
    width = {a: high - low for a, (low, high) in reach.items()}
    chains = []
    for axis, ends in reach.items():
        if axis not in nest.turning or width[axis] > SHORTEST:
            corners = _there_and_back(nest, at, {axis: 1.0}, ends)
            chains.append(Chain(name, corners, f'{axis} alone'))
    pairs = [p for p in combinations(whole, 2) if p[0] in nest.turning]
    for first, second in pairs:
        for sign in (1.0, -1.0):
            along = {first: width[first], second: sign * width[second]}
            low, high = _ends(nest, at, along)
            if (high - low) * width[first] > SHORTEST:
                corners = _there_and_back(nest, at, along, (low, high))
                chains.append(Chain(name, corners, f'{first} with {second}'))
    if not pairs:
        axis = nest.turning[0]
        count = int(np.ceil(width[axis] / STOP_TURN)) + 1
        stops = {axis: np.linspace(*reach[axis], count)}
        corners = nest.positions({**at, **stops})
        chains.append(
            Chain(name, _from_middle(nest, at, corners), f'{STOPS} of {axis}', STOP_TIME)
        )
    return chains


def _there_and_back(
    nest: _Nest,
    at: Mapping[str, float],
    along: Mapping[str, float],
    ends: tuple[float, float],
) -> Array:
    """Corners from the middle to one end of a line in view, to the other and back."""
    share = np.array([ends[0], ends[1], ends[0]])
    corners = nest.positions({a: v + along.get(a, 0.0) * share for a, v in at.items()})
    return _from_middle(nest, at, corners)


def _from_middle(nest: _Nest, at: Mapping[str, float], corners: Array) -> Array:
    """Corners that begin and end in the middle of the facing."""
    middle = nest.positions(at)
    q = np.concatenate([middle, corners, middle])
    moves = [True, *(bool(np.any(a != b)) for a, b in pairwise(q))]
    return np.asarray(q[moves])


def _ends(nest: _Nest, at: Mapping[str, float], along: Mapping[str, float]) -> tuple[float, float]:
    """How far along a line through the middle the reflector is seen, to both sides."""
    room = [-np.inf, np.inf]
    for axis, by in along.items():
        own = nest.machine.axes[axis]
        ends = sorted(((own.min - at[axis]) / by, (own.max - at[axis]) / by)) if by else room
        room = [max(room[0], ends[0]), min(room[1], ends[1])]
    aim = nest.beams(nest.positions(at))[0][0]
    reached = []
    for end in room:
        share = np.linspace(0.0, end, ALONG + 1)
        q = nest.positions({a: v + along.get(a, 0.0) * share for a, v in at.items()})
        beam, free = nest.beams(q)
        lost = ~(free & (beam @ aim > np.cos(_cone(nest.machine))))
        lost[0] = False
        reached.append(float(share[int(np.argmax(lost)) - 1 if lost.any() else ALONG]))
    return reached[0], reached[1]
