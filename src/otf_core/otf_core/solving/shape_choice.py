# SPDX-License-Identifier: Apache-2.0
"""Which functions the error motions are made of: smooth, finer, or straight between the nodes.

Smooth functions over ``INTERVALS`` parts of every axis are compared with tables that are linear
between the nodes of machine.yaml: a machine that its control compensates with such tables has
kinks there. Where neighbouring pieces of a line differ by more than the noise allows, the smooth
functions cannot follow something, and splines over twice as many parts are tried as well. The
functions with the largest restricted likelihood are taken, the size of the residuals left free:

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
    solve_jointly,
    summed,
    tables_of,
)
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.system import build_system
from otf_core.solving.unknowns import layout

Array = NDArray[np.float64]
Bases = dict[str, Basis]

SMOOTH, FINER = 'smooth', 'smooth, twice as fine'
STRAIGHT = 'straight between nodes'
INTERVALS = 20
"""Parts of an axis range: cubic splines then follow eight waves to 1 % of their size."""
SIGNIFICANT = 4.0
"""Standard deviations of the mean."""
NOTABLE = 0.05
"""Share of the variance of a step between pieces."""


@dataclass(frozen=True)
class ShapeChoice(Generic[AnyRun]):
    """Functions for the error motions, and runs with poses to start from.

    Attributes
    ----------
    bases : mapping of axis to Basis
    runs : list of Observed
        With the poses of the first solution.
    start : Start
    evidence : mapping of name to float
        Restricted log likelihood of everything that was tried, less the best.
    """

    bases: Bases
    runs: list[AnyRun]
    start: Start
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
    bases = smooth_bases(nodes)
    done = solve_jointly(runs, layout(bases, len(runs)), config, progress)
    moved = [replace(r, pose=s.pose) for r, s in zip(runs, done.runs, strict=True)]
    names = [SMOOTH, STRAIGHT]
    if any(_steps_unexplained(solved) for solved in done.runs):
        names.append(FINER)
    tried: dict[str, tuple[float, Bases, Roughness]] = {}
    for name in names:
        trial = _CHOICES[name](nodes)
        rough = _tried(moved, trial, done, config)
        tried[name] = (_likelihood(rough, done.normal.rows), trial, rough)
    best = max(tried.values(), key=lambda entry: entry[0])
    evidence = {name: score - best[0] for name, (score, _, _) in tried.items()}
    start = Start(best[2].logs, done.solution.accepted)
    return ShapeChoice(best[1], moved, start, evidence)


_CHOICES: dict[str, Callable[[Mapping[str, Array]], Bases]] = {
    SMOOTH: smooth_bases,
    FINER: partial(smooth_bases, parts=2 * INTERVALS),
    STRAIGHT: linear_bases,
}


def _tried(
    runs: Sequence[Observed], bases: Bases, done: JointSolution, config: CalibrationConfig
) -> Roughness:
    """Roughness of one linear solution at given poses and positions."""
    unknowns = layout(bases, len(runs))
    tables = tables_of(runs[0].machine, done.unknowns, done.solution)
    systems = [
        build_system(r.machine, r.pieces, r.pose, unknowns, tables, run=k)
        for k, r in enumerate(runs)
    ]
    normal = summed(systems, unknowns, [s.whitener for s in done.runs])
    search = Search(normal, unknowns, done.solution.accepted, config.unidentifiable_above)
    return search.run(done.roughness.logs)


def _likelihood(rough: Roughness, rows: int) -> float:
    """Restricted log likelihood with the size of the residuals free."""
    volume = -2.0 * rough.log_likelihood - rough.square
    return -0.5 * (rows * float(np.log(rough.square)) + volume)
