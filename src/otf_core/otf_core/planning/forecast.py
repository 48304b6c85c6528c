# SPDX-License-Identifier: Apache-2.0
"""What a plan will show before anything moves: rank, uncertainties of motions and on a grid.

The pieces that a recording would give are laid out from geometry and drive times; system of
equations, weights and solution are those of the calibration, only without measured values. The
forecast is therefore right where the noise is, and silent about effects that the model does not
contain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.budget.budget import (
    SYSTEMATIC,
    declared_sources,
    piece_states,
    systematic_sensitivities,
)
from otf_core.budget.typical import missing_keys, typical_runs
from otf_core.config import STANDSTILL, CalibrationConfig, ForecastConfig
from otf_core.diagnosis.engine.residual_rows import Rows, rows_of
from otf_core.errors import ConfigError, OtfError
from otf_core.model.axis_path import position_at, travel_of_legs, travel_per_unit
from otf_core.model.chain import Sight
from otf_core.model.evaluation import covered_grid, evenly_spread
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.model.nodes import table_nodes
from otf_core.model.path import sides_of_travel
from otf_core.model.plan import Part, Plan, Timing
from otf_core.model.presets import TYPICAL
from otf_core.model.sections import DECLARABLE
from otf_core.noise.noise_model import NoiseModel
from otf_core.pieces.pieces import OF_EACH, SPEED_WINDOW, Pieces
from otf_core.pieces.runs import Observed
from otf_core.planning.line_of_sight import default_tracker_place
from otf_core.prediction.calibration_document import Remainder, systematic_fields
from otf_core.prediction.uncertainty import prediction_uncertainty
from otf_core.prediction.volumetric import length_sizes
from otf_core.solving.joint import (
    JointSolution,
    SolvedRun,
    place_equations,
    sum_normal_equations,
    systems_of,
    tables_of,
    unknowns_of,
)
from otf_core.solving.normal import NormalEquations, sum_groups
from otf_core.solving.roughness import Roughness, expected_precision
from otf_core.solving.solution import Solution, determined_by_data, identifiable_blocks, solve
from otf_core.solving.system import build_system
from otf_core.solving.tabulate import by_motion, field_rows, table_rows
from otf_core.solving.unknowns import INTERVALS, Unknowns, smooth_bases
from otf_core.solving.whitener import Whitener
from otf_core.tracking.curves import straight_shape

PIECE_SHARE = 0.25
"""Part of an interval of the splines that a piece may span at most in a forecast."""
TOGETHER = 100
"""Pieces that share slow noise at most."""
BROKEN_BEAM = 4.0
"""s; for which the beam is broken between two parts."""
BATCH = 40
"""Parts whose rows are built together."""
STILL = 1e-4
"""Travel of the reflector per travel of the axes below which nothing is stated across it."""
TURNING_WAVES = 0.05
"""Length of the waves that motions of rotary axes are assumed to have, as a share of the range:
shorter than the usual ones, since machines with kinks at their nodes do not allow more to be taken
from the neighbours of a node (docs/tutorial-five-axes.md, Expected uncertainty)."""


@dataclass(frozen=True)
class Setup:
    """Everything but the plan that decides how well errors will be known.

    Attributes
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the frame of its link; it stands upright, its third axis
        along Z, which matters where its two angles are not equally good.
    """

    machine: Machine
    place: Array
    noise: NoiseModel
    config: ForecastConfig
    calibration: CalibrationConfig

    @classmethod
    def of(
        cls,
        machine: Machine,
        place: Array | None = None,
        noise: NoiseModel | None = None,
        config: ForecastConfig | None = None,
    ) -> Setup:
        """Fill in defaults: usual place of the tracker, noise as specified."""
        return cls(
            machine,
            default_tracker_place(machine) if place is None else np.asarray(place, dtype=float),
            noise or NoiseModel.from_spec(machine.tracker),
            config or ForecastConfig(),
            CalibrationConfig(),
        )

    def at(self, place: Array) -> Setup:
        """Return the same with the tracker elsewhere."""
        return replace(self, place=place)

    @property
    def limit(self) -> float:
        """What is known no better is not identifiable, m and rad."""
        return self.calibration.unidentifiable_above

    def prior(self, unknowns: Unknowns) -> Array:
        """Precision of the free unknowns before any data, see ``roughness.expected_precision``."""
        size = self.config.error_size
        precision = expected_precision(unknowns, self.limit, size)
        if self.machine.rotary_names:
            rough = expected_precision(unknowns, self.limit, size, TURNING_WAVES)
            for name, own in unknowns.free_blocks.items():
                if name[-1] in self.machine.rotary_names:
                    precision[own, own] = rough[own, own]
        return precision

    def seconds(self, part: Part) -> float:
        """Driving time of a part with its dwells, s."""
        return Timing.of(self.machine, part, self.config.acceleration).duration


def driven_nodes(machine: Machine, parts: Sequence[Part]) -> dict[str, Array]:
    """Nodes of the tables over the ranges that parts drive, m and rad."""
    q = np.concatenate([part.path.positions for part in parts])
    return table_nodes(machine, q.min(axis=0), q.max(axis=0))


def planned_runs(
    parts: Sequence[Part],
    setup: Setup,
    nodes: Mapping[str, Array],
    intervals: int = INTERVALS,
    share: float = PIECE_SHARE,
) -> list[Observed]:
    """What a recording of parts would give: pieces of those that are driven, and stops.

    Parameters
    ----------
    intervals : int
        Of the splines of an axis.
    share : float
        Of an interval, that a piece may span at most.
    """
    ranges = [float(np.ptp(nodes[a])) for a in setup.machine.axis_names]
    spans = np.array([share * r / intervals if r else np.inf for r in ranges])
    moving: list[tuple[str, Pieces]] = []
    stopped: list[tuple[str, Pieces]] = []
    start = 0.0
    for part in parts:
        own = _stops(part, setup) if part.stops else _pieces(part, setup, spans)
        own = replace(own, time=start + own.time)
        (stopped if part.stops else moving).append((part.target, own))
        start += setup.seconds(part) + BROKEN_BEAM
    known = {n: np.array(t.place) for n, t in setup.machine.targets.items()}
    runs: list[Observed] = []
    for group in (moving, stopped):
        if group:
            targets = tuple(target for target, _ in group)
            places = {n: known[n] for n in targets}
            plain = len(parts) == 1 and parts[0].path.is_plain and len(spans) == len(AXES)
            runs.append(Observed(
                machine=setup.machine, pieces=_joined([own for _, own in group], start),
                pose=tracker_pose(setup), noise=setup.noise, targets=targets, places=places,
                base=places, same_station=bool(runs),
                shape=straight_shape(parts[0].path.points) if plain else None,
            ))  # fmt: skip
    return runs


def _joined(group: Sequence[Pieces], end: float) -> Pieces:
    """Pieces of several parts as those of one run."""
    content: dict[str, Any] = {
        name: np.concatenate([getattr(own, name) for own in group]) for name in OF_EACH
    }
    sizes = [len(own) for own in group]
    content['part'] = np.repeat(np.arange(len(group)), sizes)
    for name in ('leg', 'stretch'):
        last = [int(getattr(own, name).max(initial=-1)) + 1 for own in group[:-1]]
        content[name] = content[name] + np.repeat(np.cumsum([0, *last]), sizes)
    used = int(content['count'].sum())
    return Pieces(**content, used=used, end=end, method=group[0].method,
                  samples=np.arange(used, dtype=np.int32),
                  piece=np.repeat(np.arange(sum(sizes), dtype=np.int32), content['count']),
                  )  # fmt: skip


def _pieces(part: Part, setup: Setup, spans: Array) -> Pieces:
    """Pieces of equal way on every stretch of a part, with times and samples as it is driven."""
    machine, config, q = setup.machine, setup.config, part.path.positions
    timing, sight = (
        Timing.of(machine, part, config.acceleration),
        Sight.of_target(machine, part.target),
    )
    steps, edges, number = np.diff(q, axis=0), [], []
    reach = np.append(0.0, travel_of_legs(machine, q).cumsum())
    corners = np.arange(len(q), dtype=float)
    for k in range(len(timing.size)):
        own = np.flatnonzero(timing.stretch == k)
        low, size = reach[own[0]], reach[own[-1] + 1] - reach[own[0]]
        travel = np.abs(steps[own]).sum(axis=0)
        parts = min(float(np.max(travel / spans)), size / setup.calibration.piece_length)
        margin = min(setup.calibration.corner_exclusion, 0.25 * size)
        marks = np.linspace(0.0, size, max(1, int(np.ceil(parts - 1e-9))) + 1)
        edges.append(np.interp(low + np.clip(marks, margin, size - margin), reach, corners))
        number.append(np.full(len(marks), k))
    corner, stretch = np.concatenate(edges), np.concatenate(number)
    way = np.interp(corner, corners, timing.reach)
    window = timing.start[stretch] + np.minimum(SPEED_WINDOW, 0.5 * timing.moving[stretch])
    ends = timing.start[stretch] + timing.moving[stretch] - SPEED_WINDOW
    moment = np.minimum(np.maximum(timing.at(way, stretch), window), np.maximum(ends, window))
    count = np.diff(np.floor(moment * config.rate)).astype(np.int64)
    first, last = position_at(q, corner[:-1]), position_at(q, corner[1:])
    along = sight.nominal(last) - sight.nominal(first)
    size, step = np.linalg.norm(along, axis=1), last - first
    travelled = np.linalg.norm(step * travel_per_unit(machine), axis=1)
    keep = (np.diff(stretch) == 0) & (count > 0) & (size > STILL * travelled)
    own = np.flatnonzero(keep)
    stretch, middle = stretch[own], 0.5 * (corner[own] + corner[own + 1])
    at = position_at(q, middle)
    points, seconds = sight.nominal(at), count[own] / config.rate
    full = np.diff(way)[own] / timing.peak[stretch]
    inside = np.arange(len(own)) - np.searchsorted(stretch, stretch)
    begins = np.append(True, (np.diff(stretch) != 0) | (inside[1:] % TOGETHER == 0))
    legs = np.minimum(middle.astype(np.int64), len(steps) - 1)
    return Pieces(
        q=at, step=step[own], spread=np.full(len(own), 1.0 / np.sqrt(12.0)),
        xyz=points - setup.place, nominal=points, direction=along[own] / size[own, None],
        origin=points, part=np.zeros_like(own), leg=np.cumsum(begins) - 1, stretch=stretch,
        side=sides_of_travel(np.sign(steps))[legs], rate=step[own] / full[:, None],
        speed=size[own] / full, count=count[own],
        time=0.5 * (moment[own] + moment[own + 1]), duration=seconds,
    )  # fmt: skip


def _stops(part: Part, setup: Setup) -> Pieces:
    """Stops at the corners of a part."""
    q, took = part.path.positions, np.minimum(part.dwell, part.dwell[1])
    points, corner = Sight.of_target(setup.machine, part.target).nominal(q), np.arange(len(q))
    zero, still = np.zeros_like(q), np.zeros(len(q))
    return Pieces(
        q=q, step=zero, spread=still, xyz=points - setup.place, nominal=points,
        direction=np.zeros((len(q), 3)), origin=points, part=np.zeros_like(corner), leg=corner,
        stretch=corner, side=zero, rate=zero, speed=still,
        count=(took * setup.config.rate).astype(np.int64),
        time=np.cumsum(2.0 * took), duration=took, method=STANDSTILL,
    )  # fmt: skip


def tracker_pose(setup: Setup) -> RigidTransform:
    """Pose of a tracker that stands at the place, its frame parallel to that of its link."""
    return RigidTransform(np.eye(3), setup.place)


class Judge:
    """What samples on parts say of the errors of a machine, while a plan is chosen.

    Splines are coarse and pieces long.

    Parameters
    ----------
    parts : sequence of Part
        All that may be driven: their ranges are those of the tables.
    """

    def __init__(self, setup: Setup, parts: Sequence[Part], intervals: int) -> None:
        self.setup, self.intervals = setup, intervals
        self.nodes = driven_nodes(_coarser(setup.machine, intervals), parts)
        runs = planned_runs(parts, setup, self.nodes, intervals)
        self.unknowns = unknowns_of(runs, smooth_bases(setup.machine, self.nodes, intervals))
        self.prior = setup.prior(self.unknowns)
        places = {n: np.array(t.place) for n, t in setup.machine.targets.items()}
        self.known = place_equations(setup.machine, self.unknowns, places)

    @property
    def names(self) -> set[str]:
        """Squareness, location errors and motions."""
        return {*self.setup.machine.scalars, *map(str, self.setup.machine.motions)}

    def visible(self, part: Part) -> tuple[str, ...]:
        """Blocks of unknowns that a part shows."""
        (normal,) = self.equations([part], nodal=True)
        return identifiable_blocks(normal, self.unknowns, self.setup.limit)

    def equations(self, parts: Sequence[Part], *, nodal: bool = False) -> list[NormalEquations]:
        """Normal equations of the samples of every part."""
        setup, sums = self.setup, list[NormalEquations]()
        for _, group in groupby(parts, key=lambda part: part.stops):
            own = list(group)
            for first in range(0, len(own), BATCH):
                some = own[first : first + BATCH]
                (run,) = planned_runs(some, setup, self.nodes, self.intervals)
                system = build_system(run, self.unknowns, nodal_lever=nodal)
                whitener = Whitener.of(system, run.pieces, setup.noise)
                number = run.pieces.part[[low for low, _ in whitener.bounds]]
                sums += sum_groups(system, self.unknowns, whitener, number, groups=len(some))
        return sums

    @cached_property
    def errors(self) -> Array:
        """All errors at their nodes from the free unknowns, (m, free)."""
        rows = table_rows(self.setup.machine, self.unknowns, self.nodes)
        return np.asarray(rows @ self.unknowns.gauge)

    def field(self, count: int) -> Array:
        """Error vectors on the grid from the free unknowns, rigid motion removed, (3 n, free)."""
        machine = self.setup.machine
        return field_rows(machine, self.nodes, grid_of(machine, self.nodes, count)) @ self.errors


def _coarser(machine: Machine, intervals: int) -> Machine:
    """A machine with so many intervals between the nodes of an axis at most."""
    axes = {
        name: replace(own, table_pitch=max(own.table_pitch, (own.max - own.min) / intervals))
        for name, own in machine.axes.items()
    }
    return replace(machine, axes=axes)


def grid_of(machine: Machine, nodes: Mapping[str, Array], count: int) -> Array:
    """Axis positions (n, k) at which errors are judged, over the driven ranges.

    A lattice of ``count`` per axis; with more than three axes positions that fill them evenly.
    """
    ends = np.array([nodes[a][[0, -1]] for a in machine.axis_names]).T
    return covered_grid(machine, ends, count) if len(nodes) <= 3 else evenly_spread(*ends)


@dataclass(frozen=True)
class Forecast:
    """What a plan will show.

    Attributes
    ----------
    joint : JointSolution
        Its values are zero; covariance and accepted blocks count.
    nodes : mapping of axis to ndarray, m and rad
        Of the tables.
    determined : mapping of error to ndarray of bool
        Nodes, or the one value of a scalar, that the data determine without what is expected of
        the motions; of an error that is not identifiable none.
    nodal : NormalEquations
        Of the pieces, in the form that tells what is identifiable (``nodal_lever``).
    u : mapping of error to ndarray, m or rad
        Standard uncertainty of every node; zero where not identifiable.
    covariance : ndarray, shape (m, m)
        In the order of ``uncertainty.prediction_rows``.
    grid : ndarray, shape (n, k), m and rad
        Axis positions that are judged, over the ranges that the plan covers.
    grid_u, grid_u_free : ndarray, shape (n, 3), m
        Standard uncertainty there, in the gauge of the tables, and with the best rigid motion of
        the whole grid taken out: free of the choice of gauge.
    duration : float
        s, accelerations and dwells included, moves by hand not.
    """

    joint: JointSolution
    nodes: dict[str, Array]
    determined: dict[str, NDArray[np.bool_]]
    nodal: NormalEquations
    u: dict[str, Array]
    covariance: Array
    grid: Array
    grid_u: Array
    grid_u_free: Array
    duration: float

    @property
    def runs(self) -> list[Observed]:
        """What a recording would give."""
        return [solved.run for solved in self.joint.runs]

    @property
    def unknowns(self) -> Unknowns:
        """Layout of the unknowns."""
        return self.joint.unknowns

    @property
    def accepted(self) -> tuple[str, ...]:
        """Blocks of unknowns that the data show."""
        return self.joint.solution.accepted

    @property
    def mean_grid_u(self) -> float:
        """Mean over the grid of the standard uncertainty of the error vector, m."""
        return float(np.linalg.norm(self.grid_u_free, axis=1).mean())

    @cached_property
    def not_identifiable(self) -> tuple[str, ...]:
        """Squareness, location errors and motions that will not be seen."""
        return tuple(n for n, own in self.determined.items() if not self._known(str(n), own))

    def _known(self, name: str, own: NDArray[np.bool_]) -> bool:
        return name in self.accepted and bool(own[self.u[name] > 0.0].any())

    @property
    def loose_nodes(self) -> dict[str, Array]:
        """Nodes of seen motions that are interpolated only: motion to positions, m and rad."""
        return {
            name: self.nodes[name[-1]][~own]
            for name, own in self.determined.items()
            if name not in self.not_identifiable and not own.all()
        }


def forecast(plan: Plan, setup: Setup) -> Forecast:
    """Forecast what a calibration with this plan will show."""
    plan = plan.of(setup.machine)
    nodes = driven_nodes(setup.machine, plan.parts)
    duration = sum(setup.seconds(part) for part in plan.parts)
    return forecast_of_runs(planned_runs(plan.parts, setup, nodes), nodes, setup, duration)


def forecast_of_runs(
    runs: Sequence[Observed], nodes: dict[str, Array], setup: Setup, duration: float
) -> Forecast:
    """What pieces show, whatever was measured at them: of a plan, or of a recording.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m and rad
        Of the tables.
    duration : float
        s.
    """
    machine, limit = setup.machine, setup.limit
    unknowns = unknowns_of(runs, smooth_bases(machine, nodes))
    systems = systems_of(runs, unknowns, None)
    whiteners = [Whitener.of(s, r.pieces, r.noise) for s, r in zip(systems, runs, strict=True)]
    places = {n: np.array(t.place) for n, t in machine.targets.items()}
    known = place_equations(machine, unknowns, places)
    judged = [build_system(run, unknowns, nodal_lever=True) for run in runs]
    nodal = sum_normal_equations(judged, unknowns, whiteners) + known
    accepted = identifiable_blocks(nodal, unknowns, limit)
    normal = sum_normal_equations(systems, unknowns, whiteners) + known
    solution = solve(normal, unknowns, limit, accepted, setup.prior(unknowns))
    nothing = Roughness({}, np.zeros((unknowns.free,) * 2), np.zeros((0, 0)), 0.0, 0.0)
    solved = tuple(
        SolvedRun(run, system, whitener, np.zeros_like(system.deviation))
        for run, system, whitener in zip(runs, systems, whiteners, strict=True)
    )
    joint = JointSolution(unknowns, solution, nothing, normal, solved, 1)
    hidden = [m for m in machine.motions if m not in accepted]
    rows = table_rows(machine, unknowns, nodes, hidden)
    covariance = rows @ solution.covariance @ rows.T
    seen = determined_by_data(normal, unknowns, accepted, limit, rows)
    names = np.array([*machine.scalars, *(m for m in machine.motions for _ in nodes[m.axis])])
    seen &= np.isin(names, accepted)
    u = by_error(machine, np.sqrt(np.maximum(np.diag(covariance), 0.0)), nodes)
    grid = grid_of(machine, nodes, setup.config.grid)
    own = {str(m): nodes[m.axis] for m in machine.motions}
    return Forecast(
        joint=joint, nodes=nodes, determined=by_error(machine, seen, nodes), nodal=nodal, u=u,
        covariance=covariance, grid=grid,
        grid_u=prediction_uncertainty(machine, own, covariance, grid),
        grid_u_free=free_uncertainty(machine, nodes, covariance, grid), duration=duration,
    )  # fmt: skip


def by_error(machine: Machine, values: NDArray[Any], nodes: Mapping[str, Array]) -> dict[str, Any]:
    """Values (m,) in the order of the tables: one of every scalar, those of the nodes."""
    scalars = {n: values[k : k + 1] for k, n in enumerate(machine.scalars)}
    return scalars | {str(m): own for m, own in by_motion(machine, values, nodes).items()}


def free_uncertainty(
    machine: Machine, nodes: Mapping[str, Array], covariance: Array, grid: Array
) -> Array:
    """Standard uncertainty of error vectors on a grid, rigid motion removed, (n, 3), m."""
    rows = field_rows(machine, nodes, grid)
    variance = np.einsum('ij,ij->i', rows @ covariance, rows)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3))


# Systematic contributions in the forecast of a plan: declared ones, and typical ones beside.
#
# The sensitivities are those of the budget, for the pieces that the plan would give.


@dataclass(frozen=True)
class PlannedSystematic:
    """Mean uncertainty of the grid vector, rigid motion removed, by what it contains.

    Attributes
    ----------
    declared, missing : tuple of str
        Contributions as the budget calls them; ``missing``: at least one key is not declared.
    noise, with_declared, with_typical : float
        m, k = 1: of the noise alone; with the declared contributions; with typical values for
        the missing keys too.
    expected : Remainder
        With all of them: what a calibration would state first.
    """

    declared: tuple[str, ...]
    missing: tuple[str, ...]
    noise: float
    with_declared: float
    with_typical: float
    expected: Remainder

    def to_dict(self) -> dict[str, Any]:
        """Entry of plan.json."""
        return {
            'declared': list(self.declared),
            'missing': list(self.missing),
            'typical': list(TYPICAL),
            'mean_grid_u_noise': self.noise,
            'mean_grid_u_with_declared': self.with_declared,
            'mean_grid_u_with_typical': self.with_typical,
            **self.expected.to_dict(),
        }


def planned_systematic(forecast: Forecast) -> PlannedSystematic:
    """Forecast the grid with declared contributions, and with typical ones for the others."""
    joint, runs = forecast.joint, forecast.runs
    machine, tables = joint.machine, tables_of(joint.machine, joint.unknowns, joint.solution)
    hidden = [m for m in machine.motions if m not in forecast.accepted]
    rows = table_rows(machine, joint.unknowns, forecast.nodes, hidden)

    def added(sources: Sequence[Any], runs: Sequence[Observed]) -> Array:
        total = np.zeros_like(forecast.covariance)
        states = piece_states(runs, joint, tables) if sources else []
        for free in systematic_sensitivities(sources, states, joint):
            change = rows @ free
            total += change @ change.T
        return total

    def lengths(covariance: Array) -> Array:
        free = free_uncertainty(machine, forecast.nodes, covariance, forecast.grid)
        return np.asarray(np.linalg.norm(free, axis=1))

    keys = missing_keys(runs)
    missing = [s for s in SYSTEMATIC if set(s.keys) & set(keys)]
    declared = declared_sources(runs)
    own = forecast.covariance + added(declared, runs)
    noise = np.linalg.norm(forecast.grid_u_free, axis=1)
    stated = lengths(own) if declared else noise
    whole = lengths(own + added(missing, typical_runs(runs, keys))) if missing else stated
    assumed = tuple(s.source for s in missing)
    expected = Remainder(
        u=length_sizes(whole),
        u_run=length_sizes(noise),
        k=COVERAGE_FACTOR,
        **systematic_fields(assumed, len(keys) == len(DECLARABLE)),
    )
    return PlannedSystematic(
        tuple(s.source for s in declared), assumed, forecast.mean_grid_u,
        float(stated.mean()), float(whole.mean()), expected,
    )  # fmt: skip


# Runs that were measured already, beside a planned one: rows of all of them together.


@dataclass(frozen=True)
class MeasuredRun:
    """A run that was measured.

    Attributes
    ----------
    plan : Plan
        As it was driven.
    place : ndarray, shape (3,), m
        Of the tracker.
    """

    plan: Plan
    place: Array

    @classmethod
    def of(cls, data: Mapping[str, Any], where: str) -> MeasuredRun:
        """Read an entry of gap.json; ConfigError if it is none."""
        try:
            place = np.array(data['tracker_place'], dtype=float)
            plan = Plan.along(data['path'], data['feed'], np.zeros(len(data['path'])))
            if place.shape != (3,) or not np.all(np.isfinite(place)):
                raise ValueError('tracker_place')
        except (KeyError, TypeError, ValueError, OtfError) as error:
            raise ConfigError(f'{where}: measured: cannot be read ({error})') from None
        return cls(plan, place)

    def observed(self, setup: Setup) -> Observed:
        """What the run shows, by its path alone."""
        nodes = driven_nodes(setup.machine, self.plan.parts)
        return planned_runs(self.plan.parts, setup.at(self.place), nodes)[0]


def joint_rows(forecast: Forecast, before: Sequence[Observed], limit: float) -> Rows:
    """Rows of a planned run and of those before it, with zero deviations and common tables."""
    runs = [*forecast.runs, *before]
    unknowns = unknowns_of(runs, forecast.unknowns.bases)
    systems = systems_of(runs, unknowns, None)
    solved = tuple(
        SolvedRun(run, s, Whitener.of(s, run.pieces, run.noise), np.zeros_like(s.deviation))
        for run, s in zip(runs, systems, strict=True)
    )
    nothing = np.zeros(unknowns.full)
    covariance = np.outer(nothing, nothing)
    solution = Solution(nothing, covariance, forecast.accepted, 0, np.zeros((0, 0)))
    joint = replace(forecast.joint, unknowns=unknowns, solution=solution, runs=solved)
    return rows_of(runs, joint, limit)
