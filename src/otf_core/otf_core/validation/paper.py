# SPDX-License-Identifier: Apache-2.0
"""The comparisons of the paper on simulated cells (Sanders et al. 2023, sections 2.1 to 2.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.calibrate import calibrate, calibrate_runs
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.comparison.compare import (
    Comparison,
    compare,
    normalised_error,
    source_of_measurement,
    source_of_tables,
)
from otf_core.config import STANDSTILL, CalibrationConfig, PlannerConfig
from otf_core.model.direct_measurement import DirectMeasurement
from otf_core.model.evaluation import lattice, mean_length, rigid_columns, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec
from otf_core.model.motions import MOTIONS, ErrorMotion
from otf_core.model.observation import Samples
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.pieces.methods import align_stops, prepare_stops, stop_pieces
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import edge_points, plan_path, spread_points, standstill_plan
from otf_core.prediction.uncertainty import prediction_rows

# What the comparisons need of a cell: true errors, recorded runs, a direct instrument.
#
# The simulation stands behind it; nothing in this package draws random numbers or sees the truth
# before it is judged.


class Laboratory(Protocol):
    """A cell whose true errors are known."""

    def true_errors(self, machine: Machine, size: float, seed: int) -> ErrorTables:
        """Error tables with a mean volumetric error of ``size``, m."""

    def record(
        self, machine: Machine, plan: Plan, truth: ErrorTables, seed: int, noise: bool = True
    ) -> Samples:
        """Tracker samples of a run, 500 per second."""

    def measure_directly(self, truth: ErrorTables, seed: int) -> DirectMeasurement:
        """Six errors along every axis, five runs forward and backward."""


@dataclass(frozen=True)
class Scale:
    """How much is simulated.

    Attributes
    ----------
    seeds : tuple of int
        One cell each.
    feeds : tuple of float, m/s
        Of the runs on the fly.
    stop_time : float
        s, standstill at every point of the standstill method.
    """

    seeds: tuple[int, ...]
    feeds: tuple[float, ...]
    stop_time: float


MM_PER_MIN = 1.0 / 60e3
FULL_FEEDS = tuple(MM_PER_MIN * f for f in (2500.0, 5000.0, 10000.0, 15000.0))
"""Paper, Table 2."""


def scale(quick: bool, seed: int, cells: int | None = None) -> Scale:
    """Full: eight cells; quick: two cells and shorter stops; or as many cells as asked for."""
    count = cells or (2 if quick else 8)
    return Scale(tuple(range(seed, seed + count)), FULL_FEEDS, 1.0 if quick else 3.0)


def paper_machine() -> Machine:
    """Cell like the paper's: three axes, the longest 600 mm; places of Table 1 scale with it."""
    axes = {
        'X': Axis(0.0, 0.6, 0.03),
        'Y': Axis(0.0, 0.5, 0.03),
        'Z': Axis(-0.4, 0.0, 0.03),
    }
    chain, offset = Chain.parse('w-b-X-Y-Z-t'), np.array([0.0, 0.0, -0.15])
    return Machine('validation', chain, axes, offset, TrackerSpec(0.5e-6, 2.0e-6))


# Comparison with a direct instrument (paper 2.3), here a simulated one.


def direct_test(
    laboratory: Laboratory, truth: ErrorTables, result: CalibrationResult, seed: int
) -> Comparison:
    """Compare a calibration on the fly with a direct measurement of the same machine."""
    measurement = laboratory.measure_directly(truth, seed)
    return compare(
        source_of_measurement('direct instrument (simulated)', measurement, truth.machine),
        source_of_tables('on the fly', result.tables, result.covariance),
    )


def largest_differences(comparison: Comparison) -> tuple[float, float, float]:
    """Largest difference of positioning (m), straightness (m) and rotations (rad)."""
    groups: tuple[list[float], list[float], list[float]] = ([], [], [])
    for symbol, motion in comparison.motions.items():
        name = ErrorMotion.of(symbol)
        group = 0 if name.is_positioning else 1 if name.is_straightness else 2
        groups[group].append(float(np.abs(motion.difference).max()))
    return max(groups[0]), max(groups[1]), max(groups[2])


# Prediction of independent reference points (paper 2.2, Table 2, Figure 5).
#
# One cell is calibrated by the standstill method and on the fly at several feeds; each calibration
# predicts what a tracker measures at 200 other points, in standstill.

REFERENCE_SIZE = 7e-6
"""m; paper 2.3.2: 7.2 um and 6.9 um on a grid."""
EDGE_POINTS, INNER_POINTS, REFERENCE_POINTS = 76, 150, 200


@dataclass(frozen=True)
class ReferenceTest:
    """One cell.

    Attributes
    ----------
    results : mapping of method to CalibrationResult
        ``STANDSTILL`` and the feeds, mm/min, as text.
    durations : mapping of method to float
        s, driving time.
    uncompensated : float
        m, mean length of the deviations measured at the reference points.
    residual : mapping of method to float
        m, the same less the prediction.
    """

    truth: ErrorTables
    reference: Plan
    results: Mapping[str, CalibrationResult]
    durations: Mapping[str, float]
    uncompensated: float
    residual: Mapping[str, float]


def calibration_points(machine: Machine) -> Array:
    """226 points as in the paper: at the edges and spread inside, shape (226, 3), m."""
    return np.concatenate(
        [edge_points(machine, EDGE_POINTS), spread_points(machine, INNER_POINTS)]
    )


def reference_points(machine: Machine) -> Array:
    """200 points in other places, shape (200, 3), m."""
    return spread_points(machine, REFERENCE_POINTS, offset=0.13)


