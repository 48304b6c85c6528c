# SPDX-License-Identifier: Apache-2.0
"""From samples and path to error tables: align, reduce, solve, repeat, state uncertainty."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.alignment import Alignment, align, line_step
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.frames import RigidTransform
from otf_core.machine import AXES, Machine
from otf_core.matching import OFF_PATH
from otf_core.noise import NoiseModel
from otf_core.observation import Samples
from otf_core.path import NominalPath
from otf_core.pieces import Pieces, reduce_to_pieces
from otf_core.solution import Solution, identifiable_blocks, solve
from otf_core.system import System, build_system
from otf_core.tables import MOTIONS, SQUARENESS, ErrorTables, MotionTable, Squareness
from otf_core.uncertainty import check_residuals
from otf_core.unknowns import Unknowns, layout, table_nodes

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

GAUGE = (
    'positioning and rotations zero at axis position 0, else at the minimum; '
    'straightness zero at both ends; its slope lies in squareness and alignment'
)
MIN_COVERAGE = 0.8
"""Share of the path length below which a calibration fails the quality gate."""


@dataclass(frozen=True)
class Fit:
    """Size and quality of a fit.

    Attributes
    ----------
    samples, used, outliers, pieces : int
    unknowns, rank : int
        Free unknowns after the gauge; combinations of them that the data determine.
    coverage : float
        Driven share of the path length.
    path_mae_before, path_mae_after : float
        Mean perpendicular distance from the path, m: rigidly aligned, and compensated.
    residual_rms : float
        Root mean square of the perpendicular residual, m.
    residual_ratio : float
        Residual of the pieces over the noise specified for single samples, root mean square.
    variance_ratio, correlation_factor : float
        See ``uncertainty.ResidualCheck``.
    iterations : int
    """

    samples: int
    used: int
    outliers: int
    pieces: int
    unknowns: int
    rank: int
    coverage: float
    path_mae_before: float
    path_mae_after: float
    residual_rms: float
    residual_ratio: float
    variance_ratio: float
    correlation_factor: float
    iterations: int


@dataclass(frozen=True)
class CalibrationResult:
    """Everything a calibration found.

    Attributes
    ----------
    run_id : str
        Hash of samples, path, machine and configuration.
    tables : ErrorTables
    covariance : ndarray, shape (m, m)
        Of C0Y, B0Z, A0Z and the nodes of EXX ... ECZ in that order, m and rad.
    T_machine_tracker : RigidTransform
    fit : Fit
    pieces : Pieces
    q : ndarray, shape (p, 3), m
        Nominal position of every piece.
    axes : ndarray, shape (2, p, 3)
        The two directions perpendicular to the path in which deviations are stated.
    deviation, residual : ndarray, shape (2, p), m
        Aligned measurement minus path, before and after compensation.
    not_identifiable : tuple of str
        Motions and squareness errors the data cannot see.
    warnings : tuple of str
    failed_gates : tuple of str
        Quality gates that failed; empty for a good calibration.
    config : CalibrationConfig
    """

    run_id: str
    tables: ErrorTables
    covariance: Array
    T_machine_tracker: RigidTransform
    fit: Fit
    pieces: Pieces
    q: Array
    axes: Array
    deviation: Array
    residual: Array
    not_identifiable: tuple[str, ...]
    warnings: tuple[str, ...]
    failed_gates: tuple[str, ...]
    config: CalibrationConfig


def _run_id(
    samples: Samples, path: NominalPath, machine: Machine, config: CalibrationConfig
) -> str:
    digest = hashlib.sha256()
    for part in (samples.stamp_ns, samples.xyz, path.points):
        digest.update(np.ascontiguousarray(part))
    digest.update(json.dumps([machine.to_dict(), asdict(config)], sort_keys=True).encode())
    return digest.hexdigest()[:12]


def _covered_range(alignment: Alignment, samples: Samples, machine: Machine) -> tuple[Array, Array]:
    """Part of the axis ranges that the driven legs cover, within the machine's ranges."""
    points = alignment.T_machine_tracker.apply(samples.xyz[alignment.leg != OFF_PATH])
    low, high = points.min(axis=0), points.max(axis=0)
    path_low, path_high = alignment.corners.min(axis=0), alignment.corners.max(axis=0)
    close = 0.02
    low = np.where(low < path_low + close, path_low, low)
    high = np.where(high > path_high - close, path_high, high)
    flat = path_high - path_low < 1e-6
    low, high = np.where(flat, path_low, low), np.where(flat, path_low, high)
    outside = np.maximum(machine.lower - low, high - machine.upper).max()
    if outside > 1e-3:
        axis = AXES[int(np.argmax(np.maximum(machine.lower - low, high - machine.upper)))]
        raise InputError(
            f'path: leaves the range of axis {axis} by {1e3 * outside:.1f} mm; '
            f'do bag and machine description belong together?'
        )
    return np.maximum(low, machine.lower), np.minimum(high, machine.upper)


