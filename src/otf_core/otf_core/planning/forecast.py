# SPDX-License-Identifier: Apache-2.0
"""What a plan will show before anything moves: rank, uncertainties of motions and on a grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from otf_core.calibration.calibration_result import ExpectedRemainder
from otf_core.config import CalibrationConfig, ForecastConfig
from otf_core.diagnosis.engine.residual_rows import Rows, rows_of
from otf_core.errors import ConfigError, OtfError
from otf_core.model.declared import KEYS
from otf_core.model.evaluation import covered_grid, free_rows
from otf_core.model.expanded import COVERAGE_FACTOR
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS, SQUARENESS, ErrorMotion
from otf_core.model.nodes import table_nodes
from otf_core.model.path import MIN_LEG, NominalPath, sides_of_travel
from otf_core.model.plan import Plan
from otf_core.model.presets import TYPICAL
from otf_core.model.tables import ErrorTables
from otf_core.noise.noise_model import NoiseModel
from otf_core.pieces.pieces import SPEED_WINDOW, Pieces, piece_boundaries
from otf_core.pieces.runs import Observed
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.prediction.volumetric import length_sizes
from otf_core.solving.joint import JointSolution, SolvedRun, tables_of
from otf_core.solving.model_choice import smooth_bases
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.roughness import Roughness, expected_precision
from otf_core.solving.solution import Solution, determined_by_data, identifiable_blocks, solve
from otf_core.solving.system import build_system
from otf_core.solving.tabulate import by_motion, table_rows
from otf_core.solving.unknowns import Unknowns, layout
from otf_core.solving.whitener import Whitener
from otf_core.tracking.curves import straight_shape

# When the machine is where on a plan: trapezoidal speed, exact stop and dwell at every corner.
#
# t(s) on a leg of length L with peak speed v and acceleration a: sqrt(2 s / a) while speeding up,
# s / v + v / (2 a) at constant speed, mirrored while slowing down; v = min(feed, sqrt(a L)).


@dataclass(frozen=True)
class DriveTimes:
    """Timing of every leg.

    Attributes
    ----------
    length, peak, moving : ndarray, shape (n,), m, m/s, s
        Length, highest speed and driving time of each leg.
    start : ndarray, shape (n,), s
        Departure, counted from the start of the first dwell.
    acceleration : float
        m/s^2.
    duration : float
        s, all dwells included.
    """

    length: Array
    peak: Array
    moving: Array
    start: Array
    acceleration: float
    duration: float

    def at(self, leg: int, along: Array) -> Array:
        """Time since departure at positions along a leg.

        Parameters
        ----------
        along : ndarray, shape (k,), m
            From the start of the leg.

        Returns
        -------
        ndarray, shape (k,), s
        """
        peak, a = self.peak[leg], self.acceleration
        ramp = 0.5 * peak**2 / a
        remainder = self.length[leg] - along
        return np.asarray(
            np.select(
                [along < ramp, remainder < ramp],
                [
                    np.sqrt(2 * np.maximum(along, 0.0) / a),
                    self.moving[leg] - np.sqrt(2 * np.maximum(remainder, 0.0) / a),
                ],
                along / peak + 0.5 * peak / a,
            )
        )


def leg_time(length: Array, feed: Array, acceleration: float) -> tuple[Array, Array]:
    """Highest speed (m/s) and driving time (s) of legs that start and end at standstill."""
    peak = np.minimum(feed, np.sqrt(length * acceleration))
    moving = np.divide(length, peak, out=np.zeros_like(length), where=peak > 0)
    return peak, moving + peak / acceleration


def drive_times(plan: Plan, acceleration: float) -> DriveTimes:
    """Time every leg of a plan.

    Parameters
    ----------
    acceleration : float
        m/s^2, along the path.
    """
    length = plan.path.leg_lengths
    peak, moving = leg_time(length, plan.feed, acceleration)
    start = np.cumsum(plan.dwell[:-1] + np.concatenate([[0.0], moving[:-1]]))
    duration = float(start[-1] + moving[-1] + plan.dwell[-1])
    return DriveTimes(length, peak, moving, start, acceleration, duration)


# What a plan will show, before anything moves: rank, uncertainties of motions and on a grid.
#
# The path pieces that a recording would give are laid out from geometry and drive times; system of
# equations, weights and solution are those of the calibration, only without measured values. The
# forecast is therefore right where the noise is, and silent about effects that the model does not
# contain.

Cut = Callable[[Array], Array]
"""Boundaries of the pieces of a line, m from its start, for its two ends (2, 3), m."""

PIECE_SHARE = 0.25
"""Part of an interval of the splines that a piece may span in a forecast at most."""
MAX_PIECE_RATIO = 2.0
"""Times as many pieces as that makes, in a recording, from which on they are not all laid out."""
PLACE_DISTANCE = 0.3
"""m; distance of the default place of the tracker from the working volume."""


@dataclass(frozen=True)
class Setup:
    """Everything but the plan that decides how well errors will be known.

    Attributes
    ----------
    place : ndarray, shape (3,), m
        Beam origin of the tracker in the machine frame; it stands upright, its third axis along
        Z, which matters where its two angles are not equally good.
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
        """Fill in defaults: tracker beside the volume, noise as specified."""
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


