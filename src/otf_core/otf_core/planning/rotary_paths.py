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
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig, ForecastConfig, PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import (
    AxisPath,
    driven_through,
    position_at,
    travel_per_unit,
)
from otf_core.model.evaluation import PLACES, evenly_spread
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import Sight
from otf_core.model.machine import BED, SPINDLE, TABLE, TOOL, Machine
from otf_core.model.motions import AXES
from otf_core.model.nodes import table_nodes
from otf_core.noise.noise_model import NoiseModel
from otf_core.planning.path_creation import lap_of_box
from otf_core.rotary.axis_solution import AxisSolution, place_equations
from otf_core.rotary.axis_unknowns import layout, smooth_bases
from otf_core.rotary.curve_matching import Part, nominal_places
from otf_core.rotary.reduction import TOGETHER, AxisPieces
from otf_core.rotary.rows import AxisRun, build_rows
from otf_core.rotary.tabulation import (
    determined_combinations,
    field_rows,
    gauge_matrix,
    raw_rows,
)
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.roughness import expected_precision
from otf_core.solving.solution import solve
from otf_core.solving.whitener import Whitener

TURN_RATE = np.radians(15.0)
"""rad/s; rotary axes turn no faster, so that samples at 500 Hz lie 0.03 degrees apart."""
CREEP = 0.06
"""m that the reflector creeps while a rotary axis runs through its range."""
CREEP_CORNER = np.radians(1.0)
"""rad between corners of a chain in which linear axes follow a rotation."""
CREEP_PLACES = ((0.5, 0.1, 0.4), (-0.3, 0.45, 0.15), (-0.25, -0.4, 0.6), (0.1, 0.2, 0.85))
"""Places of the creeping reflector: X, Y in shares of ``REACH`` and its height in shares of it."""
REACH = 0.2
"""m; radius about a rotary axis within which the reflector creeps."""
STOP_TURN, STOP_TIME = np.radians(15.0), 1.0
"""rad between stops of a rotary axis and s at each."""
SWEEPS = (1, 2, 3)
"""Sweeps of the second rotary axis per range of the first, one reflector place after the other."""
STILL = 1e-4
"""Travel of the reflector per travel of the axes below which nothing is stated across it."""
SMR_ANGLE = np.radians(30.0)
"""rad; half-angle of the cone of beams that a spherically mounted reflector returns."""
SIGHT_STEPS, FACINGS = 24, 400
"""Positions of every rotary axis, and directions of a reflector, among which sight is judged."""
LEAST_OPEN = 0.8
"""Share of the positions of the rotary axes in which the table must not hide a reflector."""
ACCELERATION_TIME = 0.4
"""s lost at every corner that is not driven through."""
HAND_MOVE = 60.0
"""s for taking the reflector to its next place by hand."""
LINES = 'lines'
"""Words of chains of the linear axes alone."""


@dataclass(frozen=True)
class PlannedPart:
    """What is driven with one reflector place in view.

    Attributes
    ----------
    dwell : float
        s at every corner; 0 drives through smooth ones.
    words : str
        What it is.
    """

    path: AxisPath
    dwell: float
    words: str


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


@dataclass(frozen=True)
class RotaryForecast:
    """What a plan will show.

    Attributes
    ----------
    u : mapping of name to float
        m or rad; root mean square over the nodes of the standard uncertainty, in the gauge of the
        tables; of squareness and location errors their own.
    hidden : mapping of name to str
        What will not be seen, and why.
    grid_u : float
        m; mean uncertainty of error vectors over the driven ranges.
    duration : float
        s, without moves by hand.
    """

    u: Mapping[str, float]
    hidden: Mapping[str, str]
    grid_u: float
    duration: float


def positions_of(machine: Machine, **axes: Array | float) -> Array:
    """Axis positions (n, k) from positions of single axes, the others at rest.

    Axes that are not given stand at zero, or where zero is outside their range in its middle.
    """
    count = max(np.atleast_1d(np.asarray(own)).size for own in axes.values())
    positions = np.tile(rest(machine), (count, 1))
    for name, own in axes.items():
        positions[:, machine.column(name)] = own
    return positions


