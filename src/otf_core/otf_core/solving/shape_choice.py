# SPDX-License-Identifier: Apache-2.0
"""Which functions the error motions are made of: smooth, finer, or straight between the nodes.

Smooth functions over ``INTERVALS`` parts of every axis are compared with tables that are linear
between the nodes of machine.yaml: a machine that its control compensates with such tables has
kinks there. Where neighbouring pieces of a line differ from the better of both by more than the
noise allows, it cannot follow something, and splines over twice as many parts are tried as well.
The functions with the largest restricted likelihood are taken, the size of the residuals free:

    L = -1/2 ( n log S + log det(N + K^-1) + log det K ),   S weighted sum of squares of n rows
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Generic

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.aside import shared_out
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.frames import RigidTransform
from otf_core.pieces.runs import AnyRun, Observed
from otf_core.solving.basis import Basis, cubic, linear
from otf_core.solving.joint import (
    JointSolution,
    SolvedRun,
    Start,
    find_identifiable_blocks,
    improved_runs,
    left_by,
    solve_jointly,
    summed,
    systems_of,
    whiteners_of,
)
from otf_core.solving.normal import NormalEquations
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.solution import Solution, solve
from otf_core.solving.system import System
from otf_core.solving.unknowns import Unknowns, layout
from otf_core.solving.whitener import Whitener

Bases = dict[str, Basis]

SMOOTH, FINER = 'smooth', 'smooth, twice as fine'
STRAIGHT = 'straight between nodes'
INTERVALS = 20
"""Parts of an axis range: cubic splines then follow eight waves to 1 % of their size."""
SIGNIFICANT = 4.0
"""Standard deviations of the mean."""
NOTABLE = 0.05
"""Share of the variance of a step between pieces."""
FEW = 3000
"""Pieces that the first solution is made of, which finds poses and positions on the paths."""
LEGS = 20
"""Fewer legs, however long, are not enough for that."""
QUICK = 8
"""Iterations after which that is given up for one of all pieces: so few legs are not enough."""
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class ShapeChoice(Generic[AnyRun]):
    """Functions for the error motions, and what was solved with them.

    Attributes
    ----------
    bases : mapping of axis to Basis
    runs : list of Observed
        With poses to start from.
    improved : list of Observed
        The same after one linear solution, see ``joint.improved_runs``.
    start : Start
        What that found.
    evidence : mapping of name to float
        Restricted log likelihood of everything that was tried, less the best.
    """

    bases: Bases
    runs: list[AnyRun]
    improved: list[AnyRun]
    start: Start
    evidence: Mapping[str, float]


def smooth_bases(nodes: Mapping[str, Array], parts: int = INTERVALS) -> Bases:
    """Cubic splines over equal parts of the range of the nodes of every axis."""
    return {axis: cubic(at, parts) for axis, at in nodes.items()}


def is_finer(bases: Bases) -> bool:
    """Tell whether these are the functions that are tried where others leave steps."""
    return any(b.degree > 1 and len(b.knots) > INTERVALS + 1 for b in bases.values())


def linear_bases(nodes: Mapping[str, Array]) -> Bases:
    """Functions that are linear between the nodes of every axis."""
    return {axis: linear(at) for axis, at in nodes.items()}


def _steps_unexplained(solved: SolvedRun) -> bool:
    """Tell whether neighbouring pieces of a line differ by more than the noise."""
    found = []
    for alike in solved.whitener.alike:
        noise = alike.moments.step.ravel()
        step = np.diff(solved.residual[:, alike.pieces]).ravel() ** 2
        found.append(np.stack([step - noise, noise]))
    excess, noise = np.concatenate(found, axis=1)
    if not excess.size:  # stops: no two pieces of one line that could tell
        return True
    excess = np.minimum(excess, 20.0 * float(np.mean(np.abs(excess))))
    mean, scatter = float(np.mean(excess)), float(np.std(excess)) / np.sqrt(excess.size)
    return mean > SIGNIFICANT * scatter and mean > NOTABLE * float(np.mean(noise))


def choose_shapes(
    runs: Sequence[AnyRun],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    progress: Progress,
) -> ShapeChoice[AnyRun]:
    """Choose the functions that the motions are made of.

    Parameters
    ----------
    runs : sequence of Observed
    nodes : mapping of axis to ndarray, m
        Of the tables that machine.yaml asks for.
    config : CalibrationConfig
    progress : callable(stage, fraction)
    """
    limit = config.unidentifiable_above
    smooth = layout(smooth_bases(nodes), len(runs))
    whiteners = whiteners_of(runs, systems_of(runs, [r.pose for r in runs], smooth, None))
    seen = find_identifiable_blocks(runs, smooth, whiteners, limit)
    start, poses = _started(runs, smooth, Start({}, seen), config, progress)
    moved = [replace(r, pose=p) for r, p in zip(runs, poses, strict=True)]
    best, scores = _try_all(moved, nodes, start, whiteners, limit)
    improved = improved_runs(moved, best, config)[0]
    after = Start.after(runs[0].machine, best)
    return ShapeChoice(best.unknowns.bases, moved, improved, after, scores)


_CHOICES: dict[str, Callable[[Mapping[str, Array]], Bases]] = {
    SMOOTH: smooth_bases,
    FINER: partial(smooth_bases, parts=2 * INTERVALS),
    STRAIGHT: linear_bases,
}


def _started(
    runs: Sequence[AnyRun],
    smooth: Unknowns,
    start: Start,
    config: CalibrationConfig,
    progress: Progress,
) -> tuple[Start, list[RigidTransform]]:
    """First tables and poses."""
    quick, first = replace(config, max_iterations=min(QUICK, config.max_iterations)), None
    some = _thinned(runs)
    if sum(_leg_number(run)[-1] + 1 for run in some) >= LEGS:
        with suppress(InputError):  # too few legs
            first = solve_jointly(some, smooth, quick, progress, start)
    first = first or solve_jointly(runs, smooth, config, progress, start)
    return Start.after(runs[0].machine, first), [solved.pose for solved in first.runs]


def _try_all(
    runs: Sequence[Observed],
    nodes: Mapping[str, Array],
    start: Start,
    whiteners: Sequence[Whitener],
    limit: float,
) -> tuple[JointSolution, dict[str, float]]:
    """Linear solutions with some functions, and with finer ones where the best leaves steps.

    Returns
    -------
    solution : JointSolution
        The most likely one.
    scores : mapping of name to float
        Log likelihoods, less the best.
    """
    poses = [r.pose for r in runs]
    systems = systems_of(runs, poses, layout(smooth_bases(nodes), len(runs)), start.tables)

    def fit(name: str) -> _Tried:
        return _tried(systems, start, whiteners, limit, _CHOICES[name](nodes))

    first = (SMOOTH, STRAIGHT)
    fits = shared_out(fit, first, (systems, start, whiteners))
    tried = dict(zip(first, fits, strict=True))
    best = max(fits, key=attrgetter('likelihood'))
    solution = best.solved(systems, poses, whiteners)
    if any(_steps_unexplained(run) for run in solution.runs):
        tried[FINER] = fit(FINER)
        if tried[FINER].likelihood > best.likelihood:
            best = tried[FINER]
            solution = best.solved(systems, poses, whiteners)
    return solution, {name: one.likelihood - best.likelihood for name, one in tried.items()}


def _without_legs(run: AnyRun, number: Index, kept: Index) -> AnyRun:
    drop = ~np.isin(number, kept)
    return replace(run, pieces=run.pieces.without(drop)) if drop.any() else run


def _leg_number(run: Observed) -> Index:
    """Which leg in driving order a piece belongs to, shape (p,)."""
    return np.asarray(np.cumsum(np.append(0, np.diff(run.pieces.leg) != 0)))


def _thinned(runs: Sequence[AnyRun]) -> list[AnyRun]:
    """Some legs of every run, spread evenly: enough for poses and first tables."""
    share, found = FEW // len(runs), []
    for run in runs:
        number = _leg_number(run)
        # multiples of the golden section keep no step with the order of a path
        order = np.argsort((np.arange(number[-1] + 1) * GOLDEN) % 1.0)
        size = np.cumsum(np.bincount(number)[order])
        found.append(_without_legs(run, number, order[: int(np.searchsorted(size, share)) + 1]))
    return found


@dataclass(frozen=True)
class _Tried:
    """One linear solution, without what it leaves of the deviations."""

    unknowns: Unknowns
    solution: Solution
    roughness: Roughness
    normal: NormalEquations

    @property
    def likelihood(self) -> float:
        """Restricted log likelihood with the size of the residuals free."""
        rough = self.roughness
        volume = -2.0 * rough.log_likelihood - rough.square
        return -0.5 * (self.normal.rows * float(np.log(rough.square)) + volume)

    def solved(
        self,
        systems: Sequence[System],
        poses: Sequence[RigidTransform],
        whiteners: Sequence[Whitener],
    ) -> JointSolution:
        """With what it leaves of the rows of any functions at the same poses and positions."""
        own = [s.of_unknowns(self.unknowns) for s in systems]
        left = left_by(own, self.solution)
        own = [replace(s, rows=s.rows.released()) for s in own]
        parts = zip(poses, own, whiteners, left, strict=True)
        runs = tuple(SolvedRun(*p) for p in parts)
        return JointSolution(self.unknowns, self.solution, self.roughness, self.normal, runs, 1)


def _tried(
    systems: Sequence[System],
    start: Start,
    whiteners: Sequence[Whitener],
    limit: float,
    bases: Bases,
) -> _Tried:
    """One linear solution at the poses and positions of rows of any functions."""
    unknowns = layout(bases, len(systems))
    own = [s.of_unknowns(unknowns) for s in systems]
    normal = summed(own, unknowns, whiteners, start.accepted)
    rough = Search(normal, unknowns, start.accepted, limit).run(start.logs)
    solution = solve(normal, unknowns, limit, start.accepted, rough.precision)
    return _Tried(unknowns, solution, rough, normal)