@dataclass(frozen=True)
class Forecast:
    """What a plan will show.

    Attributes
    ----------
    solution : Solution
        Its values are zero; covariance and accepted blocks count.
    nodes : mapping of axis to ndarray, m
        Of the tables.
    determined : mapping of motion to ndarray of bool
        Nodes that the data determine without what is expected of the motions.
    normal : NormalEquations
        Of the pieces, in the form that tells what is identifiable (``nodal_lever``).
    u : mapping of motion or squareness name to ndarray, m or rad
        Standard uncertainty of every node; zero where not identifiable.
    covariance : ndarray, shape (m, m)
        In the order of ``uncertainty.prediction_rows``.
    grid : ndarray, shape (n, 3), m
        Points that are judged, over the part of the axis ranges that the plan covers.
    grid_u : ndarray, shape (n, 3), m
        Standard uncertainty there, in the gauge of the tables.
    grid_u_free : ndarray, shape (n, 3), m
        The same with the best rigid motion of the whole grid taken out, as for the grid errors
        of ``evaluation``: free of the choice of gauge.
    duration : float
        s, accelerations and dwells included.
    """

    unknowns: Unknowns
    solution: Solution
    nodes: dict[str, Array]
    determined: dict[str, NDArray[np.bool_]]
    normal: NormalEquations
    u: dict[str, Array]
    covariance: Array
    grid: Array
    grid_u: Array
    grid_u_free: Array
    pieces: Pieces
    duration: float

    @property
    def mean_grid_u(self) -> float:
        """Mean over the grid of the standard uncertainty of the error vector, m."""
        return float(np.linalg.norm(self.grid_u_free, axis=1).mean())

    @property
    def not_identifiable(self) -> tuple[str, ...]:
        """Squareness errors and motions that will not be seen."""
        return tuple(n for n in (*SQUARENESS, *MOTIONS) if n not in self.solution.accepted)

    def seen_at(self, name: str) -> NDArray[np.bool_]:
        """Nodes of a motion, or the one value of a squareness error, that the data determine."""
        if name not in self.solution.accepted:
            return np.zeros_like(self.u[name], dtype=bool)
        return self.determined.get(name, np.ones(1, dtype=bool))

    @property
    def loose_nodes(self) -> dict[ErrorMotion, Array]:
        """Nodes of seen motions that are interpolated only: motion to positions, m."""
        loose_by_motion = {}
        for motion in MOTIONS:
            if motion in self.solution.accepted:
                loose = ~self.determined[motion]
                if loose.any():
                    loose_by_motion[motion] = self.nodes[motion.axis][loose]
        return loose_by_motion


def default_tracker_place(machine: Machine) -> Array:
    """Default place of the tracker: in front of the volume (-Y), at half height."""
    place = 0.5 * (machine.lower + machine.upper)
    place[1] = machine.lower[1] - PLACE_DISTANCE
    return np.asarray(place)


def equal_pieces(knots: Mapping[str, Array], part: float, shortest: float) -> Cut:
    """Cut lines into equal pieces, for splines over equally spaced knots.

    Parameters
    ----------
    knots : mapping of axis to ndarray, m
        In the order of the components of positions.
    part : float
        Of an interval between knots, that no piece is longer than.
    shortest : float
        m; no piece needs to be shorter.
    """

    def cut(ends: Array) -> Array:
        step = ends[1] - ends[0]
        length = float(np.linalg.norm(step))
        axes = zip(step, knots.values(), strict=True)
        spans = [abs(along) / (part * (at[1] - at[0])) for along, at in axes if len(at) > 1]
        parts = min(max(spans), length / shortest)
        return np.linspace(0.0, length, max(1, int(np.ceil(parts - 1e-9))) + 1)

    return cut


