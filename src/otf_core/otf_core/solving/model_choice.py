# SPDX-License-Identifier: Apache-2.0
"""Choice of the functions of the motions: smooth, finer, or straight between the nodes.

Smooth functions over ``INTERVALS`` parts of every axis are compared with splines over twice as
many parts, and with tables that are linear between the nodes of machine.yaml: a machine that its
control compensates with such tables has kinks there. On legs that are enough to tell, the
functions with the largest restricted likelihood are taken, finer ones only if clearly so, the size
of the residuals free:

    L = -1/2 ( n log S + log det(N + K^-1) + log det K ),   S weighted sum of squares of n rows
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import AnyRun, Observed
from otf_core.solving.joint import (
    DAMPED,
    GOLDEN,
    JointSolution,
    SolvedRun,
    Start,
    common_places,
    find_identifiable_blocks,
    improve_runs,
    place_equations,
    residuals_of,
    solve_jointly,
    solve_robustly,
    step_equations,
    sum_normal_equations,
    systems_of,
    unknowns_of,
    whiteners_of,
)
from otf_core.solving.normal import (
    NormalEquations,
)
from otf_core.solving.reversal import Choice, choose_reversal
from otf_core.solving.roughness import Roughness, Search
from otf_core.solving.solution import Solution, solve
from otf_core.solving.system import System
from otf_core.solving.unknowns import (
    INTERVALS,
    Bases,
    Unknowns,
    linear_bases,
    smooth_bases,
)
from otf_core.solving.whitener import Whitener

SMOOTH, FINER = 'smooth', 'smooth, twice as fine'
STRAIGHT = 'straight between nodes'
MIN_GAIN_OF_FINER = 10.0
"""Difference of log likelihoods from which on finer functions are taken."""
MAX_FIRST_PIECES = 3000
"""Pieces that the first solution is made of, which finds poses and positions on the paths."""
MIN_FIRST_LEGS = 20
"""Fewer legs, however long, are not enough for that."""
MAX_FIRST_ITERATIONS = 8
"""Iterations after which that is given up for one of all pieces: so few legs are not enough."""


@dataclass(frozen=True)
class ShapeChoice(Generic[AnyRun]):
    """Functions for the error motions, and what was solved with them.

    Attributes
    ----------
    bases : mapping of axis to Basis
    runs : list of Observed
        With poses to start from.
    improved : list of Observed
        The same after one linear solution, see ``joint.improve_runs``.
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


def is_finer(bases: Bases) -> bool:
    """Return whether these are the functions that are tried where others leave steps."""
    return any(b.degree > 1 and len(b.knots) > INTERVALS + 1 for b in bases.values())


def choose_shapes(
    runs: Sequence[AnyRun],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    progress: Progress,
    tables: ErrorTables | None = None,
) -> ShapeChoice[AnyRun]:
    """Choose the functions that the motions are made of.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m and rad
        Of the tables that machine.yaml asks for.
    progress : callable(stage, fraction)
    tables : ErrorTables, optional
        What is known of the errors for the first positions on the paths.
    """
    limit = config.unidentifiable_above
    smooth = unknowns_of(runs, smooth_bases(runs[0].machine, nodes))
    seen = find_identifiable_blocks(runs, smooth, limit)
    start, first = _started(runs, smooth, Start({}, seen, tables), config, progress)
    moved = [
        replace(r, pose=s.pose, places=s.run.places) for r, s in zip(runs, first, strict=True)
    ]
    best, scores = _chosen(moved, nodes, start, limit)
    improved = improve_runs(moved, best, config)[0]
    after = Start.after(runs[0].machine, best)
    return ShapeChoice(best.unknowns.bases, moved, improved, after, scores)