def _tables(machine: Machine, unknowns: Unknowns, solution: Solution, inflation: float) -> ErrorTables:
    u = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0) * inflation)
    motions, squareness = {}, {}
    for name in MOTIONS:
        block = unknowns.blocks[name]
        seen = name in solution.accepted
        motions[name] = MotionTable(
            unknowns.nodes[name[2]],
            solution.value[block] + 0.0,
            u[block] if seen else np.zeros(block.stop - block.start),
            seen,
            solution.determined[block],
        )
    for name in SQUARENESS:
        place = unknowns.blocks[name].start
        squareness[name] = Squareness(float(solution.value[place]), float(u[place]))
    return ErrorTables(machine, motions, squareness)


def _rigid_pose(pieces: Pieces, pose: RigidTransform, config: CalibrationConfig) -> RigidTransform:
    """Fine alignment on the pieces: perpendicular distances, every sample counting alike."""
    for _ in range(config.max_iterations):
        points = pose.apply(pieces.xyz)
        step = line_step(points, pieces.origin, pieces.direction, pieces.count.astype(float))
        moved = pose.moved_by(*step)
        change = float(np.abs(moved.apply(pieces.xyz) - points).max())
        pose = moved
        if change < config.alignment_stop:
            break
    return pose


def _mean_distance(components: Array) -> float:
    return float(np.hypot(components[0], components[1]).mean())


@dataclass(frozen=True)
class _Converged:
    pose: RigidTransform
    system: System
    solution: Solution
    iterations: int


def _iterate(
    machine: Machine,
    pieces: Pieces,
    pose: RigidTransform,
    unknowns: Unknowns,
    config: CalibrationConfig,
    progress: Progress,
) -> _Converged:
    """Solve, move the pose, re-derive the positions on the path; until nothing changes."""
    noise = NoiseModel.from_spec(machine.tracker)
    tables, value, limit = None, np.zeros(unknowns.full), config.unidentifiable_above
    first = build_system(machine, pieces, pose, unknowns, noise, nodal_lever=True)
    accepted = identifiable_blocks(first, unknowns, limit)
    for iteration in range(1, config.max_iterations + 1):
        system = build_system(machine, pieces, pose, unknowns, noise, tables)
        solution = solve(system, unknowns, limit, accepted)
        tables = _tables(machine, unknowns, solution, 1.0)
        change = float(np.abs(solution.value - value)[unknowns.blocks['pose'].stop :].max())
        shift = float(np.abs(solution.value[unknowns.blocks['pose']]).max())
        value = solution.value
        progress('solving', iteration / (iteration + 1))
        if max(change, shift) < config.alignment_stop:
            return _Converged(pose, system, solution, iteration)
        pose = pose.moved_by(solution.value[:3], solution.value[3:6])
    raise InputError(
        f'the solution did not settle in {config.max_iterations} iterations (last change '
        f'{1e6 * max(change, shift):.3g} um); the path may not determine the errors'
    )