def needed_pieces(recorded: Cut, equal: Cut) -> Cut:
    """Pieces of a recording, or equal ones if their number exceeds ``MAX_PIECE_RATIO``."""

    def cut(ends: Array) -> Array:
        own, enough = recorded(ends), equal(ends)
        return own if len(own) - 1 < MAX_PIECE_RATIO * (len(enough) - 1) else enough

    return cut


def recorded_pieces(nodes: Mapping[str, Array], setup: Setup) -> Cut:
    """Cut lines into the pieces that a recording is reduced to, for these table nodes, m."""
    tables, size = (
        tuple(nodes[a] for a in setup.machine.axis_names),
        setup.calibration.piece_length,
    )
    return lambda ends: piece_boundaries(ends, 0, tables, size)


def _leg_pieces(
    times: DriveTimes, marks: Array, leg: int, setup: Setup
) -> tuple[Array, Array, Array, NDArray[np.int64], Array]:
    """Middle (m), mean time, duration (s), samples and length (m) of the pieces of one leg."""
    length, rate = times.length[leg], setup.config.rate
    margin = min(setup.calibration.corner_exclusion, 0.25 * length)
    start, end = times.at(leg, np.array([margin, length - margin]))
    moment = np.clip(times.at(leg, marks), max(start, SPEED_WINDOW), None)
    moment = np.minimum(moment, min(end, times.moving[leg] - SPEED_WINDOW))
    moment += times.start[leg]
    count = np.diff(np.floor(moment * rate)).astype(np.int64)
    inside = np.clip(marks, margin, length - margin)
    middle, mean = 0.5 * (inside[1:] + inside[:-1]), 0.5 * (moment[1:] + moment[:-1])
    occupied = count > 0
    width = inside[1:] - inside[:-1]
    return (
        middle[occupied],
        mean[occupied],
        count[occupied] / rate,
        count[occupied],
        width[occupied],
    )


def lay_out(starts: Array, ends: Array, times: DriveTimes, cut: Cut, setup: Setup) -> Pieces:
    """Path pieces of single legs.

    Parameters
    ----------
    starts, ends : ndarray, shape (n, 3), m
    times : DriveTimes
        Of these legs.
    cut : callable
        Such as ``recorded_pieces``.

    Returns
    -------
    Pieces
        Nominal points in a tracker frame parallel to the machine frame.
    """
    legs = np.flatnonzero(times.length > MIN_LEG)
    parts = [_leg_pieces(times, cut(np.stack([starts[j], ends[j]])), int(j), setup) for j in legs]
    middle, time, duration, count, width = (np.concatenate(p) for p in zip(*parts, strict=True))
    leg = np.repeat(legs, [len(p[0]) for p in parts])
    direction = (ends[leg] - starts[leg]) / times.length[leg, None]
    return Pieces(
        xyz=starts[leg] + middle[:, None] * direction - setup.place,
        leg=leg,
        origin=starts[leg],
        direction=direction,
        side=sides_of_travel((ends - starts) / np.maximum(times.length, MIN_LEG)[:, None])[leg],
        count=count.astype(np.int64),
        time=time,
        duration=duration,
        speed=times.peak[leg],
        spread=width / np.sqrt(12.0),
        samples=np.arange(count.sum()),
        piece=np.repeat(np.arange(len(count)), count),
        used=int(count.sum()),
        outliers=0,
        end=times.duration,
    )


def forecast_pieces(plan: Plan, cut: Cut, setup: Setup) -> Pieces:
    """Path pieces of a plan; see ``lay_out``."""
    points, times = plan.path.points, drive_times(plan, setup.config.acceleration)
    return lay_out(points[:-1], points[1:], times, cut, setup)


def tracker_pose(setup: Setup) -> RigidTransform:
    """Pose of a tracker that stands at the place, its frame parallel to the machine's."""
    return RigidTransform(np.eye(3), setup.place)