_CHOICES: dict[str, Callable[[Machine, Mapping[str, Array]], Bases]] = {
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
) -> tuple[Start, tuple[SolvedRun, ...]]:
    """First tables, poses and places."""
    quick, first = (
        replace(config, max_iterations=min(MAX_FIRST_ITERATIONS, config.max_iterations)),
        None,
    )
    some = _thinned(runs)
    if sum(_leg_number(run)[-1] + 1 for run in some) >= MIN_FIRST_LEGS:
        with suppress(InputError):  # too few legs
            first = solve_jointly(some, smooth, quick, progress, start)
    first = first or solve_jointly(runs, smooth, config, progress, start)
    return Start.after(runs[0].machine, first), first.runs


def _chosen(
    runs: Sequence[AnyRun], nodes: Mapping[str, Array], start: Start, limit: float
) -> tuple[JointSolution, dict[str, float]]:
    """Linear solution with the functions that are the most likely on some of the legs.

    Returns
    -------
    solution : JointSolution
    scores : mapping of name to float
        Log likelihoods, less the best.
    """
    machine = runs[0].machine
    smooth = unknowns_of(runs, smooth_bases(machine, nodes))

    def rows(of: Sequence[Observed]) -> tuple[list[System], list[Whitener]]:
        systems = systems_of(of, smooth, start.tables)
        return systems, whiteners_of(of, systems)

    def fit(name: str, systems: Sequence[System], whiteners: Sequence[Whitener]) -> LinearSolution:
        unknowns = unknowns_of(runs, _CHOICES[name](machine, nodes))
        own = [s.of_unknowns(unknowns) for s in systems]
        normal = sum_normal_equations(own, unknowns, whiteners, start.accepted)
        normal += place_equations(machine, unknowns, common_places(runs))
        damped = normal + step_equations(unknowns, DAMPED)
        return LinearSolution.of(damped, unknowns, start.accepted, limit, start.logs)

    some, every = rows(_thinned(runs)), rows(runs)
    best, scores = most_likely({name: fit(name, *some) for name in _CHOICES})
    return _solved(fit(best, *every), *every, runs), scores


def most_likely(tried: Mapping[str, LinearSolution]) -> tuple[str, dict[str, float]]:
    """Name of the most likely functions, finer ones only if clearly so, and all log likelihoods.

    Returns
    -------
    best : str
    scores : mapping of name to float
        Log likelihoods, less the best.
    """
    simpler = max((n for n in tried if n != FINER), key=lambda n: tried[n].likelihood)
    finer = tried[FINER].likelihood > tried[simpler].likelihood + MIN_GAIN_OF_FINER
    most = max(one.likelihood for one in tried.values())
    return FINER if finer else simpler, {n: o.likelihood - most for n, o in tried.items()}


def _without_legs(run: AnyRun, number: Index, legs: Index) -> AnyRun:
    drop = ~np.isin(number, legs)
    return replace(run, pieces=run.pieces.without(drop)) if drop.any() else run


def _leg_number(run: Observed) -> Index:
    """Which leg in driving order a piece belongs to, shape (p,)."""
    return np.asarray(np.cumsum(np.append(0, np.diff(run.pieces.leg) != 0)))


def _thinned(runs: Sequence[AnyRun]) -> list[AnyRun]:
    """Some legs of every run, spread evenly: enough for poses and first tables."""
    share, thinned = MAX_FIRST_PIECES // len(runs), []
    for run in runs:
        number = _leg_number(run)
        # multiples of the golden section keep no step with the order of a path
        order = np.argsort((np.arange(number[-1] + 1) * GOLDEN) % 1.0)
        size = np.cumsum(np.bincount(number)[order])
        thinned.append(_without_legs(run, number, order[: int(np.searchsorted(size, share)) + 1]))
    return thinned


