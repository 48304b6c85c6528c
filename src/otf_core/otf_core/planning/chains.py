# SPDX-License-Identifier: Apache-2.0
"""Paths that show the errors of rotary axes, and what they will show.

A sample says nothing along the direction of travel, so an error is seen at an axis position only
if the reflector passes there in directions that leave no common component out. For unknowns x with
rows A(q), driven directions d and P = I - d d^T, x is not seen if and only if

    P A(q) x = 0   at every driven place                                      (rank condition)

Circles of one rotary axis always leave out the tangent, which is all that its angular positioning
moves. It is seen where a second axis moves at the same time: another rotary axis (A with C), a
linear axis (spiral), or linear axes that follow the rotation but for a slow creep in a direction
of choice (TCP creep); or at stops, which leave out nothing. Moves of several axes are driven in
both senses: a lag between drives acts in opposite sense and cancels in the mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight
from otf_core.model.machine import SPINDLE, TABLE, TOOL, Machine
from otf_core.model.motions import AXES
from otf_core.model.plan import STOPS, Part, part_along
from otf_core.planning.nc.programs import on_increment
from otf_core.planning.path_creation import LINES, box_lap, linear_names, rest

CREEP = 0.06
"""m that the reflector creeps while a rotary axis runs through its range."""
CREEP_CORNER = np.radians(1.0)
"""rad between corners of a chain in which linear axes follow a rotation."""
CREEP_PLACES = ((0.5, 0.1, 0.4), (-0.3, 0.45, 0.15), (-0.25, -0.4, 0.6), (0.1, 0.2, 0.85))
"""Places of the creeping reflector: X, Y and height in shares of a reach."""
REACHES = (0.4, 0.2)
"""m; the places lie within half of it of a rotary axis: of the first one if the linear axes follow
all of the rotation there, since angular positioning is seen better the farther from the axis."""
LEAST_REACHED = 0.5
"""Share of a chain that the linear axes must reach."""
LEAST_TILT = 0.3
"""rad; another rotary axis is tilted by more, or it stands at rest."""
STOP_TURN, STOP_TIME = np.radians(15.0), 1.0
"""rad between stops of a rotary axis and s at each."""
SWEEPS = (1, 2, 3)
"""Sweeps of the second rotary axis per range of the first, one reflector place after the other."""
HAND_MOVE = 60.0
"""s for taking the reflector to its next place by hand."""


@dataclass(frozen=True)
class Chain:
    """Corners that are driven one after the other with one reflector in view, in both senses.

    Attributes
    ----------
    corners : ndarray, shape (n, k), m and rad
    words : str
        What it is.
    dwell : float
        s at every corner; 0 drives through smooth ones.
    """

    target: str
    corners: Array
    words: str
    dwell: float = 0.0

    @property
    def is_lines(self) -> bool:
        """Moves linear axes alone."""
        return self.words == LINES

    @property
    def part(self) -> tuple[str, bool, float]:
        """Chains that agree in it may be driven as one part."""
        return self.target, self.is_lines, self.dwell


def positions_of(machine: Machine, **axes: Array | float) -> Array:
    """Axis positions (n, k) from positions of single axes, the others at rest.

    Axes that are not given stand at zero, or where zero is outside their range in its middle.
    """
    count = max(np.atleast_1d(np.asarray(own)).size for own in axes.values())
    positions = np.tile(rest(machine), (count, 1))
    for name, own in axes.items():
        positions[:, machine.column(name)] = own
    return positions


def clear_of_table(machine: Machine, name: str) -> dict[str, float]:
    """Where the linear axes of the spindle wait while a reflector on the table is in view.

    X and Y at rest, Z at the end of its range that is farther from the reflector.
    """
    if 'Z' not in machine.chain.target_side or machine.targets[name].link != TABLE:
        return {}
    ends = machine.axes['Z'].min, machine.axes['Z'].max
    spindle, own = Sight.of_tool(machine), np.array(machine.targets[name].place)
    off = [np.linalg.norm(spindle.nominal(positions_of(machine, Z=z))[0] - own) for z in ends]
    return {'Z': ends[int(np.argmax(off))]}


def there_and_back(corners: Array) -> Array:
    """Corners followed in reverse: both senses of every leg."""
    return np.concatenate([corners, corners[-2::-1]])


def turn(machine: Machine, axis: str, **others: float) -> Array:
    """One axis over its range and back: a circle or an arc, corners (3, k)."""
    ends = np.array([machine.axes[axis].min, machine.axes[axis].max])
    return there_and_back(positions_of(machine, **{axis: ends}, **others))


def turn_together(
    machine: Machine, first: str, second: str, sweeps: int, **others: float
) -> Array:
    """Two axes at once: ``second`` sweeps its range several times while ``first`` runs once.

    Beginning at either end of the second, each in both senses; corners (n, k).
    """
    a, b = machine.axes[first], machine.axes[second]
    along = np.linspace(a.min, a.max, sweeps + 1)
    odd = np.arange(sweeps + 1) % 2 == 1
    chains = []
    for start, end in ((b.min, b.max), (b.max, b.min)):
        own = {first: along, second: np.where(odd, end, start)}
        chain = positions_of(machine, **own, **others)
        chains.append(there_and_back(chain))
    return np.concatenate(chains)


def longest_run(free: NDArray[np.bool_]) -> slice:
    """The longest run of neighbours (n,) that are free."""
    marks = np.flatnonzero(np.concatenate([[True], ~free, [True]]))
    longest = int(np.argmax(np.diff(marks)))
    return slice(int(marks[longest]), int(marks[longest + 1]) - 1)


def creep(
    machine: Machine,
    turning: Mapping[str, Array],
    start: Array,
    drift: Array,
    target: str = TOOL,
) -> Array:
    """Turn rotary axes while the linear axes hold the reflector but for a slow drift, and back.

    Where the linear axes do not reach all of it, the longest piece that they reach.

    Parameters
    ----------
    turning : mapping of axis to ndarray, shape (n,), rad
        Positions of the rotary axes at the corners; the others stand at rest.
    start, drift : ndarray, shape (3,), m
        First place of the reflector in the frame of the tracker's link, and how far it creeps.

    Returns
    -------
    ndarray, shape (m, k), m and rad

    Raises
    ------
    ConfigError
        If the linear axes reach less than ``LEAST_REACHED``; names one that leaves its range.
    """
    names = linear_names(machine)
    if len(names) < len(AXES):
        raise ConfigError(f'creep of {", ".join(turning)}: three linear axes have to follow')
    q = positions_of(machine, **turning)
    share = np.linspace(0.0, 1.0, len(q))
    sight = Sight.of_target(machine, target)
    wanted = np.asarray(start) + share[:, None] * np.asarray(drift)
    linear = [machine.column(a) for a in names]
    for _ in range(2):  # positions are linear in the linear axes; the second step is rounding
        seen = sight.at(q)
        off = (wanted - seen.position)[:, :, None]
        q[:, linear] += np.linalg.solve(seen.velocity[:, :, linear], off)[:, :, 0]
    beyond = np.maximum(machine.lower - q, q - machine.upper)[:, linear]
    reached = longest_run(np.all(beyond <= 0.0, axis=1))
    if reached.stop - reached.start < LEAST_REACHED * len(q):
        worst = int(np.argmax(beyond.max(axis=0)))
        axes = ' with '.join(a for a in turning if np.ptp(turning[a]) > 0)
        raise ConfigError(
            f'creep of {axes}: {names[worst]} would leave its range by '
            f'{beyond[:, worst].max():.3g} m'
        )
    return there_and_back(q[reached])


def stops(machine: Machine, axis: str, **others: float) -> Array:
    """Positions of a rotary axis to stop at, corners (n, k)."""
    own = machine.axes[axis]
    count = int(np.ceil((own.max - own.min) / STOP_TURN)) + 1
    return positions_of(machine, **{axis: np.linspace(own.min, own.max, count)}, **others)


def creeps(
    machine: Machine, turning: Mapping[str, Array], target: str, size: float = CREEP
) -> list[Array]:
    """TCP creep at several places in two directions, as far as the linear axes reach.

    Parameters
    ----------
    turning : mapping of axis to ndarray, shape (n,), rad
        See ``creep``; the first one is that about which places and directions are chosen.
    size : float
        m; of the drift, 0 where the reflector stands still.

    Raises
    ------
    ConfigError
        If the linear axes do not reach any of it.
    """
    sight = Sight.of_target(machine, target)
    nominal = sight.nominal(linear_middle(machine)[None])[0]
    axis = next(iter(turning))
    own = machine.axes[axis]
    across = np.array(own.direction)
    side = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
    paths, refused = [], []
    table = axis in machine.chain.table_side
    # places about an axis of the tool side differ in the positions of the linear axes alone
    whole = 2 * len(turning[axis]) - 1
    for place in CREEP_PLACES if table else CREEP_PLACES[:2]:
        for drift in (size * across, size * side / np.linalg.norm(side)):
            for reach in REACHES if table else REACHES[1:]:
                at = reach * np.array(place)
                start = np.array(own.centre) + at if table else nominal + 0.5 * at
                try:
                    path = creep(machine, turning, start - 0.5 * drift, drift, target)
                except ConfigError as error:
                    refused.append(error)
                    continue
                if len(path) == whole or reach == REACHES[-1]:
                    paths.append(path)
                    break
    if not paths:
        raise refused[0]
    return paths


def courses(machine: Machine, axis: str) -> Array:
    """Positions (n,) of a rotary axis over its range, rad, no more than a corner apart."""
    own = machine.axes[axis]
    count = int(np.ceil((own.max - own.min) / CREEP_CORNER)) + 1
    return np.linspace(own.min, own.max, count)


def creep_chains(machine: Machine, turning: Sequence[str], target: str) -> list[Chain]:
    """TCP creep of every rotary axis, others at rest or tilted, and of two at once."""
    chains: list[Chain] = []

    def add(words: str, course: Mapping[str, Array]) -> None:
        try:
            own = creeps(machine, course, target)
        except ConfigError:
            return
        chains.extend(Chain(target, q, words) for q in own)

    for axis in turning:
        whole = courses(machine, axis)
        words = f'linear axes follow {axis}, TCP creep'
        add(words, {axis: whole})
        for other in (a for a in turning if a != axis):
            for tilt in _tilts(machine, other):
                add(words, {axis: whole, other: np.full(len(whole), tilt)})
    for first, second in combinations(turning, 2):
        words = f'linear axes follow {first} with {second}, TCP creep'
        a, b = courses(machine, first), courses(machine, second)
        count = max(len(a), len(b))
        one, two = (np.linspace(v[0], v[-1], count) for v in (a, b))
        add(words, {first: one, second: two})
        add(words, {first: one, second: two[::-1]})
    return chains


def _tilts(machine: Machine, axis: str) -> list[float]:
    """Positions of a rotary axis, rad, towards both ends of its range and away from its rest."""
    own, at = machine.axes[axis], rest(machine)[machine.column(axis)]
    ends = [own.min + share * (own.max - own.min) for share in (0.2, 0.8)]
    return [float(v) for v in ends if abs(v - at) > LEAST_TILT]


def linear_middle(machine: Machine) -> Array:
    """Linear axes in the middle of their ranges, rotary axes at rest, (k,)."""
    q = rest(machine)
    for name in linear_names(machine):
        q[machine.column(name)] = 0.5 * (machine.axes[name].min + machine.axes[name].max)
    return q


def candidate_chains(machine: Machine, config: PlannerConfig) -> list[Chain]:
    """Chains that show what the set-up can show.

    Spindle targets: lines, TCP creep and a spiral of every rotary axis between them and the
    tracker. Targets on the table: circles and arcs of every rotary axis, two rotary axes together,
    else a linear axis on the table with the rotary one, else stops. Those of reflectors that are
    turned to several facings depend on the place of the tracker: ``facings.facing_chains``.

    Raises
    ------
    ConfigError
        If no target moves relative to the tracker.
    """
    chains: list[Chain] = []
    tools, nests = 0, 0
    for name, target in machine.targets.items():
        seen = [j.name for j in Sight.of_target(machine, name).joints]
        turning = [a for a in seen if a in machine.rotary_names]
        if target.link == SPINDLE:
            if tools:  # a second place tells more of the tool side alone
                turning = [a for a in turning if a in machine.chain.target_side]
            linear = [a for a in linear_names(machine) if a in seen]
            if linear:
                chains.append(Chain(name, _lines(machine, config, linear, tools), LINES))
            chains += creep_chains(machine, turning, name) if len(linear) == 3 else []
            for axis in turning if linear else []:
                outward = _spiral_outward(machine, axis, linear[0])
                chains.append(Chain(name, outward, f'{axis} with {linear[0]}, spiral'))
            tools += 1
        elif turning and not target.nest:
            linear = [a for a in seen if a not in machine.rotary_names]
            chains += _table_chains(machine, name, turning, linear, nests)
            nests += 1
    if not chains:
        raise ConfigError(
            f'targets: none moves relative to the tracker (link {machine.tracker.link})'
        )
    return chains


def _lines(machine: Machine, config: PlannerConfig, axes: list[str], number: int) -> Array:
    """Lines with the spindle target of a number, in both senses unless there is one pass alone.

    In one sense a lag of a linear axis is an error of its position; in opposite senses with two
    targets it is one of its rotations.
    """
    lap = box_lap(machine, axes, min(config.levels, 2) if number > 1 else config.levels)
    return there_and_back(lap) if config.passes > 1 else lap


def _spiral_outward(machine: Machine, axis: str, radial: str) -> Array:
    """A linear axis from its middle to its end while a rotary axis turns, the others mid-range."""
    middle, own = linear_middle(machine), machine.axes[axis]
    q = np.tile(middle, (2, 1))
    q[:, machine.column(axis)] = own.min, own.max
    q[1, machine.column(radial)] = machine.axes[radial].max
    return there_and_back(q)


def _table_chains(
    machine: Machine, name: str, turning: Sequence[str], linear: Sequence[str], number: int
) -> list[Chain]:
    """Chains with a reflector on the table."""
    wait = {a: v for a, v in clear_of_table(machine, name).items() if a not in linear}
    chains = [Chain(name, turn(machine, a, **wait), f'{a} alone') for a in (*turning, *linear)]
    sweeps = SWEEPS[number % len(SWEEPS)]
    pairs = [(a, b) for k, a in enumerate(turning) for b in (*turning[k + 1 :], *linear)]
    for first, second in pairs:
        wide = max((first, second), key=lambda a: machine.axes[a].max - machine.axes[a].min)
        other = second if wide == first else first
        own = turn_together(machine, wide, other, sweeps, **wait)
        chains.append(Chain(name, own, f'{first} with {second}'))
    if not pairs:
        halts = stops(machine, turning[0], **wait)
        chains.append(Chain(name, halts, f'{STOPS} of {turning[0]}', STOP_TIME))
    return chains


def parts_of(machine: Machine, chains: Sequence[Chain], config: PlannerConfig) -> tuple[Part, ...]:
    """Chains as parts: those of one target after the other, with links between."""
    parts = []
    for _, group in groupby(chains, key=lambda c: c.part):
        own = list(group)
        q = np.concatenate([own[0].corners, *(_link(machine, a, b) for a, b in pairwise(own))])
        words = ', '.join(dict.fromkeys(c.words for c in own))
        path = AxisPath(machine.axis_names, q, own[0].target)
        parts.append(part_along(machine, path, config, words, own[0].dwell))
    return tuple(parts)


def _link(machine: Machine, first: Chain, second: Chain) -> Array:
    """Corners of the second chain after a link: linear axes, then one rotary axis after the other.

    A link is driven in one sense alone, so it mixes no rotary axis with another one.
    """
    at, rows = first.corners[-1].copy(), []
    groups = [
        [machine.column(a) for a in linear_names(machine)],
        *([machine.column(a)] for a in machine.rotary_names),
    ]
    for columns in groups:
        at[columns] = second.corners[0][columns]
        rows.append(at.copy())
    return np.concatenate([rows, second.corners[1:]])


def verification_part(machine: Machine) -> Part | None:
    """Turn every rotary axis while the linear axes hold the reflector; None if out of reach.

    It is driven with TCP on; its corners are where the axes are then, 1 degree apart.
    """
    table = replace(machine, tracker=replace(machine.tracker, link='w'))
    held = []
    for axis in machine.rotary_names:
        with suppress(ConfigError):  # the linear axes do not reach
            held.append(creeps(table, {axis: courses(machine, axis)}, TOOL, 0.0)[0])
    if not held:
        return None
    path = AxisPath(machine.axis_names, np.concatenate(held), TOOL)
    config = PlannerConfig(feed=0.1)
    return on_increment(machine, part_along(machine, path, config, 'TCP on'))