def measured_deviations(recording: Recording) -> tuple[Array, Array]:
    """Positions and deviations at the stops of a run, rigidly aligned; both (k, 3), m."""
    alignment, stops, point = align_stops(recording.samples, recording.path, CalibrationConfig())
    pieces = stop_pieces(recording.samples, alignment, stops, point)
    return pieces.origin, alignment.T_machine_tracker.apply(pieces.xyz) - pieces.origin


def reference_test(
    laboratory: Laboratory, machine: Machine, seed: int, scale: Scale
) -> ReferenceTest:
    """Calibrate one cell in every way and predict its reference points."""
    truth = laboratory.true_errors(machine, REFERENCE_SIZE, seed)
    feed = 15000.0 * MM_PER_MIN
    stops = standstill_plan(calibration_points(machine), feed, scale.stop_time)
    reference = standstill_plan(reference_points(machine), feed, scale.stop_time)
    number = 100 * seed  # each run has noise and tracker place of its own
    samples = laboratory.record(machine, stops, truth, number)
    recording = Recording(samples, stops.path, machine)
    results = {STANDSTILL: calibrate_runs([recording], prepare=prepare_stops)}
    durations = {STANDSTILL: stops.duration}
    for k, speed in enumerate(scale.feeds, start=1):
        plan = plan_path(machine, PlannerConfig(passes=1, feed=speed))
        samples = laboratory.record(machine, plan, truth, number + k)
        name = f'{speed / MM_PER_MIN:.0f}'
        results[name] = calibrate(samples, plan.path, machine)
        durations[name] = plan.duration
    samples = laboratory.record(machine, reference, truth, number + 50)
    q, measured = measured_deviations(Recording(samples, reference.path, machine))
    residual = {
        name: mean_length(without_rigid_motion(measured - displacement(r.tables, q), q))
        for name, r in results.items()
    }
    before = mean_length(without_rigid_motion(measured, q))
    return ReferenceTest(truth, reference, results, durations, before, residual)


def agreement(a: CalibrationResult, b: CalibrationResult) -> Array:
    """E_n of the difference of two calibrations on a grid, rigid motion left out; (3 n,)."""
    q = lattice(a.tables.machine, 5)
    columns = rigid_columns(q).reshape(-1, 6)
    basis, _ = np.linalg.qr(columns)
    difference, variance = np.zeros(3 * len(q)), np.zeros(3 * len(q))
    for result, sign in ((a, -1.0), (b, 1.0)):
        nodes: dict[str, Array] = {m: result.tables.motions[m].position for m in MOTIONS}
        rows = prediction_rows(result.tables.machine, nodes, q).reshape(3 * len(q), -1)
        rows = rows - basis @ (basis.T @ rows)
        error = displacement(result.tables, q).reshape(-1)
        difference += sign * (error - basis @ (basis.T @ error))
        variance += np.einsum('ij,ij->i', rows @ result.covariance, rows)
    return normalised_error(difference, np.sqrt(np.maximum(variance, 0.0)))


# Simulative validation (paper 2.1): errors of 100 um, replicated on the path and on a grid.

REPLICATED_SIZE = 1e-4
"""m; the paper's simulated machine has a mean error of 103 um on the grid."""
GRID_POINTS = 7


@dataclass(frozen=True)
class Replication:
    """Errors before and after compensation, m.

    Attributes
    ----------
    path_before, path_after : float
        Mean perpendicular distance on the path, true errors less predicted ones.
    grid_before, grid_after : float
        Mean length of the error vectors on a regular grid.
    """

    path_before: float
    path_after: float
    grid_before: float
    grid_after: float


@dataclass(frozen=True)
class SimulativeRun:
    """One run with what the figures need."""

    machine: Machine
    plan: Plan
    samples: Samples
    truth: ErrorTables
    result: CalibrationResult
    replication: Replication


def across_path(field: Array, q: Array, axes: Array) -> Array:
    """Components of a field across the path with the best rigid motion removed.

    Parameters
    ----------
    field, q : ndarray, shape (n, 3), m
    axes : ndarray, shape (2, n, 3)
        Unit vectors across the path.

    Returns
    -------
    ndarray, shape (n, 3), m
        Vectors across the path.
    """
    rows = np.concatenate([np.einsum('ij,ijk->ik', a, rigid_columns(q)) for a in axes])
    right = np.concatenate([np.einsum('ij,ij->i', a, field) for a in axes])
    remainder = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
    return np.asarray(np.einsum('kij,ki->ij', axes, remainder.reshape(len(axes), -1)))


def replication(result: CalibrationResult, truth: ErrorTables) -> Replication:
    """Compare predicted with true errors where the paper does: self-test and grid test."""
    run, grid = result.runs[0], lattice(truth.machine, GRID_POINTS)
    true_path, true_grid = displacement(truth, run.q), displacement(truth, grid)
    left_path = true_path - displacement(result.tables, run.q)
    left_grid = true_grid - displacement(result.tables, grid)
    return Replication(
        mean_length(across_path(true_path, run.q, run.axes)),
        mean_length(across_path(left_path, run.q, run.axes)),
        mean_length(without_rigid_motion(true_grid, grid)),
        mean_length(without_rigid_motion(left_grid, grid)),
    )


def simulative_run(
    laboratory: Laboratory, machine: Machine, seed: int, noise: bool = True
) -> SimulativeRun:
    """Simulate, calibrate and judge one run of the default path."""
    plan = plan_path(machine, PlannerConfig())
    truth = laboratory.true_errors(machine, REPLICATED_SIZE, seed)
    samples = laboratory.record(machine, plan, truth, seed, noise)
    result = calibrate(samples, plan.path, machine)
    return SimulativeRun(machine, plan, samples, truth, result, replication(result, truth))