def forecast(plan: Plan, setup: Setup) -> Forecast:
    """Forecast what a calibration with this plan will show."""
    points = plan.path.points
    nodes = table_nodes(setup.machine, points.min(axis=0), points.max(axis=0))
    equal = equal_pieces(
        layout(smooth_bases(nodes)).knots, PIECE_SHARE, setup.calibration.piece_length
    )
    pieces = forecast_pieces(plan, needed_pieces(recorded_pieces(nodes, setup), equal), setup)
    duration = drive_times(plan, setup.config.acceleration).duration
    return forecast_of_pieces(pieces, tracker_pose(setup), nodes, points, setup, duration)


def forecast_of_pieces(
    pieces: Pieces,
    pose: RigidTransform,
    nodes: dict[str, Array],
    points: Array,
    setup: Setup,
    duration: float,
) -> Forecast:
    """What path pieces show, whatever was measured at them: of a plan, or of a recording.

    Parameters
    ----------
    pose : RigidTransform
        Of the tracker.
    nodes : mapping of axis to ndarray, m
        Of the tables.
    points : ndarray, shape (n, 3), m
        Corner points, which span the grid that is judged.
    duration : float
        s.
    """
    machine, limit = setup.machine, setup.calibration.unidentifiable_above
    unknowns = layout(smooth_bases(nodes))
    judged = build_system(machine, pieces, pose, unknowns, nodal_lever=True)
    whitener = Whitener.of(judged, pieces, setup.noise)
    normal = normal_equations(judged, unknowns, whitener)
    accepted = identifiable_blocks(normal, unknowns, limit)
    system = build_system(machine, pieces, pose, unknowns)
    prior = expected_precision(unknowns, limit, setup.config.error_size)
    own = normal_equations(system, unknowns, whitener)
    solution = solve(own, unknowns, limit, accepted, prior)
    rows = table_rows(unknowns, nodes)
    covariance = rows @ solution.covariance @ rows.T
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    u: dict[str, Array] = {n: deviation[k : k + 1] for k, n in enumerate(SQUARENESS)}
    grid = covered_grid(machine, points, setup.config.grid)
    grid_u, grid_u_free = grid_uncertainty(machine, nodes, covariance, grid)
    return Forecast(
        unknowns=unknowns,
        solution=solution,
        nodes=nodes,
        determined=by_motion(determined_by_data(own, unknowns, accepted, limit, rows), nodes),
        normal=normal,
        u=u | by_motion(deviation, nodes),
        covariance=covariance,
        grid=grid,
        grid_u=grid_u,
        grid_u_free=grid_u_free,
        pieces=pieces,
        duration=duration,
    )


def grid_uncertainty(
    machine: Machine, nodes: dict[str, Array], covariance: Array, grid: Array
) -> tuple[Array, Array]:
    """Uncertainty on a grid, in the gauge of the tables and free of rigid motion.

    Returns
    -------
    gauge, free : ndarray, shape (n, 3), m
    """
    rows = prediction_rows(machine, {m: nodes[m.axis] for m in MOTIONS}, grid)
    flat = rows.reshape(-1, rows.shape[2])
    uncertainties = []
    for part in (flat, free_rows(flat, grid)):
        variance = np.einsum('ij,ij->i', part @ covariance, part)
        uncertainties.append(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3))
    return uncertainties[0], uncertainties[1]


# Systematic contributions in the forecast of a plan: declared ones, and typical ones beside.
#
# The sensitivities are those of the budget, for the pieces that the plan would give.

Planned = tuple[Observed, JointSolution, ErrorTables]
"""What a plan shows, and solution and tables with zero deviations."""


def planned_solution(plan: Plan, setup: Setup, forecast: Forecast) -> Planned:
    """What the plan shows, and solution and tables with zero deviations."""
    observed = Observed(
        machine=setup.machine,
        shape=straight_shape(plan.path.points),
        pieces=forecast.pieces,
        pose=tracker_pose(setup),
        noise=setup.noise,
    )
    return solution_of_pieces(observed, forecast)