@dataclass(frozen=True)
class LinearSolution:
    """One linear solution, without what it leaves of the deviations."""

    unknowns: Unknowns
    solution: Solution
    roughness: Roughness
    normal: NormalEquations

    @classmethod
    def of(
        cls,
        normal: NormalEquations,
        unknowns: Unknowns,
        accepted: tuple[str, ...],
        limit: float,
        logs: Mapping[str, Array],
    ) -> LinearSolution:
        """Solve for some blocks with the roughness that makes the rows most likely.

        Parameters
        ----------
        accepted : tuple of str
            Blocks to solve for.
        limit : float
            ``unidentifiable_above``.
        logs : mapping of motion to ndarray
            Roughness to start from.
        """
        rough = Search(normal, unknowns, accepted, limit).run(logs)
        return cls(
            unknowns, solve(normal, unknowns, limit, accepted, rough.precision), rough, normal
        )

    @property
    def likelihood(self) -> float:
        """Restricted log likelihood with the size of the residuals free."""
        rough = self.roughness
        volume = -2.0 * rough.log_likelihood - rough.square
        return -0.5 * (self.normal.rows * float(np.log(rough.square)) + volume)


def _solved(
    linear: LinearSolution,
    systems: Sequence[System],
    whiteners: Sequence[Whitener],
    runs: Sequence[Observed],
) -> JointSolution:
    """A linear solution with what it leaves of the rows of any functions at the same poses."""
    own = [s.of_unknowns(linear.unknowns) for s in systems]
    residuals = residuals_of(own, linear.solution)
    own = [replace(s, rows=s.rows.released()) for s in own]
    parts = zip(runs, own, whiteners, residuals, strict=True)
    solved = tuple(SolvedRun(*p) for p in parts)
    return JointSolution(
        linear.unknowns, linear.solution, linear.roughness, linear.normal, solved, 1
    )


@dataclass(frozen=True)
class ReversalSolution(Generic[AnyRun]):
    """Solution with the reversal model that was configured or chosen.

    Attributes
    ----------
    runs : list of Observed
        With the pieces that were kept.
    whole : list of Observed
        With all their pieces.
    plain : (list of Observed, JointSolution)
        The same without reversal.
    """

    runs: list[AnyRun]
    joint: JointSolution
    choice: Choice
    whole: list[AnyRun]
    plain: tuple[list[AnyRun], JointSolution]

    def without_plain(self) -> ReversalSolution[AnyRun]:
        """The same without the memory of that without reversal."""
        return replace(self, plain=(self.runs, self.joint))


def solve_with_reversal(
    runs: Sequence[AnyRun],
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    progress: Progress,
    tables: ErrorTables | None = None,
    reduce_again: Callable[[AnyRun, ErrorTables], AnyRun] | None = None,
) -> ReversalSolution[AnyRun]:
    """Solve with the functions and the reversal model that the data call for.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m and rad
        Of the tables that machine.yaml asks for.
    config : CalibrationConfig
        May state the reversal model.
    progress : callable(stage, fraction)
    tables : ErrorTables, optional
        What is known of the errors for the first positions on the paths.
    reduce_again : callable(run, tables), optional
        Reduces a run once more, at the pose, places and errors that the solution without reversal
        has found, or gives it back where that changes nothing.
    """
    shapes = choose_shapes(runs, nodes, config, progress, tables)
    unknowns = unknowns_of(runs, shapes.bases)
    plain = kept, joint = solve_robustly(shapes.improved, unknowns, config, progress, shapes.start)
    choice, unknowns = choose_reversal(kept, joint, config)
    start = Start.after(joint.machine, joint)
    found = [
        replace(run, pose=s.pose, places=s.run.places, fitted=k.fitted)
        for run, k, s in zip(runs, kept, joint.runs, strict=True)
    ]
    assert start.tables is not None
    whole = [reduce_again(run, start.tables) for run in found] if reduce_again else found
    further = unknowns.blocks.keys() - joint.unknowns.blocks.keys()
    if not further and all(a is b for a, b in zip(whole, found, strict=True)):
        return ReversalSolution(*plain, choice, whole, plain)
    if further:
        seen = find_identifiable_blocks(whole, unknowns, config.unidentifiable_above)
        start = replace(start, accepted=(*start.accepted, *(n for n in seen if n in further)))
    solved = solve_robustly(whole, unknowns, config, progress, start)
    return ReversalSolution(*solved, choice, whole, plain)