def rest(machine: Machine) -> Array:
    """Positions (k,) at which axes that a part does not need stand."""
    own = [machine.axes[a] for a in machine.axis_names]
    return np.array([0.0 if a.min <= 0.0 <= a.max else 0.5 * (a.min + a.max) for a in own])


def clear_of_table(machine: Machine, name: str) -> dict[str, float]:
    """Where the linear axes of the spindle wait while a reflector on the table is in view.

    X and Y at rest, Z at the end of its range that is farther from the reflector.
    """
    free = [a for a in AXES if a in machine.chain.target_side]
    if 'Z' not in free or machine.targets[name].link != TABLE:
        return {}
    ends = machine.axes['Z'].min, machine.axes['Z'].max
    spindle, own = Sight.of_tool(machine), np.array(machine.targets[name].place)
    off = [np.linalg.norm(spindle.nominal(positions_of(machine, Z=z))[0] - own) for z in ends]
    return {'Z': ends[int(np.argmax(off))]}


def box_lines(machine: Machine, levels: int) -> Array:
    """Lines and diagonals of the linear axes, corners (n, k); rotary axes at rest."""
    ends = np.array([(machine.axes[a].min, machine.axes[a].max) for a in AXES])
    box = ends[:, 0] + lap_of_box(levels) * (ends[:, 1] - ends[:, 0])
    return positions_of(machine, **{a: box[:, k] for k, a in enumerate(AXES)})


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


def creep(machine: Machine, axis: str, start: Array, drift: Array, target: str = TOOL) -> Array:
    """Turn a rotary axis while the linear axes hold the reflector but for a slow drift, and back.

    Parameters
    ----------
    start, drift : ndarray, shape (3,), m
        First place of the reflector in the frame of the tracker's link, and how far it creeps.

    Returns
    -------
    ndarray, shape (n, k), m and rad

    Raises
    ------
    ConfigError
        If a linear axis would leave its range.
    """
    own = machine.axes[axis]
    share = np.linspace(0.0, 1.0, int(np.ceil((own.max - own.min) / CREEP_CORNER)) + 1)
    q = positions_of(machine, **{axis: own.min + share * (own.max - own.min)})
    sight = Sight.of_target(machine, target)
    wanted = np.asarray(start) + share[:, None] * np.asarray(drift)
    linear = [machine.column(a) for a in AXES]
    for _ in range(2):  # positions are linear in the linear axes; the second step is rounding
        seen = sight.at(q)
        off = (wanted - seen.position)[:, :, None]
        q[:, linear] += np.linalg.solve(seen.velocity[:, :, linear], off)[:, :, 0]
    for name in AXES:
        ends, at = machine.axes[name], q[:, machine.column(name)]
        out = max(ends.min - at.min(), at.max() - ends.max)
        if out > 0.0:
            raise ConfigError(f'creep of {axis}: {name} would leave its range by {out:.3g} m')
    return there_and_back(q)


def stops(machine: Machine, axis: str, **others: float) -> Array:
    """Positions of a rotary axis to stop at, corners (n, k)."""
    own = machine.axes[axis]
    count = int(np.ceil((own.max - own.min) / STOP_TURN)) + 1
    return positions_of(machine, **{axis: np.linspace(own.min, own.max, count)}, **others)


def creeps(machine: Machine, axis: str, target: str, size: float = CREEP) -> list[Array]:
    """TCP creep at several places in two directions, as far as the linear axes reach.

    Parameters
    ----------
    size : float
        m; of the drift, 0 where the reflector stands still.
    """
    sight = Sight.of_target(machine, target)
    nominal = sight.nominal(_middle(machine)[None])[0]
    own = machine.axes[axis]
    across = np.array(own.direction)
    side = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
    paths = []
    table = axis in machine.chain.table_side
    for x, y, z in CREEP_PLACES:
        at = REACH * np.array([x, y, z])
        start = np.array(own.centre) + at if table else nominal + 0.5 * at
        for drift in (size * across, size * side / np.linalg.norm(side)):
            try:
                paths.append(creep(machine, axis, start - 0.5 * drift, drift, target))
            except ConfigError:
                continue
    return paths


