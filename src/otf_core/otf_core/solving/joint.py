# SPDX-License-Identifier: Apache-2.0
"""Joint solution of runs: common tables, a pose for every place of the tracker, places of targets.

Places of targets that are not known are unknowns like the poses. What the data do not show, poses
and places follow in damped steps, and what they do not show of the motions, smoothness supplies.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.motions import is_location
from otf_core.model.path import leg_bounds
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.pieces.pieces import MIN_OUTLIER, RAYLEIGH_MEDIAN
from otf_core.pieces.runs import AnyRun, Observed, errors_of
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.solution import Solution, identifiable_blocks, solve
from otf_core.solving.system import System, build_system
from otf_core.solving.unknowns import (
    PLACE,
    Basis,
    Unknowns,
    free_values,
    is_step,
    layout,
    place_block,
    pose_block,
)
from otf_core.solving.variance_components import FittedNoise, fit_noise, is_same_noise
from otf_core.solving.whitener import Whitener

MAX_REPETITIONS = 4
"""Repeated solutions; bad pieces bend the tables at first and hide others."""
MIN_PIECE_OUTLIER = 2e-6
"""m; pieces that are off by less are never left out."""
NEIGHBOUR_SHARE = 0.5
"""Share of the limit from which a piece beside one that is left out is left out as well."""
MAX_FAR_SHARE = 0.05
"""Share of the pieces that may be left out for their distance alone: what holds for a part of the
run is no outlier."""
MAX_RATIO_OF_CHANGES = 0.5
"""Share of the change before that a change has to fall below, or the normal matrix is made anew:
once the poses have moved, it is another one for what the data hardly show."""
DAMPED = 1e-4
"""m and rad; what the data do not show, poses and places follow in steps of little more than this,
or of a tenth where the steps do not become smaller."""
DIVERGED = 100.0
"""Ratio of a change to the least one from which it is given up."""
MAX_JUDGED_PIECES = 3000
"""Pieces, about, that tell what the data determine."""
GOLDEN = 0.6180339887498949
PARTS_PER_INTERVAL = 8
"""Parts of an interval between knots in tables for use inside."""


@dataclass(frozen=True)
class SolvedRun:
    """One run at the solution.

    Attributes
    ----------
    run : Observed
        With the pose of the solution and the places of its targets.
    residual : ndarray, shape (c, p), m
        Deviation less model.
    """

    run: Observed
    system: System
    whitener: Whitener
    residual: Array

    @property
    def pose(self) -> RigidTransform:
        """Tracker to the link that it stands on."""
        return self.run.pose


@dataclass(frozen=True)
class JointSolution:
    """Solution of all runs.

    Attributes
    ----------
    normal : NormalEquations
        Of what was solved for and of what is known of the places of targets, in an iteration, or
        in the last, see ``settle_covariance``.
    """

    unknowns: Unknowns
    solution: Solution
    roughness: Roughness
    normal: NormalEquations
    runs: tuple[SolvedRun, ...]
    iterations: int

    @property
    def machine(self) -> Machine:
        """Of the first run; targets and trackers of the others may differ."""
        return self.runs[0].run.machine

    @property
    def places(self) -> dict[str, Array]:
        """Places of the targets that were seen, m."""
        return common_places([solved.run for solved in self.runs])


class UnsettledError(InputError):
    """A solution that does not converge; ``joint`` is the one that changed least."""

    joint: JointSolution

    def __reduce__(self) -> tuple[type[UnsettledError], tuple[str]]:
        """Return what crosses to another process: the words alone."""
        return UnsettledError, (str(self),)


@dataclass(frozen=True)
class Start:
    """What an earlier solution found that a later one of the same blocks starts from.

    Attributes
    ----------
    logs : mapping of motion to ndarray
        See ``roughness.Roughness``.
    accepted : tuple of str
        Blocks that the data determine.
    tables : ErrorTables, optional
        For the positions on the paths.
    """

    logs: Mapping[str, Array]
    accepted: tuple[str, ...]
    tables: ErrorTables | None = None

    @classmethod
    def after(cls, machine: Machine, joint: JointSolution) -> Start:
        """What a solution found."""
        tables = tables_of(machine, joint.unknowns, joint.solution)
        return cls(joint.roughness.logs, joint.solution.accepted, tables)


def tables_of(machine: Machine, unknowns: Unknowns, solution: Solution) -> ErrorTables:
    """Error tables of a solution, fine enough for linear interpolation to cost nothing.

    For use inside; what is written has the nodes and the gauge of ``tabulate``.
    """
    cover = solution.covariance
    motions: dict[str, MotionTable] = {}
    for name in machine.motions:
        block, basis = unknowns.blocks[name], unknowns.bases[name.axis]
        position = basis.finer(1 if basis.degree == 1 else PARTS_PER_INTERVAL)
        rows, seen = basis.matrix(position), name in solution.accepted
        u = np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', rows, cover[block, block], rows), 0.0))
        motions[name] = MotionTable(
            position, rows @ solution.value[block] + 0.0, u if seen else 0.0 * u, seen
        )

    def scalar(name: str) -> tuple[float, float]:
        place = unknowns.blocks[name].start
        return float(solution.value[place]), float(np.sqrt(max(cover[place, place], 0.0)))

    return ErrorTables(
        machine,
        motions,
        {n: ScalarError(*scalar(n)) for n in machine.squareness},
        {n: ScalarError(*scalar(n)) for n in machine.location},
    )


def station_numbers(runs: Sequence[Observed]) -> list[int]:
    """Number of the place of the tracker of every run."""
    moved = [k > 0 and not run.same_station for k, run in enumerate(runs)]
    return [int(k) for k in np.cumsum(moved)]


def common_places(runs: Sequence[Observed]) -> dict[str, Array]:
    """Places of the targets of all runs, those of earlier ones first, m."""
    return {n: place for run in reversed(runs) for n, place in run.places.items()}


def unknowns_of(
    runs: Sequence[Observed],
    bases: Mapping[str, Basis],
    reversal: Sequence[str] = (),
    lags: Sequence[str] = (),
    *,
    held: bool = False,
) -> Unknowns:
    """Unknowns of runs: their poses and places of targets, and motions made of some functions.

    Parameters
    ----------
    bases, reversal, lags, held
        As of ``unknowns.layout``.
    """
    seen = {name for run in runs for name in run.targets}
    free = [n for n, target in runs[0].machine.targets.items() if n in seen and target.u > 0.0]
    stations = station_numbers(runs)[-1] + 1
    return layout(bases, stations, reversal, targets=free, lags=lags, held=held)


def systems_of(
    runs: Sequence[Observed], unknowns: Unknowns, tables: ErrorTables | None
) -> list[System]:
    """Rows of all runs at their poses, at positions on the paths for some tables."""
    pairs = zip(runs, station_numbers(runs), strict=True)
    return [build_system(run, unknowns, tables, station=k) for run, k in pairs]


def sum_normal_equations(
    systems: Sequence[System],
    unknowns: Unknowns,
    whiteners: Sequence[Whitener],
    blocks: Collection[str] | None = None,
) -> NormalEquations:
    """Sum up the normal equations of the lines of all runs, of some ``blocks`` or of all.

    Rows of two passes over a line are those of the first: good for what is compared or repeated.
    """
    pairs = zip(systems, whiteners, strict=True)
    return reduce(add, (normal_equations(s, unknowns, w, blocks) for s, w in pairs))


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


def step_equations(unknowns: Unknowns, size: float) -> NormalEquations:
    """Steps of poses and places of some size, m and rad, as normal equations.

    Poses alone need none: only places and lines of axes trade with them.
    """
    matrix, right = np.zeros((unknowns.free, unknowns.free)), np.zeros(unknowns.free)
    trade = any(is_location(n) or n.startswith('place ') for n in unknowns.blocks)
    for name, block in unknowns.free_blocks.items():
        if trade and is_step(name):
            own = np.arange(block.start, block.stop)
            matrix[own, own] = 1.0 / size**2
    return NormalEquations(matrix, right, 0.0, 0)


def moved_runs(runs: Sequence[AnyRun], unknowns: Unknowns, value: Array) -> list[AnyRun]:
    """Runs with poses and places moved by the steps that a solution has for them."""
    moved = []
    for run, station in zip(runs, station_numbers(runs), strict=True):
        step = value[unknowns.blocks[pose_block(station)]]
        places = {
            name: place + value[unknowns.blocks[place_block(name)]]
            if place_block(name) in unknowns.blocks
            else place
            for name, place in run.places.items()
        }
        moved.append(replace(run, pose=run.pose.moved_by(step[:3], step[3:]), places=places))
    return moved


def solve_robustly(
    runs: Sequence[AnyRun],
    unknowns: Unknowns,
    config: CalibrationConfig,
    progress: Progress,
    start: Start | None = None,
) -> tuple[list[AnyRun], JointSolution]:
    """Solve, leave out pieces far from the solution, fit the noise, solve again.

    Bursts of bad samples longer than the window of the outlier test, and corners rounded beyond
    ``corner_exclusion``, show as pieces many robust standard deviations off.

    Parameters
    ----------
    runs, unknowns, config, progress, start
        As of ``solve_jointly``.

    Returns
    -------
    runs : list, as given
        With the pieces that were kept, and noise and misfit fitted to the residuals.
    solution : JointSolution
    """
    runs = list(runs)
    for _ in range(MAX_REPETITIONS):
        joint = solve_jointly(runs, unknowns, config, progress, start)
        better, settled_now = improve_runs(runs, joint, config)
        if settled_now:
            return runs, joint
        start, runs = Start.after(runs[0].machine, joint), better
        del joint  # as large as the next one
    return runs, solve_jointly(runs, unknowns, config, progress, start)


def improve_runs(
    runs: Sequence[AnyRun], joint: JointSolution, config: CalibrationConfig
) -> tuple[list[AnyRun], bool]:
    """Runs less pieces far from their solution, with noise fitted to its residuals.

    Returns
    -------
    runs : list, as given
        With the poses and places of the solution.
    settled : bool
        Nothing was left out, and the noise has not changed.
    """
    pairs, limit = list(zip(runs, joint.runs, strict=True)), config.outlier_limit
    drop = [far_pieces(s.residual, r.pieces.leg, limit) for r, s in pairs]
    fitted = [fit_run_noise(r, s, joint) for r, s in pairs]
    same = not any(d.any() for d in drop) and all(
        r.fitted is not None and is_same_noise(f, r.fitted)
        for f, r in zip(fitted, runs, strict=True)
    )
    better = [
        replace(r, pieces=r.pieces.without(d), fitted=f.logs, pose=s.pose, places=s.run.places)
        for r, d, f, s in zip(runs, drop, fitted, joint.runs, strict=True)
    ]
    return better, same


def fit_run_noise(run: Observed, solved: SolvedRun, joint: JointSolution) -> FittedNoise:
    """Noise and misfit fitted to the residuals of one run, see ``fit_noise``."""
    return fit_noise(
        solved.system,
        run.pieces,
        solved.residual,
        run.noise,
        joint.solution.covariance,
        run.fitted,
    )


def far_pieces(residual: Array, leg: Index, limit: float) -> NDArray[np.bool_]:
    """Pieces far from the solution, or from their leg, and what trails off beside them.

    What holds for a whole leg is no bad piece but an effect. A corner that the control rounds
    fades out along the leg: its last part is no outlier by itself.
    """
    own = residual.copy()
    for low, high in leg_bounds(leg):
        if high - low > 2:
            own[:, low:high] -= np.median(residual[:, low:high], axis=1, keepdims=True)
    distance, beyond = (np.linalg.norm(v, axis=0) for v in (own, residual))
    sigma, whole = (float(np.median(v)) / RAYLEIGH_MEDIAN for v in (distance, beyond))
    far = distance > max(limit * sigma, MIN_PIECE_OUTLIER)
    out = beyond > max(limit * whole, MIN_OUTLIER)
    if np.mean(out) < MAX_FAR_SHARE:
        far |= out
    same = leg[1:] == leg[:-1]
    beside = np.zeros_like(far)
    beside[1:] |= far[:-1] & same
    beside[:-1] |= far[1:] & same
    return np.asarray(far | (beside & (distance > NEIGHBOUR_SHARE * limit * sigma)))


def solve_jointly(
    runs: Sequence[Observed],
    unknowns: Unknowns,
    config: CalibrationConfig,
    progress: Progress,
    start: Start | None = None,
) -> JointSolution:
    """Solve, move poses and places, re-derive the positions on the paths; until nothing changes.

    Parameters
    ----------
    progress : callable(stage, fraction)
    start : Start, optional
        What an earlier solution of the same blocks found.

    Raises
    ------
    UnsettledError
        If the solution does not settle.
    """
    machine, limit = runs[0].machine, config.unidentifiable_above
    tables, logs = (start.tables, start.logs) if start else (None, None)
    own, unsettled = list(runs), not logs
    accepted = start.accepted if start else find_identifiable_blocks(runs, unknowns, limit)
    whiteners: list[Whitener] = []
    residuals: list[Array] = []
    solution: Solution | None = None
    rough: Roughness | None = None
    change, least, stuck, damping = np.inf, np.inf, False, DAMPED
    for iteration in range(1, config.max_iterations + 1):
        systems = systems_of(own, unknowns, tables)
        whiteners = whiteners or whiteners_of(own, systems)
        known = place_equations(machine, unknowns, common_places(own))
        anew = iteration == 1 or (iteration == 2 and unsettled)
        if anew or stuck:
            normal = sum_normal_equations(systems, unknowns, whiteners, accepted) + known
            if anew:
                search = Search(normal, unknowns, accepted, limit)
                rough = search.run(rough.logs if rough else logs)
            assert rough is not None, 'of the first iteration'
            damping *= 0.1 if stuck else 1.0
            damped = normal + step_equations(unknowns, damping)
            newton = solve(damped, unknowns, limit, accepted, rough.precision)
        if solution is None:
            solution = newton
        else:
            assert rough is not None
            solution = replace(newton, value=solution.value)
            pull_back = _pull_back(unknowns, rough, solution.value)
            solution = newton_step(solution, unknowns, systems, whiteners, pull_back, known.right)
        before, residuals, last = residuals, residuals_of(systems, solution), change
        pairs = zip(residuals, before, strict=False)
        change = max((float(np.abs(a - b).max()) for a, b in pairs), default=np.inf)
        stuck = change > MAX_RATIO_OF_CHANGES * last
        settled = change < config.alignment_stop
        if settled or change <= least:
            least = change
            reached = own, systems, residuals, solution.value, iteration
        if settled or not change <= DIVERGED * least:
            break
        own = moved_runs(own, unknowns, solution.value)
        value = solution.value.copy()
        for name, block in unknowns.blocks.items():
            value[block] *= not is_step(name)
        solution = replace(solution, value=value)
        tables = tables_of(machine, unknowns, solution)
        progress('solving', iteration / (iteration + 1))
    assert rough is not None
    own, systems, residuals, value, iteration = reached
    undamped = solve(normal, unknowns, limit, accepted, rough.precision)
    solved = zip(own, systems, whiteners, residuals, strict=True)
    of_runs = tuple(SolvedRun(*parts) for parts in solved)
    solution = replace(undamped, value=value)
    joint = JointSolution(unknowns, solution, rough, normal, of_runs, iteration)
    if settled:
        return joint
    raise _unsettled(joint, config, change)


def _unsettled(joint: JointSolution, config: CalibrationConfig, change: float) -> UnsettledError:
    """Say that a solution does not converge; ``change`` is the last one, m."""
    names = ', '.join(solved.run.name for solved in joint.runs if solved.run.name)
    error = UnsettledError(
        f'{names and names + ": "}the solution did not converge in {config.max_iterations} '
        f'iterations (last change {1e6 * change:.3g} um); the path may not determine the errors'
    )
    error.joint = joint
    return error


def settle_covariance(
    joint: JointSolution, limit: float, normal: NormalEquations | None = None
) -> JointSolution:
    """Take the covariance of all passes at the last positions on the paths.

    Contributions that are alike for the whole run are so much larger than the noise that they
    would show the difference.

    Parameters
    ----------
    limit : float
        ``unidentifiable_above``.
    normal : NormalEquations, optional
        Of the rows of all passes, where known.
    """
    old, of = joint.solution, joint.unknowns
    sums = (normal_equations(s.system, of, s.whitener, old.accepted) for s in joint.runs)
    normal = (normal or reduce(add, sums)) + place_equations(joint.machine, of, joint.places)
    last = solve(normal, of, limit, old.accepted, joint.roughness.precision)
    return replace(joint, normal=normal, solution=replace(old, covariance=last.covariance))


def whiteners_of(runs: Sequence[Observed], systems: Sequence[System]) -> list[Whitener]:
    """Whiteners of all runs for their noise as far as it is known."""
    whiteners = []
    for system, run in zip(systems, runs, strict=True):
        with errors_of(run.name):
            whiteners.append(Whitener.of(system, run.pieces, *run.noise_and_misfit))
    return whiteners


def _thinned(runs: Sequence[AnyRun]) -> list[AnyRun]:
    """Every n-th piece of every leg, others in each leg: about ``MAX_JUDGED_PIECES`` of all."""
    step = -(-sum(len(run.pieces) for run in runs) // MAX_JUDGED_PIECES)
    thinned = []
    for run in runs:
        low, high = np.array(leg_bounds(run.pieces.leg)).T
        # multiples of the golden section keep no step with the order of a path
        part = np.arange(len(low)) * GOLDEN % 1.0
        first = low + (np.minimum(step, high - low) * part).astype(np.int64)
        drop = (np.arange(len(run.pieces)) - np.repeat(first, high - low)) % step != 0
        thinned.append(replace(run, pieces=run.pieces.without(drop)))
    return thinned


def find_identifiable_blocks(
    runs: Sequence[AnyRun], unknowns: Unknowns, limit: float
) -> tuple[str, ...]:
    """Blocks of unknowns that the data determine, to ``limit``, ``unidentifiable_above``.

    Some of the pieces stand for all: what the data determine, they determine many times over.
    """
    some = _thinned(runs)
    judged = [
        build_system(run, unknowns, station=k, nodal_lever=True)
        for run, k in zip(some, station_numbers(some), strict=True)
    ]
    normal = sum_normal_equations(judged, unknowns, whiteners_of(some, judged))
    share = sum(len(run.pieces) for run in some) / sum(len(run.pieces) for run in runs)
    known = place_equations(runs[0].machine, unknowns, common_places(runs))
    normal = replace(normal, matrix=normal.matrix / share + known.matrix)
    return identifiable_blocks(normal, unknowns, limit)


def residuals_of(systems: Sequence[System], solution: Solution) -> list[Array]:
    """What a solution leaves of the deviations of every run, (c, p), m."""
    return [s.deviation - s.rows.times(solution.value) for s in systems]


def _pull_back(unknowns: Unknowns, rough: Roughness, value: Array) -> Array:
    """Pull of the prior on the free unknowns, but for what poses and places can follow.

    The little that is assumed of the size of location errors would move what the data do not show,
    step by step, without an end.
    """
    free = free_values(unknowns, value)
    for name, block in unknowns.free_blocks.items():
        if is_step(name) or is_location(name):
            free[block] = 0.0
    return np.asarray(rough.precision @ free)


def newton_step(
    solution: Solution,
    unknowns: Unknowns,
    systems: Sequence[System],
    whiteners: Sequence[Whitener],
    pull_back: Array,
    known: Array | float = 0.0,
) -> Solution:
    """One Newton step with the normal matrix of an earlier iteration, which hardly changes.

    With C the covariance of the solution and K^-1 the precision of the prior, the estimates x
    move by C (A^T W (y - A x) + b - K^-1 x).

    Parameters
    ----------
    pull_back : ndarray, shape (free,)
        K^-1 x.
    known : ndarray, shape (free,), optional
        b, right side of the normal equations of what is known beside the rows.
    """
    pull = np.zeros(unknowns.full)
    for system, whitener, rest in zip(
        systems, whiteners, residuals_of(systems, solution), strict=True
    ):
        pull += system.rows.transposed(whitener.weighted(rest))
    step = unknowns.gauge.T @ pull + known - pull_back
    lifted = free_values(unknowns, solution.covariance.T).T  # C as full by free
    return replace(solution, value=solution.value + lifted @ step)
