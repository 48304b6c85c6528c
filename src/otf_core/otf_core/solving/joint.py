# SPDX-License-Identifier: Apache-2.0
"""Joint solution of runs: common tables, one pose per run, noise as the residuals show it.

Standstills show the noise of the tracker at rest, some of it for too short a time, and nothing of
model errors. So the sizes of five parts of the covariance S of a line are fitted: white and slow
noise of the tracker, its correlation time, misfit of single pieces and of whole lines. Their
logarithms (of factors, for the tracker) maximise the restricted likelihood: with e the residual
of a solution whose estimates have the posterior covariance V, E[e e^T] = S - A V A^T, and for K =
dS by a logarithm

    score = (e^T S^-1 K S^-1 e - tr P K) / 2,  P = S^-1 - S^-1 A V A^T S^-1,
    information = tr(P K P K') / 2

The prior is what standstills or the specification state.

References
----------
Harville, J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood).
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
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.path import leg_bounds
from otf_core.model.tables import ErrorTables, MotionTable, Squareness
from otf_core.noise.noise_model import (
    INDEPENDENT,
    LASTING,
    MODEL_FLOOR,
    SLOW,
    WHITE,
    NoiseModel,
    Windows,
    add_to_diagonal,
    covariance_parts,
    misfit_of,
    noise_covariance,
    scale_noise,
)
from otf_core.pieces.pieces import MIN_OUTLIER, RAYLEIGH_MEDIAN, Pieces
from otf_core.pieces.runs import AnyRun, Observed, errors_of
from otf_core.solving.design import Design
from otf_core.solving.normal import NormalEquations, normal_equations
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.solution import Solution, identifiable_blocks, solve
from otf_core.solving.system import System, build_system
from otf_core.solving.unknowns import Unknowns, free_values, pose_block
from otf_core.solving.whitener import Whitener

PRIOR_SIGMAS = np.array([0.7, 0.7, 0.7, 5.0, 5.0])
"""Standard deviation of the logarithms of the four variances and of the correlation time."""
LOWER_BOUNDS = np.array([-4.0, -6.0, np.log(1.0 / 30.0), np.log(4e-16), np.log(4e-16)])
UPPER_BOUNDS = np.array([8.0, 8.0, np.log(200.0), np.log(1e-6), np.log(1e-6)])
MAX_LINES, MAX_PIECES_PER_LINE = 48, 100
"""Lines and pieces of each that are used: five numbers need no more."""
MAX_STEPS = 6
MAX_STEP = 1.5
FINAL_STEP, FINAL_SHARE_OF_SIGMA = 0.03, 0.3
"""Steps that are smaller, or than this share of their standard deviation, end the search."""
_DIAGONAL = (WHITE, INDEPENDENT)
"""Parts of the covariance without any between pieces."""
_DERIVATIVE = 1e-3
_LONGER = np.array([0.0, 0.0, np.log1p(_DERIVATIVE)])


@dataclass(frozen=True)
class FittedNoise:
    """Sizes of noise and misfit.

    Attributes
    ----------
    logs : ndarray, shape (5,)
        For ``noise_model.scale_noise`` and ``noise_model.misfit_of``.
    u : ndarray, shape (5,)
        Their standard uncertainties.
    """

    logs: Array
    u: Array


@dataclass(frozen=True)
class _Lines:
    """Parts of lines, n of them of m pieces, all c components.

    Attributes
    ----------
    shares : ndarray, shape (3, c, n, m)
        See ``noise_model.beam_shares``.
    windows : tuple of time, duration (s) and count, each of shape (n, m)
    residual : ndarray, shape (c, n, m), m
    explained : ndarray, shape (c, n, m, m), m^2
        A V A^T.
    """

    shares: Array
    windows: Windows
    residual: Array
    explained: Array


def _lines(system: System, pieces: Pieces, residual: Array, covariance: Array) -> list[_Lines]:
    bounds = [(low, min(high, low + MAX_PIECES_PER_LINE)) for low, high in leg_bounds(pieces.leg)]
    chosen = np.unique(np.linspace(0, len(bounds) - 1, MAX_LINES).round().astype(int))
    low, high = np.array(bounds)[chosen].T

    def of_size(size: int) -> _Lines:
        own = low[high - low == size, None] + np.arange(size)
        explained = _explained(system.rows, own, covariance)
        windows = (pieces.time[own], pieces.duration[own], pieces.count[own])
        return _Lines(system.shares[:, :, own], windows, residual[:, own], explained)

    return [of_size(size) for size in np.unique(high - low).tolist()]


def _explained(rows: Design, lines: Index, covariance: Array) -> Array:
    """A V A^T of the pieces (n, m) of lines, shape (c, n, m, m), m^2."""
    use, flat = rows.touched(lines.ravel())
    own = flat.reshape(len(flat), *lines.shape, len(use))
    half = (flat @ covariance[np.ix_(use, use)]).reshape(own.shape)
    return np.asarray(half @ np.swapaxes(own, -1, -2))


def _derivatives(noise: NoiseModel, logs: Array, lines: _Lines) -> list[Array]:
    """Parts of the covariance by their places, (..., m) where diagonal, else (..., m, m), m^2."""
    now, misfit = scale_noise(noise, logs), misfit_of(logs)
    white, slow, independent, lasting = covariance_parts(now, misfit, lines.shares, lines.windows)
    longer = scale_noise(now, _LONGER)
    other = noise_covariance(longer, lines.shares, lines.shares, lines.windows)[1]
    return [white, slow, (other - slow) / _DERIVATIVE, independent, lasting]


def _slopes(noise: NoiseModel, logs: Array, groups: list[_Lines]) -> tuple[Array, Array]:
    """Score and information of the logarithms, prior left out."""
    parts = [_slopes_of(noise, logs, lines) for lines in groups]
    score, information = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    return score, information


def _slopes_of(noise: NoiseModel, logs: Array, lines: _Lines) -> tuple[Array, Array]:
    """What some lines add to the score and to the information."""
    parts = _derivatives(noise, logs, lines)
    whole = add_to_diagonal(parts[SLOW] + parts[LASTING], parts[WHITE] + parts[INDEPENDENT])
    inverse = np.linalg.inv(whole)
    P = inverse - inverse @ lines.explained @ inverse
    pull = inverse @ lines.residual[..., None]
    moved, pulled = np.empty((len(parts), *P.shape)), np.empty(len(parts))
    for k, K in enumerate(parts):
        if k in _DIAGONAL:
            np.multiply(P, K[..., None, :], out=moved[k])
            pulled[k] = np.sum(pull * (K[..., None] * pull))
        else:
            np.matmul(P, K, out=moved[k])
            pulled[k] = np.sum(pull * (K @ pull))
    trace = np.trace(moved, axis1=-2, axis2=-1).sum(axis=(1, 2))
    score = 0.5 * (pulled - trace)
    turned = np.ascontiguousarray(np.swapaxes(moved, -1, -2)).reshape(len(parts), -1)
    return score, 0.5 * (moved.reshape(len(parts), -1) @ turned.T)


def fit_noise(
    system: System,
    pieces: Pieces,
    residual: Array,
    noise: NoiseModel,
    covariance: Array,
    start: Array | None = None,
) -> FittedNoise:
    """Fit the sizes of noise and misfit to the residuals of a run.

    Parameters
    ----------
    residual : ndarray, shape (c, p), m
    noise : NoiseModel
        From standstills or specification; the prior.
    covariance : ndarray, shape (full, full)
        Posterior covariance of the estimates.
    start : ndarray, shape (5,), optional
    """
    floor = 2.0 * np.log(MODEL_FLOOR)
    prior = np.array([0.0, 0.0, 0.0, floor, floor])
    logs = prior.copy() if start is None else start
    lines = _lines(system, pieces, residual, covariance)
    share, last = 1.0, np.zeros(len(logs))
    for _ in range(MAX_STEPS):
        score, information = _slopes(noise, logs, lines)
        score -= (logs - prior) / PRIOR_SIGMAS**2
        information += np.diag(1.0 / PRIOR_SIGMAS**2)
        step = np.linalg.solve(information, score)
        share *= 0.5 if step @ last < 0.0 else 1.0  # to and fro: too far each time
        step *= min(share, MAX_STEP / float(np.abs(step).max()))
        moved = np.clip(logs + step, LOWER_BOUNDS, UPPER_BOUNDS)
        last, logs = moved - logs, moved
        known = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.all(np.abs(last) < np.maximum(FINAL_STEP, FINAL_SHARE_OF_SIGMA * known)):
            break
    return FittedNoise(logs, known)


MAX_REPETITIONS = 4
"""Repeated solutions; bad pieces bend the tables at first and hide others."""
MIN_PIECE_OUTLIER = 2e-6
"""m; pieces that are off by less are never left out."""
NEIGHBOUR_SHARE = 0.5
"""Share of the limit from which a piece beside one that is left out is left out as well."""
MAX_RATIO_OF_CHANGES = 0.5
"""Share of the change before that a change has to fall below, or the normal matrix is made anew:
once the poses have moved, it is another one for what the data hardly show."""
NOISE_SETTLED = 0.1
"""Change of the logarithms of noise and misfit below which they count as settled."""
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
    pose : RigidTransform
        Tracker to machine.
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
    normal : NormalEquations
        Of what was solved for, in the first iteration, or in the last, see ``settle_covariance``.
    """

    unknowns: Unknowns
    solution: Solution
    roughness: Roughness
    normal: NormalEquations
    runs: tuple[SolvedRun, ...]
    iterations: int


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

    For use inside; what is written has the nodes of ``tabulate``.
    """
    cover = solution.covariance
    motions: dict[str, MotionTable] = {}
    squareness: dict[str, Squareness] = {}
    for name in MOTIONS:
        block, basis = unknowns.blocks[name], unknowns.bases[name.axis]
        position = basis.finer(1 if basis.degree == 1 else PARTS_PER_INTERVAL)
        rows, seen = basis.matrix(position), name in solution.accepted
        u = np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', rows, cover[block, block], rows), 0.0))
        motions[name] = MotionTable(
            position, rows @ solution.value[block] + 0.0, u if seen else 0.0 * u, seen
        )
    for angle in SQUARENESS:
        place = unknowns.blocks[angle].start
        u_angle = float(np.sqrt(max(cover[place, place], 0.0)))
        squareness[angle] = Squareness(float(solution.value[place]), u_angle)
    return ErrorTables(machine, motions, squareness)


def systems_of(
    runs: Sequence[Observed],
    poses: Sequence[RigidTransform],
    unknowns: Unknowns,
    tables: ErrorTables | None,
) -> list[System]:
    """Rows of all runs at some poses, at positions on the paths for some tables."""
    return [
        build_system(run.machine, run.pieces, pose, unknowns, tables, run=k)
        for k, (run, pose) in enumerate(zip(runs, poses, strict=True))
    ]


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
        With the poses of the solution.
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
        replace(r, pieces=r.pieces.without(d), fitted=f.logs, pose=s.pose)
        for r, d, f, s in zip(runs, drop, fitted, joint.runs, strict=True)
    ]
    return better, same


def is_same_noise(fitted: FittedNoise, before: Array) -> bool:
    """Return whether noise has settled: it changed by little, or by less than is known of it."""
    change = np.abs(fitted.logs - before)
    return bool(np.all(change < np.maximum(NOISE_SETTLED, 0.5 * fitted.u)))


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
        own[:, low:high] -= np.median(residual[:, low:high], axis=1, keepdims=True)
    distance, beyond = (np.linalg.norm(v, axis=0) for v in (own, residual))
    sigma, whole = (float(np.median(v)) / RAYLEIGH_MEDIAN for v in (distance, beyond))
    far = (distance > max(limit * sigma, MIN_PIECE_OUTLIER)) | (
        beyond > max(limit * whole, MIN_OUTLIER)
    )
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
    """Solve, move the poses, re-derive the positions on the paths; until nothing changes.

    Parameters
    ----------
    progress : callable(stage, fraction)
    start : Start, optional
        What an earlier solution of the same blocks found.

    Raises
    ------
    InputError
        If the solution does not settle.
    """
    machine, limit = runs[0].machine, config.unidentifiable_above
    poses = [run.pose for run in runs]
    systems = systems_of(runs, poses, unknowns, start.tables if start else None)
    whiteners = whiteners_of(runs, systems)
    accepted = start.accepted if start else find_identifiable_blocks(runs, unknowns, limit)
    normal = sum_normal_equations(systems, unknowns, whiteners, accepted)
    rough = Search(normal, unknowns, accepted, limit).run(start.logs if start else None)
    solution = solve(normal, unknowns, limit, accepted, rough.precision)
    residuals = residuals_of(systems, solution)
    change, stuck = np.inf, False
    for iteration in range(2, config.max_iterations + 1):
        motion = [solution.value[unknowns.blocks[pose_block(k)]] for k in range(len(runs))]
        poses = [p.moved_by(m[:3], m[3:]) for p, m in zip(poses, motion, strict=True)]
        solution = _without_poses(solution, unknowns, len(runs))
        del systems  # as large as the next ones
        systems = systems_of(runs, poses, unknowns, tables_of(machine, unknowns, solution))
        if stuck:
            normal = sum_normal_equations(systems, unknowns, whiteners, accepted)
            solution = solve(normal, unknowns, limit, accepted, rough.precision)
        else:
            pull_back = rough.precision @ free_values(unknowns, solution.value)
            solution = newton_step(solution, unknowns, systems, whiteners, pull_back)
        before, residuals, last = residuals, residuals_of(systems, solution), change
        change = max(float(np.abs(a - b).max()) for a, b in zip(residuals, before, strict=True))
        stuck = change > MAX_RATIO_OF_CHANGES * last
        progress('solving', iteration / (iteration + 1))
        if not np.isfinite(change):
            break
        if change < config.alignment_stop:
            solved = zip(poses, systems, whiteners, residuals, strict=True)
            of_runs = tuple(SolvedRun(*parts) for parts in solved)
            return JointSolution(unknowns, solution, rough, normal, of_runs, iteration)
    names = ', '.join(run.name for run in runs if run.name)
    raise InputError(
        f'{names and names + ": "}the solution did not converge in {config.max_iterations} '
        f'iterations (last change {1e6 * change:.3g} um); the path may not determine the errors'
    )


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
        Of all passes, where known.
    """
    old, of = joint.solution, joint.unknowns
    sums = (normal_equations(s.system, of, s.whitener, old.accepted) for s in joint.runs)
    normal = normal or reduce(add, sums)
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
        build_system(run.machine, run.pieces, run.pose, unknowns, run=k, nodal_lever=True)
        for k, run in enumerate(some)
    ]
    normal = sum_normal_equations(judged, unknowns, whiteners_of(some, judged))
    share = sum(len(run.pieces) for run in some) / sum(len(run.pieces) for run in runs)
    return identifiable_blocks(replace(normal, matrix=normal.matrix / share), unknowns, limit)


def residuals_of(systems: Sequence[System], solution: Solution) -> list[Array]:
    """What a solution leaves of the deviations of every run, (c, p), m."""
    return [s.deviation - s.rows.times(solution.value) for s in systems]


def _without_poses(solution: Solution, unknowns: Unknowns, runs: int) -> Solution:
    value = solution.value.copy()
    for k in range(runs):
        value[unknowns.blocks[pose_block(k)]] = 0.0
    return replace(solution, value=value)


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