def _middle(machine: Machine) -> Array:
    """Linear axes in the middle of their ranges, rotary axes at rest, (k,)."""
    q = rest(machine)
    for name in AXES:
        q[machine.column(name)] = 0.5 * (machine.axes[name].min + machine.axes[name].max)
    return q


def plan_parts(machine: Machine, config: PlannerConfig) -> list[PlannedPart]:
    """Parts that show what the set-up can show, see ``candidate_chains``."""
    return parts_of(machine, candidate_chains(machine, config))


def candidate_chains(machine: Machine, config: PlannerConfig) -> list[Chain]:
    """Chains that show what the set-up can show.

    Spindle targets: lines, TCP creep and a spiral of every rotary axis between them and the
    tracker. Targets on the table: circles and arcs of every rotary axis, two rotary axes together,
    else a linear axis on the table with the rotary one, else stops.

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
            if all(a in seen for a in AXES):
                chains.append(Chain(name, _lines(machine, config, tools), LINES))
            for axis in turning:
                words = f'linear axes follow {axis}, TCP creep'
                chains += [Chain(name, own, words) for own in creeps(machine, axis, name)]
                outward = _spiral_outward(machine, axis)
                chains.append(Chain(name, outward, f'{axis} with X, spiral'))
            tools += 1
        elif turning:
            chains += _table_chains(machine, name, turning, [a for a in seen if a in AXES], nests)
            nests += 1
    if not chains:
        raise ConfigError(
            f'targets: none moves relative to the tracker (link {machine.tracker.link})'
        )
    return chains


def _lines(machine: Machine, config: PlannerConfig, number: int) -> Array:
    """Lines with the spindle target of a number, in both senses unless there is one pass alone.

    In one sense a lag of a linear axis is an error of its position; in opposite senses with two
    targets it is one of its rotations.
    """
    lap = box_lines(machine, min(config.levels, 2) if number > 1 else config.levels)
    return there_and_back(lap) if config.passes > 1 else lap


def _spiral_outward(machine: Machine, axis: str) -> Array:
    """X from its middle to its end while a rotary axis turns, Y and Z in their middles."""
    middle = _middle(machine)
    x, y, z = (machine.column(a) for a in AXES)
    others = {'Y': float(middle[y]), 'Z': float(middle[z])}
    own = machine.axes[axis]
    ends = {axis: np.array([own.min, own.max]), 'X': np.array([middle[x], machine.axes['X'].max])}
    return there_and_back(positions_of(machine, **ends, **others))


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
        chains.append(Chain(name, halts, f'stops of {turning[0]}', STOP_TIME))
    return chains


def parts_of(machine: Machine, chains: Sequence[Chain]) -> list[PlannedPart]:
    """Chains as parts: those of one target after the other, with links between."""
    parts = []
    for _, group in groupby(chains, key=lambda c: c.part):
        own = list(group)
        q = np.concatenate([own[0].corners, *(_link(machine, a, b) for a, b in pairwise(own))])
        words = ', '.join(dict.fromkeys(c.words for c in own))
        path = AxisPath(machine.axis_names, q, own[0].target).of(machine)
        parts.append(PlannedPart(path, own[0].dwell, words))
    return parts


def _link(machine: Machine, first: Chain, second: Chain) -> Array:
    """Corners of the second chain after a link: linear axes, then one rotary axis after the other.

    A link is driven in one sense alone, so it mixes no rotary axis with another one.
    """
    at, rows = first.corners[-1].copy(), []
    groups = [
        [machine.column(a) for a in AXES],
        *([machine.column(a)] for a in machine.rotary_names),
    ]
    for columns in groups:
        at[columns] = second.corners[0][columns]
        rows.append(at.copy())
    return np.concatenate([rows, second.corners[1:]])


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


def seconds_of_legs(machine: Machine, q: Array, feed: float) -> Array:
    """Times (n - 1,) of the legs between corners, s: none is faster than feed and ``TURN_RATE``.

    Parameters
    ----------
    feed : float
        m/s, of the linear axes.
    """
    legs = np.abs(np.diff(q, axis=0))
    turning = np.array([machine.axes[a].rotary for a in machine.axis_names])
    travel = np.linalg.norm(legs[:, ~turning], axis=1)
    angle = legs[:, turning].max(axis=1, initial=0.0)
    return np.asarray(np.maximum(travel / feed, angle / TURN_RATE))


@dataclass(frozen=True)
class _Cut:
    """Pieces of one part: places on its path and times."""

    first: Array
    last: Array
    time: Array
    duration: Array
    stretch: Index


def _cut(machine: Machine, part: PlannedPart, config: PlannerConfig, piece: float) -> _Cut:
    """Cut a part into pieces of equal travel, with times at the speed of its slowest leg."""
    q = part.path.positions
    length = np.linalg.norm(np.diff(q, axis=0) * travel_per_unit(machine), axis=1)
    stretch = np.cumsum(np.append(True, ~driven_through(machine, q))) - 1
    per_metre = seconds_of_legs(machine, q, config.feed) / length
    reach = np.append(0.0, length.cumsum())
    rows, clock = [], 0.0
    for k in range(stretch[-1] + 1):
        own = np.flatnonzero(stretch == k)
        low, high = reach[own[0]], reach[own[-1] + 1]
        count = max(1, int(np.ceil((high - low) / piece)))
        marks = np.linspace(low, high, count + 1)
        pace = per_metre[own].max()
        at = np.interp(marks, reach, np.arange(len(reach)))
        took = np.full(count, (marks[1] - marks[0]) * pace)
        begin = clock + took[0] * np.arange(count)
        rows.append((at[:-1], at[1:], begin + 0.5 * took, took, np.full(count, k)))
        clock += took.sum() + ACCELERATION_TIME + part.dwell
    first, last, time, took, number = (np.concatenate(own) for own in zip(*rows, strict=True))
    return _Cut(first, last, time, took, number.astype(np.int64))


def _pieces(
    machine: Machine,
    part: PlannedPart,
    number: int,
    place: Array,
    config: PlannerConfig,
    judged: ForecastConfig,
) -> AxisPieces:
    """Pieces of a part, or its stops, as a recording would give them."""
    q, sight = part.path.positions, Sight.of_target(machine, part.path.target)
    if part.dwell >= STOP_TIME:
        count, took = len(q), part.dwell
        points, corner = sight.nominal(q), np.arange(count)
        zero, whole = np.zeros_like(q), np.full(count, took)
        return AxisPieces(
            q=q, step=zero, spread=np.zeros(count), xyz=points - place, nominal=points,
            direction=np.zeros((count, 3)), part=np.full(count, number), leg=corner,
            stretch=corner, side=zero, rate=zero, count=np.full(count, int(took * judged.rate)),
            time=2.0 * took * corner.astype(float), duration=whole, standstill=True,
        )  # fmt: skip
    cut = _cut(machine, part, config, CalibrationConfig().piece_length)
    first, last = position_at(q, cut.first), position_at(q, cut.last)
    middle = position_at(q, 0.5 * (cut.first + cut.last))
    along = sight.nominal(last) - sight.nominal(first)
    size = np.linalg.norm(along, axis=1)
    scale = travel_per_unit(machine)
    samples = np.floor(cut.duration * judged.rate).astype(np.int64)
    keep = (size > STILL * np.linalg.norm((last - first) * scale, axis=1)) & (samples > 0)
    own = np.flatnonzero(keep)
    points, step = sight.nominal(middle[own]), (last - first)[own]
    inside = np.concatenate([np.arange(np.sum(cut.stretch[own] == k)) // TOGETHER
                             for k in np.unique(cut.stretch[own])])  # fmt: skip
    leg = np.cumsum(np.append(0, (np.diff(cut.stretch[own]) != 0) | (np.diff(inside) != 0)))
    return AxisPieces(
        q=middle[own], step=step, spread=np.full(len(own), 1.0 / np.sqrt(12.0)),
        xyz=points - place, nominal=points, direction=along[own] / size[own, None],
        part=np.full(len(own), number), leg=leg, stretch=cut.stretch[own],
        side=np.sign(step), rate=step / cut.duration[own, None], count=samples[own],
        time=cut.time[own], duration=cut.duration[own],
    )  # fmt: skip


def duration_of(machine: Machine, part: PlannedPart, config: PlannerConfig) -> float:
    """Driving time of a part, s, dwells included."""
    cut = _cut(machine, part, config, np.inf)
    ends = len(np.unique(cut.stretch)) * (ACCELERATION_TIME + part.dwell)
    return float(cut.duration.sum() + ends)


class Judge:
    """What samples on chains and parts say of the errors of a machine.

    Parameters
    ----------
    parts : sequence of PlannedPart
        All that may be driven: their ranges are those of the tables.
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    """

    def __init__(
        self,
        machine: Machine,
        parts: Sequence[PlannedPart],
        place: Array,
        config: PlannerConfig,
        judged: ForecastConfig,
        noise: NoiseModel | None = None,
    ) -> None:
        self.machine, self.config, self.judged = machine, config, judged
        self.limit = CalibrationConfig().unidentifiable_above
        self.noise = noise or NoiseModel.from_spec(machine.tracker)
        self.driven = _driven(machine, parts)
        self.nodes = table_nodes(machine, *self.driven)
        self.free = tuple(n for n, t in machine.targets.items()
                          if t.u > 0.0 and n in {p.path.target for p in parts})  # fmt: skip
        self.unknowns = layout(machine, smooth_bases(machine, self.nodes), 1, self.free)
        self.places = nominal_places(machine)
        self.pose = RigidTransform(np.eye(3), np.asarray(place, dtype=float))
        self.prior = expected_precision(self.unknowns, self.limit, judged.error_size)
        self.known = place_equations(machine, self.unknowns, self.places)

    def equations(self, part: PlannedPart) -> NormalEquations:
        """Normal equations of the samples of a part."""
        pieces = _pieces(self.machine, part, 0, self.pose.translation, self.config, self.judged)
        measured = (Part(part.path, 0, 0),)
        run = AxisRun(
            self.machine, measured, pieces, self.pose, self.places, self.places, 0, '', self.free
        )
        rows = cast(Any, build_rows(run, self.unknowns, None))
        whitener = Whitener.of(rows, cast(Any, pieces), self.noise)
        return normal_equations(rows, self.unknowns, whitener)

    def solved(self, normal: NormalEquations) -> AxisSolution:
        """Solution whose covariance is that of the forecast."""
        accepted = tuple(n for n, s in self.unknowns.free_blocks.items() if s.stop > s.start)
        solution = solve(normal, self.unknowns, self.limit, accepted, self.prior)
        return AxisSolution(
            self.machine, self.unknowns, solution, cast(Any, None), normal, (), (self.pose,),
            self.places, 0,
        )  # fmt: skip

    def values(self, solved: AxisSolution) -> Array:
        """Scalars and nodes in the gauge of the tables from the full vector, (m, full)."""
        return np.asarray(gauge_matrix(self.machine, self.nodes) @ raw_rows(solved, self.nodes))

    def field(self, count: int) -> Array:
        """Error vectors (3 count, m) over the driven ranges from scalars and nodes."""
        return field_rows(self.machine, self.nodes, evenly_spread(*self.driven, count))


def forecast_parts(
    machine: Machine,
    parts: Sequence[PlannedPart],
    place: Array,
    config: PlannerConfig,
    judged: ForecastConfig,
    noise: NoiseModel | None = None,
) -> RotaryForecast:
    """Forecast what a calibration with these parts will show.

    Parameters
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link.
    """
    judge = Judge(machine, parts, place, config, judged, noise)
    solved = judge.solved(sum((judge.equations(p) for p in parts), judge.known))
    values = judge.values(solved)
    cover = values @ solved.solution.covariance @ values.T
    seen = determined_combinations(solved, values, judge.limit)
    u, hidden = _by_name(machine, judge.nodes, np.sqrt(np.maximum(np.diag(cover), 0.0)), seen)
    field = judge.field(PLACES)
    variance = np.einsum('ij,ij->i', field @ cover, field).reshape(-1, 3).sum(axis=1)
    return RotaryForecast(
        u,
        {n: why_hidden(machine, parts, n) for n in hidden},
        float(np.sqrt(np.maximum(variance, 0.0)).mean()),
        sum(duration_of(machine, p, config) for p in parts),
    )


def _driven(machine: Machine, parts: Sequence[PlannedPart]) -> tuple[Array, Array]:
    q = np.concatenate([p.path.positions for p in parts])
    return q.min(axis=0), q.max(axis=0)


def _by_name(
    machine: Machine, nodes: Mapping[str, Array], u: Array, seen: NDArray[np.bool_]
) -> tuple[dict[str, float], list[str]]:
    """Uncertainty of every error, and those of which most nodes are not determined."""
    by_name, hidden = {}, []
    start = len(machine.scalars)
    for k, name in enumerate(machine.scalars):
        by_name[name] = float(u[k])
        if not seen[k]:
            hidden.append(name)
    for motion in machine.motions:
        own = slice(start, start + len(nodes[motion.axis]))
        start = own.stop
        loose = u[own] > 0.0
        by_name[str(motion)] = float(np.sqrt(np.mean(u[own] ** 2)))
        if not loose.any() or np.mean(seen[own][loose]) <= 0.5:
            hidden.append(str(motion))
    return by_name, hidden


def why_hidden(machine: Machine, parts: Sequence[PlannedPart], name: str) -> str:
    """State by the rank condition why an error will not be seen, and what would show it."""
    axis = name[-1]
    moved = [p for p in parts if axis in _axes_in_view(machine, p) and _travels(machine, p, axis)]
    if not moved:
        return f'no part moves {axis} between tracker and reflector'
    turns = axis in machine.rotary_names
    angular = name[1] == axis or name in machine.location
    if (
        turns
        and angular
        and not any(_combined(machine, p, axis) or p.dwell >= STOP_TIME for p in moved)
    ):
        return (
            f'every leg that turns {axis} moves nothing else: the direction of travel, which is '
            f'left out, is the one in which {name} acts. Drive another axis at the same time, '
            f'in both senses, or stop'
        )
    table = {p.path.target for p in moved if machine.targets[p.path.target].link == TABLE}
    if turns and 0 < len(table) < 3 and machine.tracker.link == BED:
        return f'{len(table)} reflector place(s) on the table; three, not in line with {axis}'
    tools = {p.path.target for p in moved if machine.targets[p.path.target].link == SPINDLE}
    if len(tools) == 1:
        return 'one reflector place on the tool side; a second one of other length or off the axis'
    return 'all reflectors lie on the line about which it turns them'


def _axes_in_view(machine: Machine, part: PlannedPart) -> set[str]:
    """Axes between the tracker and the reflector of a part."""
    return {j.name for j in Sight.of_target(machine, part.path.target).joints}


def _travels(machine: Machine, part: PlannedPart, axis: str) -> bool:
    return bool(np.ptp(part.path.positions[:, machine.column(axis)]) > 0.0)


def _combined(machine: Machine, part: PlannedPart, axis: str) -> bool:
    """Return whether a part turns an axis while another one in view moves."""
    steps = np.abs(np.diff(part.path.positions, axis=0)) > 0.0
    others = [machine.column(a) for a in _axes_in_view(machine, part) if a != axis]
    return bool(np.any(steps[:, machine.column(axis)] & steps[:, others].any(axis=1)))


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
