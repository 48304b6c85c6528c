# SPDX-License-Identifier: Apache-2.0
"""Prediction of independent reference points (paper 2.2, Table 2, Figure 5).

One cell is calibrated by the standstill method and on the fly at several feeds; each calibration
predicts what a tracker measures at 200 other points, in standstill.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.calibrate import calibrate, calibrate_runs
from otf_core.calibration.result import CalibrationResult
from otf_core.comparison.compare import normalised_error
from otf_core.config import STANDSTILL, CalibrationConfig, PlannerConfig
from otf_core.model.evaluation import lattice, mean_length, rigid_columns, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Machine
from otf_core.model.motions import MOTIONS
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import Recording
from otf_core.pieces.standstill_method import align_stops, prepare_stops, stop_pieces
from otf_core.planning.path_creation import edge_points, plan_path, spread_points, standstill_plan
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.validation.laboratory import MM_PER_MIN, Laboratory, Scale

ERROR_SIZE = 7e-6
"""m; paper 2.3.2: 7.2 um and 6.9 um on a grid."""
EDGE_POINTS, INNER_POINTS, REFERENCE_POINTS = 76, 150, 200


@dataclass(frozen=True)
class ReferenceTest:
    """One cell.

    Attributes
    ----------
    truth : ErrorTables
    reference : Plan
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
    truth = laboratory.true_errors(machine, ERROR_SIZE, seed)
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
