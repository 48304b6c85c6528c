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
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from otf_core.config import CalibrationConfig
from otf_core.pieces.observed import AnyRun, Observed
from otf_core.solving.basis import Basis, cubic, linear
from otf_core.solving.joint import (
    JointSolution,
    Progress,
    SolvedRun,
    Start,
    left_by,
    seen_blocks,
    solve_jointly,
    summed,
    systems_of,
    whiteners_of,
)
from otf_core.solving.roughness import Search
from otf_core.solving.solution import solve
from otf_core.solving.unknowns import layout
from otf_core.solving.whitener import Whitener

Array = NDArray[np.float64]
Bases = dict[str, Basis]

SMOOTH, FINER = 'smooth', 'smooth, twice as fine'
STRAIGHT = 'straight between nodes'
FIRST_TRIED = (SMOOTH, STRAIGHT)
INTERVALS = 20
"""Parts of an axis range: cubic splines then follow eight waves to 1 % of their size."""
SIGNIFICANT = 4.0
"""Standard deviations of the mean."""
NOTABLE = 0.05
"""Share of the variance of a step between pieces."""
FEW = 6000
"""Pieces that the first solution is made of, which finds poses and positions on the paths."""
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class ShapeChoice(Generic[AnyRun]):
    """Functions for the error motions, and what was solved with them.

    Attributes
    ----------
    bases : mapping of axis to Basis
    runs : list of Observed
        With poses to start from.
    done : JointSolution
        One linear solution, noise as it was known before.
    evidence : mapping of name to float
        Restricted log likelihood of everything that was tried, less the best.
    """

    bases: Bases
    runs: list[AnyRun]
    done: JointSolution
    evidence: Mapping[str, float]


def smooth_bases(nodes: Mapping[str, Array], parts: int = INTERVALS) -> Bases:
    """Cubic splines over equal parts of the range of the nodes of every axis."""
    return {axis: cubic(at, parts) for axis, at in nodes.items()}


def linear_bases(nodes: Mapping[str, Array]) -> Bases:
    """Functions that are linear between the nodes of every axis."""
    return {axis: linear(at) for axis, at in nodes.items()}


def _steps_unexplained(solved: SolvedRun) -> bool:
    """Tell whether neighbouring pieces of a line differ by more than the noise."""
    found = []
    for component, low, high, factor in solved.whitener.parts():
        noise = np.sum(np.diff(factor, axis=0) ** 2, axis=1)
        step = np.diff(solved.residual[component, low:high]) ** 2
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
    smooth, limit = layout(smooth_bases(nodes), len(runs)), config.unidentifiable_above
    poses = [run.pose for run in runs]
    whiteners = whiteners_of(runs, systems_of(runs, poses, smooth, None))
    start = Start({}, seen_blocks(runs, smooth, whiteners, limit))
    few = _thinned(runs)
    first = solve_jointly(few, smooth, config, progress, start)
    start = Start.after(runs[0].machine, first)
    moved = [replace(r, pose=s.pose) for r, s in zip(runs, first.runs, strict=True)]
    tried = {n: _tried(moved, _CHOICES[n](nodes), start, whiteners, limit) for n in FIRST_TRIED}
    best = max(tried, key=lambda name: _likelihood(tried[name]))
    if any(_steps_unexplained(solved) for solved in tried[best].runs):
        tried[FINER] = _tried(moved, _CHOICES[FINER](nodes), start, whiteners, limit)
    scores = {name: _likelihood(done) for name, done in tried.items()}
    best = max(scores, key=lambda name: scores[name])
    evidence = {name: score - scores[best] for name, score in scores.items()}
    return ShapeChoice(tried[best].unknowns.bases, moved, tried[best], evidence)


_CHOICES: dict[str, Callable[[Mapping[str, Array]], Bases]] = {
    SMOOTH: smooth_bases,
    FINER: partial(smooth_bases, parts=2 * INTERVALS),
    STRAIGHT: linear_bases,
}


def _thinned(runs: Sequence[AnyRun]) -> list[AnyRun]:
    """Some legs of every run, spread evenly: enough for poses and first tables."""
    share, found = FEW // len(runs), []
    for run in runs:
        number = np.cumsum(np.append(0, np.diff(run.pieces.leg) != 0))
        # multiples of the golden section keep no step with the laps of a path
        order = np.argsort((np.arange(number[-1] + 1) * GOLDEN) % 1.0)
        size = np.cumsum(np.bincount(number)[order])
        kept = order[: int(np.searchsorted(size, share)) + 1]
        drop = ~np.isin(number, kept)
        found.append(replace(run, pieces=run.pieces.without(drop)) if drop.any() else run)
    return found


def _tried(
    runs: Sequence[Observed],
    bases: Bases,
    start: Start,
    whiteners: Sequence[Whitener],
    limit: float,
) -> JointSolution:
    """One linear solution at given poses and positions."""
    unknowns = layout(bases, len(runs))
    systems = systems_of(runs, [r.pose for r in runs], unknowns, start.tables)
    normal = summed(systems, unknowns, whiteners)
    rough = Search(normal, unknowns, start.accepted, limit).run(start.logs)
    solution = solve(normal, unknowns, limit, start.accepted, rough.precision)
    left = left_by(systems, solution)
    parts = zip([r.pose for r in runs], systems, whiteners, left, strict=True)
    return JointSolution(unknowns, solution, rough, normal, tuple(SolvedRun(*p) for p in parts), 1)


def _likelihood(done: JointSolution) -> float:
    """Restricted log likelihood with the size of the residuals free."""
    rough = done.roughness
    volume = -2.0 * rough.log_likelihood - rough.square
    return -0.5 * (done.normal.rows * float(np.log(rough.square)) + volume)
