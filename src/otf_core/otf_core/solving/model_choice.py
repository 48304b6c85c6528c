# SPDX-License-Identifier: Apache-2.0
"""Choice of the functions of the motions and of the reversal model.

Which functions the error motions are made of: smooth, finer, or straight between the nodes.

Smooth functions over ``INTERVALS`` parts of every axis are compared with splines over twice as
many parts, and with tables that are linear between the nodes of machine.yaml: a machine that its
control compensates with such tables has kinks there. On legs that are enough to tell, the
functions with the largest restricted likelihood are taken, finer ones only if clearly so, the size
of the residuals free:

    L = -1/2 ( n log S + log det(N + K^-1) + log det K ),   S weighted sum of squares of n rows

Which reversal model the data call for: cross-validation on held-out legs.

Noise is correlated within a leg, so whole legs are held out, with all that pass over the same
line. The lines are dealt to folds, and what each model leaves of a fold is judged with the model
fitted to all others. With S_j the sum of the squared whitened residuals of line j, the gain of a
richer model over a simpler one is

    D = sum_j ( S_j simple - S_j rich ),    s_D = sqrt(n) * standard deviation of the n differences

A model of k parameters that are not there loses about k. The richer one is taken if D > 3 s_D.
Servo mismatch flips with travel too, but grows with the feed: where it explains the held-out legs
better, by the same rule, no reversal is modelled.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import add
from typing import Generic

import numpy as np
from scipy import linalg

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.effects.catalogue.servo_mismatch import ServoMismatch
from otf_core.effects.state import state_of_travel
from otf_core.errors import InputError
from otf_core.live.stages import Progress
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables
from otf_core.pieces.runs import AnyRun, Observed
from otf_core.solving.design import Design
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
    tables_of,
    unknowns_of,
    whiteners_of,
)
from otf_core.solving.normal import (
    NormalEquations,
    sum_groups,
)
from otf_core.solving.residuals import FOLDS, fold_of
from otf_core.solving.reversal import MODELS
from otf_core.solving.roughness import TRACE, Roughness, Search
from otf_core.solving.solution import Solution, free_columns, identifiable_blocks, solve, solve_for
from otf_core.solving.system import System
from otf_core.solving.unknowns import (
    INTERVALS,
    Bases,
    Unknowns,
    is_reversal,
    linear_bases,
    reversal_names,
    reversal_order,
    smooth_bases,
)
from otf_core.solving.whitener import Whitener
from otf_core.threads import side_by_side

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


Evidence = dict[str, float | int | str]

MIN_GAIN_OVER_SCATTER = 3.0
"""Gain over its own scatter from which a richer model is taken."""
RIVAL = ServoMismatch()
"""What is taken for a reversal most easily."""
MIN_LINES = 16
"""Fewer lines do not determine the scatter: no reversal is modelled then."""


@dataclass(frozen=True)
class Choice:
    """A reversal model.

    Attributes
    ----------
    model : str
        A name of ``reversal.MODELS``.
    held : bool
        Axes that stand stay on the side of their last travel.
    evidence : mapping of str to number or text
    """

    model: str
    held: bool
    evidence: Evidence


@dataclass(frozen=True)
class ReversalSolution(Generic[AnyRun]):
    """Solution with the reversal model that was configured or chosen.

    Attributes
    ----------
    runs : list of Observed
        With the pieces that were kept.
    plain : (list of Observed, JointSolution)
        The same without reversal.
    """

    runs: list[AnyRun]
    joint: JointSolution
    choice: Choice
    plain: tuple[list[AnyRun], JointSolution]

    def without_plain(self) -> ReversalSolution[AnyRun]:
        """The same without the memory of that without reversal."""
        return replace(self, plain=(self.runs, self.joint))


def solve_with_reversal(
    runs: Sequence[AnyRun], nodes: dict[str, Array], config: CalibrationConfig, progress: Progress
) -> ReversalSolution[AnyRun]:
    """Solve with the functions and the reversal model that the data call for.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m
        Of the tables that machine.yaml asks for.
    config : CalibrationConfig
        May state the reversal model.
    progress : callable(stage, fraction)
    """
    shapes = choose_shapes(runs, nodes, config, progress)
    unknowns = unknowns_of(runs, shapes.bases)
    plain = solve_robustly(shapes.improved, unknowns, config, progress, shapes.start)

    choice = choose_reversal(*plain, config)
    if choice.model == 'none':
        return ReversalSolution(*plain, choice, plain)
    names = reversal_names(runs[0].machine.motions, MODELS[choice.model])
    unknowns = unknowns_of(runs, shapes.bases, names, held=choice.held)
    # reversal adds blocks: which of them the data determine is found out anew
    again = solve_robustly(shapes.runs, unknowns, config, progress)
    return ReversalSolution(*again, choice, plain)


def choose_reversal(
    runs: Sequence[Observed], joint: JointSolution, config: CalibrationConfig
) -> Choice:
    """Choose a reversal model by what it leaves of held-out legs.

    The model may be given by the configuration; whether axes at rest are held is always
    chosen.

    Parameters
    ----------
    joint : JointSolution
        Of the same runs, without reversal.

    Returns
    -------
    Choice
        With the evidence: 'lines', 'folds', 'needed' gain over scatter; per model
        'held_out_MODEL', sum of squared whitened residuals; 'gain_MODEL' and 'scatter_MODEL'
        over the best simpler one, for the rival over the model chosen; 'rival', if it was
        better.
    """
    given = config.reversal
    if given == 'none':
        return Choice('none', False, {'decided_by': 'configuration'})
    fold = line_folds(joint)
    lines = sum(len(f) for f in fold)
    if lines < MIN_LINES and given == 'auto':
        return Choice('none', False, {'decided_by': too_few(lines), 'lines': lines})
    choices: dict[float, Choice] = {}
    for held in (False, True):
        held_out = _held_out_squares(runs, joint, fold, config.unidentifiable_above, held)
        choice = Choice(given, held, {'decided_by': 'configuration'})
        if given == 'auto':
            choice = choose_model(held_out, held)
        # of equals the first counts: nothing is held where there is no reversal
        choices.setdefault(float(held_out[choice.model].sum()), choice)
        gains = [float(choice.evidence.get(f'gain_{model}', 1.0)) for model in MODELS]
        if choice.model == 'none' and max(gains[1:]) <= 0.0:
            break  # no reversal at all, so none that is held
    return choices[min(choices)]


def too_few(lines: int) -> str:
    """Why held-out lines do not decide."""
    return f'too few lines: {lines}, {MIN_LINES} needed'


def line_folds(joint: JointSolution) -> list[Index]:
    """Fold of every line of every run: passes over one line are held out together."""
    count = [int(solved.whitener.line.max()) + 1 for solved in joint.runs]
    return np.split(fold_of(np.arange(sum(count))), np.cumsum(count)[:-1])


def choose_model(held_out: Mapping[str, Array], held: bool) -> Choice:
    """Choose among the models, the simplest first, by the squares (lines,) that each leaves."""
    lines = len(held_out['none'])
    evidence: Evidence = {
        'decided_by': 'held-out lines',
        'lines': lines,
        'folds': FOLDS,
        'needed': MIN_GAIN_OVER_SCATTER,
        **{f'held_out_{model}': float(square.sum()) for model, square in held_out.items()},
    }
    best = 'none'
    for model, square in held_out.items():
        if model == best or (best == 'none' and model == RIVAL.name):
            continue
        difference = held_out[best] - square
        gain, scatter = float(difference.sum()), float(np.sqrt(lines) * difference.std(ddof=1))
        evidence |= {f'gain_{model}': gain, f'scatter_{model}': scatter}
        if gain > MIN_GAIN_OVER_SCATTER * scatter:
            best = model
    if best == RIVAL.name:
        return Choice('none', False, evidence | {'rival': RIVAL.name})
    return Choice(best, held, evidence)


def _held_out_squares(
    runs: Sequence[Observed], joint: JointSolution, fold: Sequence[Index], limit: float, held: bool
) -> dict[str, Array]:
    """Squared whitened residual of every line under every model fitted to the other folds."""
    names = reversal_names(joint.machine.motions, max(MODELS.values()))
    unknowns = unknowns_of(runs, joint.unknowns.bases, names, held=held)
    tables = tables_of(joint.machine, joint.unknowns, joint.solution)
    systems = systems_of([s.run for s in joint.runs], unknowns, tables)
    rows = [(system, s.whitener) for system, s in zip(systems, joint.runs, strict=True)]
    rivals = [_rival_columns(run, system) for run, system in zip(runs, systems, strict=True)]
    seen = joint.solution.accepted
    blocks = [n for n in unknowns.blocks if _motion(n) in seen]
    folded = FoldedLines.of(rows, fold, rivals, unknowns, blocks)
    visible = identifiable_blocks(folded.total, unknowns, limit)
    columns = {
        model: free_columns(
            unknowns,
            [n for n in visible if reversal_order(n) < count and _motion(n) in seen],
        )
        for model, count in MODELS.items()
    }
    width = rivals[0].shape[2]
    columns[RIVAL.name] = np.append(columns['none'], unknowns.free + np.arange(width))
    loose = unknowns.free - joint.unknowns.free + width
    prior = linalg.block_diag(joint.roughness.precision, TRACE / limit**2 * np.eye(loose))
    return folded.squares(columns, prior)


WhitenedRows = tuple[System, Whitener]


@dataclass(frozen=True)
class FoldedLines:
    """Lines of all runs, dealt to folds.

    Attributes
    ----------
    rows : sequence of (System, Whitener)
        Of every run.
    fold : sequence of ndarray of int64
        Fold of every line.
    further : sequence of ndarray, shape (c, p, k)
        Columns beside the unknowns.
    parts : sequence of NormalEquations
        Of every fold.
    total : NormalEquations
        Of all of them, and what is known beside the rows.
    """

    rows: Sequence[WhitenedRows]
    fold: Sequence[Index]
    further: Sequence[Array]
    unknowns: Unknowns
    parts: Sequence[NormalEquations]
    total: NormalEquations

    @classmethod
    def of(
        cls,
        rows: Sequence[WhitenedRows],
        fold: Sequence[Index],
        further: Sequence[Array],
        unknowns: Unknowns,
        blocks: Collection[str] | None = None,
        known: Sequence[NormalEquations] = (),
    ) -> FoldedLines:
        """Sum up the rows of every fold; see ``normal.sum_groups``."""
        sums = [
            sum_groups(system, unknowns, whitener, group[whitener.line], more, FOLDS, blocks)
            for (system, whitener), group, more in zip(rows, fold, further, strict=True)
        ]
        parts = [reduce(add, of_fold) for of_fold in zip(*sums, strict=True)]
        return cls(rows, fold, further, unknowns, parts, reduce(add, [*parts, *known]))

    def squares(self, columns: Mapping[str, Index], prior: Array) -> dict[str, Array]:
        """Squares (lines,) that models of some columns leave of the lines that they do not know.

        Parameters
        ----------
        columns : mapping of model to ndarray of int64
            Places among free unknowns and further columns.
        prior : ndarray, shape (k, k), 1 / (m, rad)^2
        """
        held_out = [_folds(*run) for run in zip(self.rows, self.fold, self.further, strict=True)]
        for some in (part for folds in held_out for part in folds):
            some.rows.prepare()
        values = side_by_side(
            lambda part: _estimates(self.total.less(part), columns, prior), self.parts
        )

        def left(model: str) -> Array:
            own = [of_fold[model] for of_fold in values]
            pairs = zip(self.rows, held_out, strict=True)
            return np.concatenate(
                [_squares(rows, folds, self.unknowns, own) for rows, folds in pairs]
            )

        return dict(zip(columns, side_by_side(left, list(columns)), strict=True))


def _estimates(
    normal: NormalEquations, columns: Mapping[str, Index], prior: Array
) -> dict[str, Array]:
    """Estimates of some columns each, see ``solve_for``; one factor for all that begin alike."""
    most = max(columns.values(), key=len)
    place = np.ix_(most, most)
    factor = linalg.cholesky(normal.matrix[place] + prior[place], lower=True)
    half = linalg.solve_triangular(factor, normal.right[most], lower=True)
    estimates = {}
    for model, use in columns.items():
        own = slice(0, len(use))
        if not np.array_equal(use, most[own]):
            estimates[model] = solve_for(normal, use, prior)
            continue
        value = linalg.solve_triangular(factor[own, own], half[own], lower=True, trans='T')
        estimates[model] = np.zeros(len(normal.right))
        estimates[model][use] = value
    return estimates


def _motion(block: str) -> str:
    return block[:3] if is_reversal(block) else block


def _rival_columns(run: Observed, system: System) -> Array:
    """Columns of the rival across the path, shape (c, p, k)."""
    state = state_of_travel(run.machine, system.q, run.pieces.direction)
    terms = RIVAL.terms(replace(state, speed=run.pieces.speed), {})
    return np.asarray(np.einsum('cij,ijk->cik', system.axes, terms.columns))


@dataclass(frozen=True)
class _Fold:
    """Lines of a run that are held out together.

    Attributes
    ----------
    pieces : ndarray of int64, shape (m,)
    rival : ndarray, shape (c, m, k)
        Columns beside the unknowns.
    """

    pieces: Index
    rows: Design
    rival: Array


def _folds(rows: WhitenedRows, fold: Index, rival: Array) -> list[_Fold]:
    """Folds of a run, by the fold of every line."""
    system, whitener = rows
    of_piece = fold[_line_of_piece(whitener)]
    places = (np.flatnonzero(of_piece == k) for k in range(FOLDS))
    return [_Fold(p, system.rows.at(p), rival[:, p]) for p in places]


def _line_of_piece(whitener: Whitener) -> Index:
    return np.repeat(whitener.line, [high - low for low, high in whitener.bounds])


def _squares(
    rows: WhitenedRows, folds: Sequence[_Fold], unknowns: Unknowns, values: Sequence[Array]
) -> Array:
    """Sum of squares of each line of a run with the values (columns,) of its fold."""
    system, whitener = rows
    rest = system.deviation.copy()
    for fold, value in zip(folds, values, strict=True):
        rest[:, fold.pieces] -= fold.rows.times(unknowns.gauge @ value[: unknowns.free])
        rest[:, fold.pieces] -= fold.rival @ value[unknowns.free :]
    square = (whitener.whiten(rest) ** 2).sum(axis=0)
    return np.asarray(np.bincount(_line_of_piece(whitener), square), dtype=float)