def solution_of_pieces(observed: Observed, forecast: Forecast) -> Planned:
    """What pieces show, planned or recorded, and solution and tables with zero deviations."""
    machine = observed.machine
    system = build_system(machine, forecast.pieces, observed.pose, forecast.unknowns)
    whitener = Whitener.of(system, forecast.pieces, observed.noise)
    solved = SolvedRun(observed.pose, system, whitener, np.zeros_like(system.deviation))
    nothing = Roughness({}, np.zeros((forecast.unknowns.free,) * 2), np.zeros((0, 0)), 0.0, 0.0)
    solution = JointSolution(
        forecast.unknowns, forecast.solution, nothing, forecast.normal, (solved,), 1
    )
    return observed, solution, tables_of(machine, forecast.unknowns, forecast.solution)


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
    expected : ExpectedRemainder
        Expanded, with all of them: what a calibration would state first.
    """

    declared: tuple[str, ...]
    missing: tuple[str, ...]
    noise: float
    with_declared: float
    with_typical: float
    expected: ExpectedRemainder

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


def planned_systematic(planned: Planned, forecast: Forecast) -> PlannedSystematic:
    """Forecast the grid with declared contributions, and with typical ones for the others.

    Parameters
    ----------
    planned : tuple of Observed, JointSolution, ErrorTables
        See ``planned_solution``.
    forecast : Forecast
        Of the same plan.
    """
    run, solution, tables = planned
    rows = table_rows(forecast.unknowns, forecast.nodes)

    def added(sources: Sequence[Any], runs: Sequence[Observed]) -> Array:
        total = np.zeros_like(forecast.covariance)
        states = piece_states(runs, solution, tables) if sources else []
        for free in systematic_sensitivities(sources, states, solution):
            change = rows @ free
            total += change @ change.T
        return total

    def lengths(covariance: Array) -> Array:
        free = grid_uncertainty(run.machine, forecast.nodes, covariance, forecast.grid)[1]
        return np.asarray(np.linalg.norm(free, axis=1))

    keys = missing_keys([run])
    missing = [s for s in SYSTEMATIC if set(s.keys) & set(keys)]
    declared = declared_sources([run])
    own = forecast.covariance + added(declared, [run])
    noise = np.linalg.norm(forecast.grid_u_free, axis=1)
    stated = lengths(own) if declared else noise
    whole = lengths(own + added(missing, typical_runs([run], keys))) if missing else stated
    expected = ExpectedRemainder(
        expanded=length_sizes(COVERAGE_FACTOR * whole),
        observed=length_sizes(COVERAGE_FACTOR * noise),
        k=COVERAGE_FACTOR,
        assumed=tuple(s.source for s in missing),
        nothing_declared=len(keys) == len(KEYS),
    )
    return PlannedSystematic(
        tuple(s.source for s in declared),
        expected.assumed,
        forecast.mean_grid_u,
        float(stated.mean()),
        float(whole.mean()),
        expected,
    )


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
            points = np.array(data['path'], dtype=float)
            feed = np.array(data['feed'], dtype=float)
            place = np.array(data['tracker_place'], dtype=float)
            plan = Plan(NominalPath(points), feed, np.zeros(len(points)))
            if place.shape != (3,) or not np.all(np.isfinite(place)):
                raise ValueError('tracker_place')
        except (KeyError, TypeError, ValueError, OtfError) as error:
            raise ConfigError(f'{where}: measured: cannot be read ({error})') from None
        return cls(plan, place)

    def observed(self, setup: Setup) -> Observed:
        """What the run shows, by its path alone."""
        own = setup.at(self.place)
        return Observed(
            machine=own.machine,
            shape=straight_shape(self.plan.path.points),
            pieces=forecast(self.plan, own).pieces,
            pose=tracker_pose(own),
            noise=own.noise,
        )


def joint_rows(planned: Planned, before: Sequence[Observed], limit: float) -> Rows:
    """Rows of a planned run and of those before it, with zero deviations and common tables."""
    observed, planned_solution, _ = planned
    runs = [observed, *before]
    unknowns = layout(planned_solution.unknowns.bases, len(runs))
    solved = []
    for number, run in enumerate(runs):
        system = build_system(run.machine, run.pieces, run.pose, unknowns, run=number)
        whitener = Whitener.of(system, run.pieces, run.noise)
        solved.append(SolvedRun(run.pose, system, whitener, np.zeros_like(system.deviation)))
    nothing = np.zeros(unknowns.full)
    solution = Solution(
        nothing,
        np.outer(nothing, nothing),
        planned_solution.solution.accepted,
        0,
        np.zeros((0, 0)),
    )
    joint = replace(planned_solution, unknowns=unknowns, solution=solution, runs=tuple(solved))
    return rows_of(runs, joint, limit)
