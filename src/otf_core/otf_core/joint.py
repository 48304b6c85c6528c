# SPDX-License-Identifier: Apache-2.0
"""Joint solution of runs: common tables, one pose per run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.frames import RigidTransform
from otf_core.machine import Machine
from otf_core.normal import NormalEquations, Whitener, normal_equations
from otf_core.pieces import GROSS, RAYLEIGH_MEDIAN
from otf_core.runs import Run, blamed
from otf_core.solution import Solution, identifiable_blocks, solve
from otf_core.system import System, build_system
from otf_core.tables import MOTIONS, SQUARENESS, ErrorTables, MotionTable, Squareness
from otf_core.unknowns import Unknowns, pose_block

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

MAX_REPETITIONS = 4
"""Repeated solutions; bad pieces bend the tables at first and hide others."""


@dataclass(frozen=True)
class SolvedRun:
    """One run at the solution.

    Attributes
    ----------
    pose : RigidTransform
        Tracker to machine.
    system : System
    whitener : Whitener
    residual : ndarray, shape (c, p), m
        Deviation less model.
    """

    pose: RigidTransform
    system: System
    whitener: Whitener
    residual: Array


@dataclass(frozen=True)
class JointSolution:
    """Solution of all runs.

    Attributes
    ----------
    unknowns : Unknowns
    solution : Solution
    runs : tuple of SolvedRun
    iterations : int
    """

    unknowns: Unknowns
    solution: Solution
    runs: tuple[SolvedRun, ...]
    iterations: int


def tables_of(
    machine: Machine, unknowns: Unknowns, solution: Solution, inflation: float = 1.0
) -> ErrorTables:
    """Error tables of a solution; ``inflation`` multiplies its covariance."""
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


def _systems(
    runs: Sequence[Run],
    poses: Sequence[RigidTransform],
    unknowns: Unknowns,
    tables: ErrorTables | None,
) -> list[System]:
    return [
        build_system(run.machine, run.pieces, pose, unknowns, tables, run=k)
        for k, (run, pose) in enumerate(zip(runs, poses, strict=True))
    ]


def summed(
    systems: Sequence[System], unknowns: Unknowns, whiteners: Sequence[Whitener]
) -> NormalEquations:
    """Sum up the normal equations of all runs."""
    pairs = zip(systems, whiteners, strict=True)
    return reduce(add, (normal_equations(s, unknowns, w) for s, w in pairs))


def solve_robustly(
    runs: Sequence[Run], unknowns: Unknowns, config: CalibrationConfig, progress: Progress
) -> tuple[list[Run], JointSolution]:
    """Solve, leave out pieces far from the solution, judge the floor, solve again.

    Bursts of bad samples longer than the window of the outlier test, and corners rounded beyond
    ``corner_exclusion``, show as pieces many robust standard deviations off.

    Returns
    -------
    runs : list of Run
        With the pieces that were kept and the floor of their uncertainty.
    solution : JointSolution
    """
    runs = list(runs)
    for _ in range(MAX_REPETITIONS):
        done = solve_jointly(runs, unknowns, config, progress)
        drop = [_far_pieces(s, config.outlier_limit) for s in done.runs]
        floors = [s.whitener.floor_seen(s.residual) for s in done.runs]
        settled = all(f < 1.5 * r.floor for f, r in zip(floors, runs, strict=True))
        if settled and not any(d.any() for d in drop):
            return runs, done
        runs = [
            replace(r, pieces=r.pieces.without(d), floor=f)
            for r, d, f in zip(runs, drop, floors, strict=True)
        ]
    return runs, solve_jointly(runs, unknowns, config, progress)


def _far_pieces(run: SolvedRun, limit: float) -> NDArray[np.bool_]:
    distance = np.linalg.norm(run.residual, axis=0)
    sigma = float(np.median(distance)) / RAYLEIGH_MEDIAN
    return np.asarray(distance > max(limit * sigma, GROSS))


def solve_jointly(
    runs: Sequence[Run],
    unknowns: Unknowns,
    config: CalibrationConfig,
    progress: Progress,
) -> JointSolution:
    """Solve, move the poses, re-derive the positions on the paths; until nothing changes.

    Raises
    ------
    InputError
        If the solution does not settle.
    """
    machine, limit = runs[0].machine, config.unidentifiable_above
    poses = [run.pose for run in runs]
    first = [
        build_system(run.machine, run.pieces, run.pose, unknowns, run=k, nodal_lever=True)
        for k, run in enumerate(runs)
    ]
    whiteners = []
    for system, run in zip(first, runs, strict=True):
        with blamed(run.recording):
            whiteners.append(Whitener(system, run.pieces, run.noise, run.floor))
    accepted = identifiable_blocks(summed(first, unknowns, whiteners), unknowns, limit)
    tables, rest, change = None, [np.inf] * len(runs), np.inf
    for iteration in range(1, config.max_iterations + 1):
        systems = _systems(runs, poses, unknowns, tables)
        solution = solve(summed(systems, unknowns, whiteners), unknowns, limit, accepted)
        tables = tables_of(machine, unknowns, solution)
        motion = [solution.value[unknowns.blocks[pose_block(k)]] for k in range(len(runs))]
        left = [
            s.deviation - (s.design @ solution.value).reshape(s.deviation.shape) for s in systems
        ]
        change = max(float(np.abs(a - b).max()) for a, b in zip(left, rest, strict=True))
        rest = left
        progress('solving', iteration / (iteration + 1))
        if change < config.alignment_stop:
            solved = zip(poses, systems, whiteners, left, strict=True)
            return JointSolution(
                unknowns, solution, tuple(SolvedRun(*parts) for parts in solved), iteration
            )
        poses = [p.moved_by(m[:3], m[3:]) for p, m in zip(poses, motion, strict=True)]
    names = ', '.join(run.recording.name for run in runs if run.recording.name)
    raise InputError(
        f'{names and names + ": "}the solution did not settle in {config.max_iterations} '
        f'iterations (last change {1e6 * change:.3g} um); the path may not determine the errors'
    )
