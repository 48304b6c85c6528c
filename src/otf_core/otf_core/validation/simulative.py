# SPDX-License-Identifier: Apache-2.0
"""Simulative validation (paper 2.1): errors of 100 um, replicated on the path and on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.calibration.calibrate import calibrate
from otf_core.calibration.result import CalibrationResult
from otf_core.config import PlannerConfig
from otf_core.model.evaluation import lattice, mean_length, rigid_columns, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.planning.path_creation import plan_path
from otf_core.validation.laboratory import Laboratory

ERROR_SIZE = 1e-4
"""m; the paper's simulated machine has a mean error of 103 um on the grid."""
GRID = 7


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
    """Components of a field across the path with the best rigid motion taken out.

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
    left = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
    return np.asarray(np.einsum('kij,ki->ij', axes, left.reshape(len(axes), -1)))


def replication(result: CalibrationResult, truth: ErrorTables) -> Replication:
    """Compare predicted with true errors where the paper does: self-test and grid test."""
    run, grid = result.runs[0], lattice(truth.machine, GRID)
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
    truth = laboratory.true_errors(machine, ERROR_SIZE, seed)
    samples = laboratory.record(machine, plan, truth, seed, noise)
    result = calibrate(samples, plan.path, machine)
    return SimulativeRun(machine, plan, samples, truth, result, replication(result, truth))
