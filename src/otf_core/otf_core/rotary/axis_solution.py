# SPDX-License-Identifier: Apache-2.0
"""Joint solution of all runs: poses, places of targets, location errors and motions.

Solve, move poses and places, take the places along the curves anew from the compensated points,
until nothing changes; leave out pieces far from the solution, fit the noise, solve again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.motions import is_motion
from otf_core.model.path import leg_bounds
from otf_core.model.tables import ErrorTables, LocationError, MotionTable, Squareness
from otf_core.noise.noise_model import Misfit, NoiseModel, noise_and_misfit
from otf_core.pieces.pieces import MIN_OUTLIER, RAYLEIGH_MEDIAN
from otf_core.rotary.axis_unknowns import PLACE, place_block
from otf_core.rotary.rows import AxisRun, AxisSystem, build_rows
from otf_core.solving.joint import (
    MAX_RATIO_OF_CHANGES,
    MIN_PIECE_OUTLIER,
    FittedNoise,
    fit_noise,
    is_same_noise,
    newton_step,
    residuals_of,
)
from otf_core.solving.model_choice import LinearSolution, most_likely
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.solution import Solution, solve
from otf_core.solving.unknowns import Unknowns, free_values, pose_block
from otf_core.solving.whitener import Whitener

MOST_BEYOND = 0.05
"""Share of the pieces that may be left out for their distance alone."""
REPETITIONS = 4
DAMPED = 1e-4
"""m and rad; what the data do not show, poses and places follow in steps of little more than this,
or of a tenth where the steps do not become smaller."""
DIVERGED = 100.0
"""Ratio of a change to the least one from which it is given up."""
FINE = 8
"""Parts of an interval between knots in tables for use inside."""


@dataclass(frozen=True)
class SolvedAxisRun:
    """One run at the solution.

    Attributes
    ----------
    residual : ndarray, shape (c, p), m
    noise : NoiseModel
        Of single samples, as the residuals say it.
    """

    run: AxisRun
    system: AxisSystem
    whitener: Whitener
    residual: Array
    noise: NoiseModel
    misfit: Misfit


@dataclass(frozen=True)
class AxisSolution:
    """Solution of all runs.

    Attributes
    ----------
    normal : NormalEquations
        Of all rows, what is known of places included.
    poses : tuple of RigidTransform
        Of the places of the tracker.
    places : mapping of target to ndarray, shape (3,), m
    """

    machine: Machine
    unknowns: Unknowns
    solution: Solution
    roughness: Roughness
    normal: NormalEquations
    runs: tuple[SolvedAxisRun, ...]
    poses: tuple[RigidTransform, ...]
    places: Mapping[str, Array]
    iterations: int


class UnsettledError(InputError):
    """A solution that does not converge; ``joint`` is the one that changed least."""

    joint: AxisSolution


def tables_of(machine: Machine, unknowns: Unknowns, value: Array) -> ErrorTables:
    """Fine tables of a solution, for use inside; without uncertainties."""
    motions: dict[str, MotionTable] = {}
    for name in machine.motions:
        basis = unknowns.bases[name.axis]
        position = basis.finer(FINE)
        inner = basis.matrix(position) @ value[unknowns.blocks[name]]
        motions[name] = MotionTable(position, inner, np.zeros(len(position)))

    def scalar(name: str) -> float:
        return float(value[unknowns.blocks[name].start])

    return ErrorTables(
        machine,
        motions,
        {n: Squareness(scalar(n)) for n in machine.squareness},
        {n: LocationError(scalar(n)) for n in machine.location},
    )


def choose_functions(
    joint: AxisSolution, layouts: Mapping[str, Unknowns], limit: float
) -> AxisSolution:
    """One linear solution with the functions that the data call for, as for linear axes.

    Parameters
    ----------
    joint : AxisSolution
        With smooth functions.
    layouts : mapping of name to Unknowns
        With the functions to choose from, see ``model_choice.most_likely``.
    limit : float
        ``unidentifiable_above``.
    """
    places = joint.runs[0].run.places
    stations = {s.run.station for s in joint.runs}

    def fit(name: str) -> LinearSolution:
        unknowns = layouts[name]
        systems = [s.system.of_unknowns(unknowns) for s in joint.runs]
        normal = _sum_rows(systems, unknowns, [s.whitener for s in joint.runs])
        normal = normal + place_equations(joint.machine, unknowns, places)
        normal = normal + _step_equations(unknowns, stations, places, DAMPED)
        return LinearSolution.of(
            normal, unknowns, _accepted(unknowns), limit, joint.roughness.logs
        )

    tried = {name: fit(name) for name in layouts}
    return _moved(joint, tried[most_likely(tried)[0]])


def _moved(joint: AxisSolution, linear: LinearSolution) -> AxisSolution:
    """A linear solution at the rows of another, poses and places moved by its steps."""
    unknowns, value = linear.unknowns, linear.solution.value
    stations = {s.run.station for s in joint.runs}
    poses, places = dict(zip(sorted(stations), joint.poses, strict=True)), dict(joint.places)
    _move(poses, places, unknowns, value)
    runs = []
    for one in joint.runs:
        system = one.system.of_unknowns(unknowns)
        residual = residuals_of(cast(Any, [system]), linear.solution)[0]
        run = one.run.placed(poses[one.run.station], places)
        runs.append(replace(one, run=run, system=system, residual=residual))
    value = _without_steps(value, unknowns, poses, places)
    return AxisSolution(
        joint.machine, unknowns, replace(linear.solution, value=value), linear.roughness,
        linear.normal, tuple(runs), tuple(poses[k] for k in sorted(poses)), places,
        joint.iterations,
    )  # fmt: skip


def solve_robustly(
    joint: AxisSolution,
    noises: Sequence[NoiseModel],
    fitted: Sequence[Array | None],
    config: CalibrationConfig,
    progress: Progress,
    repetitions: int = REPETITIONS,
) -> tuple[AxisSolution, list[Array | None]]:
    """Leave out what is far from a solution, fit the noise, solve again; until nothing changes.

    Parameters
    ----------
    noises : sequence of NoiseModel
        Of every run, from standstills or specification.
    fitted : sequence of ndarray, shape (5,), or None
        What residuals said of the noise that ``joint`` was solved with, see ``fit_noise``.

    Returns
    -------
    solution : AxisSolution
    fitted : list of ndarray, shape (5,)
        What its residuals say of the noise of every run.
    """
    known = list(fitted)
    for repetition in range(repetitions):
        same, runs = True, []
        for k, solved in enumerate(joint.runs):
            drop = _far(solved, config.outlier_limit)
            noise = _noise(solved, noises[k], joint.solution.covariance, known[k])
            before = known[k]
            if drop.any() or before is None or not is_same_noise(noise, before):
                same = False
            known[k] = noise.logs
            runs.append(replace(solved.run, pieces=solved.run.pieces.without(drop)))
        progress('solving', (repetition + 1) / (repetitions + 1))
        if same or repetition == repetitions - 1:
            break
        tables = tables_of(joint.machine, joint.unknowns, joint.solution.value)
        joint = solve_jointly(
            runs, noises, known, joint.unknowns, config, progress, tables, joint.roughness.logs
        )
    return joint, known


def _noise(
    solved: SolvedAxisRun, noise: NoiseModel, covariance: Array, start: Array | None
) -> FittedNoise:
    system, pieces = cast(Any, solved.system), cast(Any, solved.run.pieces)
    return fit_noise(system, pieces, solved.residual, noise, covariance, start)


def _far(solved: SolvedAxisRun, limit: float) -> NDArray[np.bool_]:
    """Pieces far from the solution, or from the others of their line."""
    own = solved.residual.copy()
    for low, high in leg_bounds(solved.run.pieces.leg):
        if high - low > 2:
            own[:, low:high] -= np.median(solved.residual[:, low:high], axis=1, keepdims=True)
    near, whole = (np.linalg.norm(v, axis=0) for v in (own, solved.residual))
    sigma, wide = (float(np.median(v)) / RAYLEIGH_MEDIAN for v in (near, whole))
    far = near > max(limit * sigma, MIN_PIECE_OUTLIER)
    beyond = whole > max(limit * wide, MIN_OUTLIER)
    # what holds for a part of the run is no outlier
    return np.asarray(far | beyond if np.mean(beyond) < MOST_BEYOND else far)


def place_equations(
    machine: Machine, unknowns: Unknowns, places: Mapping[str, Array]
) -> NormalEquations:
    """What machine.yaml says of the places of targets, as normal equations."""
    matrix, right = np.zeros((unknowns.free, unknowns.free)), np.zeros(unknowns.free)
    square, rows = 0.0, 0
    seen = [n for n in machine.targets if place_block(n) in unknowns.free_blocks]
    for nest in dict.fromkeys(machine.targets[n].nest or n for n in seen):
        names = [n for n in seen if nest in (n, machine.targets[n].nest)]
        target = machine.targets[nest]
        # the centre of the nest is common to all facings, each of which is off it by u_facing
        common, own_part = target.u**2, target.u_facing**2
        cover = common * np.ones((len(names), len(names))) + own_part * np.eye(len(names))
        precision = np.linalg.inv(cover)
        off = np.array([np.array(target.place) - places[n] for n in names])
        columns = np.array([unknowns.free_blocks[place_block(n)].start for n in names])
        for k in range(PLACE):
            matrix[np.ix_(columns + k, columns + k)] = precision
            right[columns + k] = precision @ off[:, k]
        square, rows = square + float(np.sum(off * (precision @ off))), rows + off.size
    return NormalEquations(matrix, right, square, rows)


def _step_equations(
    unknowns: Unknowns, stations: Iterable[int], places: Iterable[str], size: float
) -> NormalEquations:
    """Steps of poses and places of some size, m and rad, as normal equations."""
    matrix, right = np.zeros((unknowns.free, unknowns.free)), np.zeros(unknowns.free)
    for name in (*map(pose_block, stations), *map(place_block, places)):
        block = unknowns.free_blocks.get(name)
        if block is not None:
            own = np.arange(block.start, block.stop)
            matrix[own, own] = 1.0 / size**2
    return NormalEquations(matrix, right, 0.0, 0)


def _sum_rows(
    systems: Sequence[AxisSystem], unknowns: Unknowns, whiteners: Sequence[Whitener]
) -> NormalEquations:
    """Normal equations of the rows of all runs."""
    pairs = zip(systems, whiteners, strict=True)
    return reduce(add, [normal_equations(cast(Any, s), unknowns, w) for s, w in pairs])


def _accepted(unknowns: Unknowns) -> tuple[str, ...]:
    """Blocks to solve for: all; what the data do not show keeps its uncertainty."""
    return tuple(n for n, s in unknowns.free_blocks.items() if s.stop > s.start)


def _weights_of(
    systems: Sequence[AxisSystem],
    runs: Sequence[AxisRun],
    noises: Sequence[tuple[NoiseModel, Misfit]],
) -> list[Whitener]:
    """Weights of the rows of every run, from its noise and misfit."""
    return [
        Whitener.of(cast(Any, s), cast(Any, run.pieces), *noise)
        for s, run, noise in zip(systems, runs, noises, strict=True)
    ]


def solve_jointly(
    runs: Sequence[AxisRun],
    noises: Sequence[NoiseModel],
    fitted: Sequence[Array | None],
    unknowns: Unknowns,
    config: CalibrationConfig,
    progress: Progress,
    tables: ErrorTables | None = None,
    logs: Mapping[str, Array] | None = None,
) -> AxisSolution:
    """Solve, move poses and places, take the places along the curves anew until nothing changes.

    Parameters
    ----------
    noises, fitted
        See ``solve_robustly``.
    tables : ErrorTables, optional
        For the places along the curves at first.
    logs : mapping of motion to ndarray, optional
        Roughness to start from.

    Raises
    ------
    InputError
        If it does not converge.
    """
    machine, limit = runs[0].machine, config.unidentifiable_above
    poses = {run.station: run.pose for run in runs}
    places = dict(runs[0].places)
    accepted = _accepted(unknowns)
    models = [noise_and_misfit(*pair) for pair in zip(noises, fitted, strict=True)]
    whiteners: list[Whitener] | None = None
    rough: Roughness | None = None
    solution: Solution | None = None
    residuals: list[Array] = []
    change, least, stuck, damping = np.inf, np.inf, False, DAMPED
    for iteration in range(1, config.max_iterations + 1):
        own = [run.placed(poses[run.station], places) for run in runs]
        systems = [build_rows(run, unknowns, tables) for run in own]
        whiteners = whiteners or _weights_of(systems, own, models)
        known = place_equations(machine, unknowns, places)
        first = iteration == 1 or (iteration == 2 and logs is None)
        if rough is None or solution is None or first or stuck:
            normal = _sum_rows(systems, unknowns, whiteners) + known
            if rough is None or first:
                search = Search(normal, unknowns, accepted, limit)
                rough = search.run(rough.logs if rough else logs)
            damping *= 0.1 if stuck else 1.0
            damped = normal + _step_equations(unknowns, poses, places, damping)
            newton = solve(damped, unknowns, limit, accepted, rough.precision)
        if solution is None:
            solution = newton
        else:
            solution = replace(newton, value=solution.value)
            back = _pull_back(unknowns, rough, solution.value)
            solution = newton_step(
                solution, unknowns, cast(Any, systems), whiteners, back, known.right
            )
        before, last = residuals, change
        residuals = residuals_of(cast(Any, systems), solution)
        value = solution.value
        tables = tables_of(machine, unknowns, value)
        change = _change(residuals, before)
        stuck = change > MAX_RATIO_OF_CHANGES * last
        settled = change < config.alignment_stop or (iteration > 6 and change < 1e-8)
        if settled or change <= least:
            least = change
            reached = own, systems, residuals, value, dict(poses), dict(places), iteration
        if settled or iteration == config.max_iterations or change > DIVERGED * least:
            break
        _move(poses, places, unknowns, value)
        solution = replace(solution, value=_without_steps(value, unknowns, poses, places))
        progress('solving', 0.5 * iteration / (iteration + 1))
    own, systems, residuals, value, poses, places, iteration = reached
    columns: list[Any] = [own, systems, whiteners, residuals, *zip(*models, strict=True)]
    solved = tuple(SolvedAxisRun(*row) for row in zip(*columns, strict=True))
    assert rough is not None
    undamped = solve(normal, unknowns, limit, accepted, rough.precision)
    joint = AxisSolution(
        machine, unknowns, replace(undamped, value=value), rough, normal, solved,
        tuple(poses[k] for k in sorted(poses)), places, iteration,
    )  # fmt: skip
    if settled:
        return joint
    raise _unsettled(joint, config, change)


def _unsettled(joint: AxisSolution, config: CalibrationConfig, change: float) -> UnsettledError:
    """Say that a solution does not converge; ``change`` is the last one, m."""
    names = ', '.join(r.run.name for r in joint.runs if r.run.name)
    error = UnsettledError(
        f'{names and names + ": "}the solution did not converge in {config.max_iterations} '
        f'iterations (last change {1e6 * change:.3g} um); the path may not determine the errors'
    )
    error.joint = joint
    return error


def _pull_back(unknowns: Unknowns, rough: Roughness, value: Array) -> Array:
    """Pull of the prior on the free unknowns, those of the motions alone.

    The little that is assumed of the size of all others would move what the data do not show,
    step by step, without an end.
    """
    free = free_values(unknowns, value)
    for name, block in unknowns.free_blocks.items():
        if not is_motion(name):
            free[block] = 0.0
    return np.asarray(rough.precision @ free)


def _change(residuals: Sequence[Array], before: Sequence[Array]) -> float:
    """Largest change of the residuals, m."""
    pairs = zip(residuals, before, strict=True)
    return max(float(np.abs(a - b).max()) for a, b in pairs) if before else np.inf


def _move(
    poses: dict[int, RigidTransform], places: dict[str, Array], unknowns: Unknowns, value: Array
) -> None:
    """Move poses and places by a solution."""
    for k in poses:
        step = value[unknowns.blocks[pose_block(k)]]
        poses[k] = poses[k].moved_by(step[:3], step[3:])
    for name in places:
        if place_block(name) in unknowns.blocks:
            places[name] = places[name] + value[unknowns.blocks[place_block(name)]]


def _without_steps(
    value: Array, unknowns: Unknowns, stations: Iterable[int], places: Iterable[str]
) -> Array:
    """Values of the unknowns once poses and places have been moved by theirs."""
    remainder = value.copy()
    for name in (*map(pose_block, stations), *map(place_block, places)):
        if name in unknowns.blocks:
            remainder[unknowns.blocks[name]] = 0.0
    return remainder
