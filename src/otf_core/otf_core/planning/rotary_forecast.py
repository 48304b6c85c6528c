# SPDX-License-Identifier: Apache-2.0
"""What chains and parts of a machine with rotary axes will show, and why they do not show it.

The rows of a recording that is not made yet: pieces of equal travel with times and samples as they
will be driven, noise as stated, motions of a usual smoothness before any data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig, ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.errors import ConfigError
from otf_core.model.axis_path import (
    Stretches,
    driven_through,
    position_at,
    seconds_of_legs,
    travel_of_legs,
    travel_per_unit,
)
from otf_core.model.evaluation import PLACES, evenly_spread
from otf_core.model.frames import RigidTransform
from otf_core.model.joints import Sight
from otf_core.model.machine import BED, TABLE, Machine
from otf_core.model.nodes import table_nodes
from otf_core.noise.noise_model import NoiseModel
from otf_core.planning.rotary_paths import PlannedPart, courses, creeps
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

WAVES = 0.05
"""Length of the waves that motions are assumed to have, as a share of the range: shorter than the
usual ones, since machines with kinks at their nodes do not allow more to be taken from the
neighbours of a node (docs/five-axes.md, Expected uncertainty)."""
STILL = 1e-4
"""Travel of the reflector per travel of the axes below which nothing is stated across it."""


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


@dataclass(frozen=True)
class _Cut:
    """Pieces of one part: places on its path and times."""

    first: Array
    last: Array
    time: Array
    duration: Array
    stretch: Index


def _cut(machine: Machine, part: PlannedPart, config: PlannerConfig, piece: float) -> _Cut:
    """Cut a part into pieces of equal travel, with times at the speed of each leg."""
    q = part.path.positions
    length = travel_of_legs(machine, q)
    stretch = np.cumsum(np.append(True, ~driven_through(machine, q))) - 1
    seconds = np.append(0.0, seconds_of_legs(machine, q, config.feed).cumsum())
    reach, corner = np.append(0.0, length.cumsum()), np.arange(len(q), dtype=float)
    rows, halts = [], 0.0
    lost = config.feed / SimulationConfig.acceleration + part.halt(config)
    for k in range(stretch[-1] + 1):
        own = np.flatnonzero(stretch == k)
        low, high = reach[own[0]], reach[own[-1] + 1]
        count = max(1, int(np.ceil((high - low) / piece)))
        at = np.interp(np.linspace(low, high, count + 1), reach, corner)
        clock = halts + np.interp(at, corner, seconds)
        took = np.diff(clock)
        rows.append((at[:-1], at[1:], clock[:-1] + 0.5 * took, took, np.full(count, k)))
        halts += lost
    first, last, time, took, number = (np.concatenate(own) for own in zip(*rows, strict=True))
    return _Cut(first, last, time, took, number.astype(np.int64))


def _pieces(
    machine: Machine,
    part: PlannedPart,
    number: int,
    place: Array,
    config: PlannerConfig,
    judged: ForecastConfig,
    piece: float,
) -> AxisPieces:
    """Pieces of a part, or its stops, as a recording would give them."""
    q, sight = part.path.positions, Sight.of_target(machine, part.path.target)
    if part.stops:
        count, took = len(q), part.dwell
        points, corner = sight.nominal(q), np.arange(count)
        zero, whole = np.zeros_like(q), np.full(count, took)
        return AxisPieces(
            q=q, step=zero, spread=np.zeros(count), xyz=points - place, nominal=points,
            direction=np.zeros((count, 3)), part=np.full(count, number), leg=corner,
            stretch=corner, side=zero, rate=zero, count=np.full(count, int(took * judged.rate)),
            time=2.0 * took * corner.astype(float), duration=whole, standstill=True,
        )  # fmt: skip
    cut = _cut(machine, part, config, piece)
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
    moving = _stretches(machine, part, config).moving
    at_corners = (len(moving) - 1) * part.halt(config)
    return float(moving.sum()) + at_corners + 2.0 * config.end_dwell


def _stretches(machine: Machine, part: PlannedPart, config: PlannerConfig) -> Stretches:
    return Stretches.of(
        machine, part.path.positions, config.feed, SimulationConfig.acceleration,
        stops=part.stops,
    )  # fmt: skip


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
        piece: float = CalibrationConfig.piece_length,
    ) -> None:
        self.machine, self.config, self.judged, self.piece = machine, config, judged, piece
        self.limit = CalibrationConfig().unidentifiable_above
        self.noise = noise or NoiseModel.from_spec(machine.tracker)
        self.driven = _driven(machine, parts)
        self.nodes = table_nodes(machine, *self.driven)
        self.free = tuple(n for n, t in machine.targets.items()
                          if t.u > 0.0 and n in {p.path.target for p in parts})  # fmt: skip
        self.unknowns = layout(machine, smooth_bases(machine, self.nodes), 1, self.free)
        self.places = nominal_places(machine)
        self.pose = RigidTransform(np.eye(3), np.asarray(place, dtype=float))
        self.prior = expected_precision(self.unknowns, self.limit, judged.error_size, WAVES)
        self.known = place_equations(machine, self.unknowns, self.places)

    def equations(self, part: PlannedPart) -> NormalEquations:
        """Normal equations of the samples of a part."""
        pieces = _pieces(
            self.machine, part, 0, self.pose.translation, self.config, self.judged, self.piece
        )
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
    on_table = [n for n, t in machine.targets.items() if t.link == TABLE]
    bed = machine.tracker.link == BED
    moved = [p for p in parts if axis in _axes_in_view(machine, p) and _travels(machine, p, axis)]
    if not moved:
        words = f'no part moves {axis} between tracker and reflector'
        if bed and axis in machine.chain.table_side and not on_table:
            words += '; state three targets on the table (link: w) in machine.yaml'
        return words
    turns = axis in machine.rotary_names
    angular = name[1] == axis or name in machine.location
    if turns and angular and not any(_combined(machine, p, axis) or p.stops for p in moved):
        return (
            f'every leg that turns {axis} moves nothing else: the direction of travel, which is '
            f'left out, is the one in which {name} acts. Drive another axis at the same time, '
            f'in both senses, or stop'
        )
    if name[1] in 'ABC' and name not in machine.scalars and _lever(machine, moved, name) < STILL:
        return 'all reflectors lie on the line about which it turns them'
    table = {p.path.target for p in moved if p.path.target in on_table}
    if turns and 0 < len(table) < 3 and bed:
        return f'{len(table)} reflector place(s) on the table; three, not in line with {axis}'
    if turns and not table:
        try:
            creeps(machine, {axis: courses(machine, axis)}, moved[0].path.target)
        except ConfigError as error:
            return f'the linear axes do not follow the rotation: {error}'
    tools = {p.path.target for p in moved} - set(on_table)
    if len(tools) == 1:
        return 'one reflector place on the tool side; a second one of other length or off the axis'
    return (
        f'the reflectors and moves of {axis} say too little of it: a reflector farther off the '
        f'axis, longer travel, or more time'
    )


def _lever(machine: Machine, parts: Sequence[PlannedPart], name: str) -> float:
    """Most that a reflector moves per unit of a motion, m/rad."""
    most = 0.0
    for part in parts:
        seen = Sight.of_target(machine, part.path.target).at(part.path.positions)
        six = seen.motions[name[-1]][:, :, 'XYZABC'.index(name[1])]
        most = max(most, float(np.abs(six).max()))
    return most


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