def _warnings(fit: Fit, unknowns: Unknowns, solution: Solution) -> list[str]:
    found = []
    for name in MOTIONS:
        loose = ~solution.determined[unknowns.blocks[name]]
        if name in solution.accepted and loose.any():
            where = ', '.join(f'{v:g}' for v in unknowns.nodes[name[2]][loose])
            found.append(f'{name}: not determined at {where} m; interpolated there')
    if fit.coverage < 0.98:
        found.append(f'only {100 * fit.coverage:.1f} % of the path was recorded')
    if fit.outliers > 0.01 * fit.samples:
        found.append(f'{fit.outliers} samples left out as outliers')
    if fit.residual_ratio > 1.5:
        found.append(
            f'residuals of path pieces are {fit.residual_ratio:.1f} times the noise specified for '
            f'single samples: an effect that the rigid-body model lacks, or more noise'
        )
    return found


def calibrate(
    samples: Samples,
    path: NominalPath,
    machine: Machine,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate on the fly: only deviations perpendicular to the path are used.

    Parameters
    ----------
    samples : Samples
        Tracker points; no time relation to the path is needed.
    path : NominalPath
    machine : Machine
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning' or 'solving'; what it raises ends the work.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    InputError
        If samples and path do not belong together or determine nothing.

    References
    ----------
    Sanders et al., J. Manuf. Mater. Process. 2023, 7, 60, section 1.2.
    """
    config = config or CalibrationConfig()
    progress = progress or (lambda stage, fraction: None)
    progress('aligning', 0.0)
    alignment = align(samples, path, config)
    progress('aligning', 0.7)
    nodes = table_nodes(machine, *_covered_range(alignment, samples, machine))
    unknowns = layout(nodes)
    pieces = reduce_to_pieces(samples, alignment, tuple(nodes[a] for a in AXES), config)
    pose = _rigid_pose(pieces, alignment.T_machine_tracker, config)
    progress('solving', 0.0)
    before = build_system(machine, pieces, pose, unknowns, NoiseModel.from_spec(machine.tracker))
    done = _iterate(machine, pieces, pose, unknowns, config, progress)
    return _assemble(
        samples, path, machine, config, alignment.coverage, unknowns, pieces, before, done
    )


def _assemble(
    samples: Samples,
    path: NominalPath,
    machine: Machine,
    config: CalibrationConfig,
    coverage: float,
    unknowns: Unknowns,
    pieces: Pieces,
    before: System,
    done: _Converged,
) -> CalibrationResult:
    solution, system = done.solution, done.system
    normalised = solution.residual * np.sqrt(system.weight).reshape(2, -1)
    check = check_residuals(normalised, pieces.leg, solution.rank)
    single = NoiseModel.from_spec(machine.tracker).piece_factor(pieces.count)
    fit = Fit(
        samples=len(samples),
        used=pieces.used,
        outliers=pieces.outliers,
        pieces=len(pieces),
        unknowns=solution.unknowns,
        rank=solution.rank,
        coverage=coverage,
        path_mae_before=_mean_distance(before.deviation),
        path_mae_after=_mean_distance(solution.residual),
        residual_rms=float(np.sqrt(np.mean(np.sum(solution.residual**2, axis=0)))),
        residual_ratio=float(np.sqrt(np.mean(normalised**2 * single))),
        variance_ratio=check.variance_ratio,
        correlation_factor=check.correlation_factor,
        iterations=done.iterations,
    )
    gates = []
    if coverage < MIN_COVERAGE:
        gates.append(f'coverage: {100 * coverage:.0f} % of the path driven, {100 * MIN_COVERAGE:.0f} % needed')
    if fit.path_mae_after >= fit.path_mae_before:
        gates.append('compensation: the tables do not reduce the distance from the path')
    order = [unknowns.blocks[name] for name in (*SQUARENESS, *MOTIONS)]
    index = np.concatenate([np.arange(b.start, b.stop) for b in order])
    missing = tuple(n for n in (*SQUARENESS, *MOTIONS) if n not in solution.accepted)
    return CalibrationResult(
        run_id=_run_id(samples, path, machine, config),
        tables=_tables(machine, unknowns, solution, check.inflation),
        covariance=solution.covariance[np.ix_(index, index)] * check.inflation,
        T_machine_tracker=done.pose,
        fit=fit,
        pieces=pieces,
        q=system.q,
        axes=system.axes,
        deviation=system.deviation,
        residual=solution.residual,
        not_identifiable=missing,
        warnings=tuple(_warnings(fit, unknowns, solution)),
        failed_gates=tuple(gates),
        config=config,
    )
