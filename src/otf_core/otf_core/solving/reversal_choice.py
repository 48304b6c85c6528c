# SPDX-License-Identifier: Apache-2.0
"""Which reversal model the data call for: cross-validation on held-out legs.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Generic

import numpy as np
from scipy import linalg

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.effects.catalogue.servo_mismatch import ServoMismatch
from otf_core.effects.state import state_of_travel
from otf_core.live.stages import Progress
from otf_core.memory import give_back
from otf_core.pieces.runs import AnyRun, Observed
from otf_core.solving.design import Design
from otf_core.solving.folds import FOLDS, fold_of
from otf_core.solving.joint import JointSolution, solve_robustly, tables_of
from otf_core.solving.normal import NormalEquations, sum_groups
from otf_core.solving.repeated_lines import Once, weigh_repeated_lines
from otf_core.solving.reversal import MODELS
from otf_core.solving.roughness import TRACE
from otf_core.solving.shape_choice import choose_shapes
from otf_core.solving.solution import estimated, free_columns, identifiable_blocks
from otf_core.solving.system import System, build_system
from otf_core.solving.unknowns import Unknowns, is_reversal, layout, reversal_order
from otf_core.threads import side_by_side

Evidence = dict[str, float | int | str]

CLEAR = 3.0
"""Gain over its own scatter from which a richer model is taken."""
RIVAL = ServoMismatch()
"""What is taken for a reversal most easily."""
MIN_LINES = 16
"""Fewer lines tell nothing of the scatter: no reversal is modelled then."""


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
    """Solution with the reversal model that was asked for or chosen.

    Attributes
    ----------
    runs : list of Observed
        With the pieces that were kept.
    done : JointSolution
    choice : Choice
    plain : (list of Observed, JointSolution)
        The same without reversal.
    """

    runs: list[AnyRun]
    done: JointSolution
    choice: Choice
    plain: tuple[list[AnyRun], JointSolution]


def solve_with_reversal(
    runs: Sequence[AnyRun], nodes: dict[str, Array], config: CalibrationConfig, progress: Progress
) -> ReversalSolution[AnyRun]:
    """Solve with the functions and the reversal model that the data call for.

    Parameters
    ----------
    runs : sequence of Observed
    nodes : mapping of axis to ndarray, m
        Of the tables that machine.yaml asks for.
    config : CalibrationConfig
        May state the reversal model.
    progress : callable(stage, fraction)
    """
    shapes = choose_shapes(runs, nodes, config, progress)
    give_back()
    unknowns = layout(shapes.bases, len(runs))
    plain = solve_robustly(shapes.improved, unknowns, config, progress, shapes.start)
    give_back()

    choice = choose_reversal(*plain, config)
    if choice.model == 'none':
        return ReversalSolution(*plain, choice, plain)
    unknowns = layout(shapes.bases, len(runs), MODELS[choice.model], held=choice.held)
    # reversal adds blocks: which of them the data determine is found out anew
    again = solve_robustly(shapes.runs, unknowns, config, progress)
    return ReversalSolution(*again, choice, plain)


def choose_reversal(
    runs: Sequence[Observed], done: JointSolution, config: CalibrationConfig
) -> Choice:
    """Choose a reversal model by what it leaves of held-out legs.

    The model may be given by the configuration; whether axes that stand are held is always
    chosen.

    Parameters
    ----------
    runs : sequence of Observed
    done : JointSolution
        Of the same runs, without reversal.
    config : CalibrationConfig

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
    fold = _line_folds(done)
    lines = sum(len(f) for f in fold)
    if lines < MIN_LINES and given == 'auto':
        few = f'too few lines: {lines}, {MIN_LINES} needed'
        return Choice('none', False, {'decided_by': few, 'lines': lines})
    found: dict[float, Choice] = {}
    for held in (False, True):
        left = _held_out_squares(runs, done, fold, config.unidentifiable_above, held)
        choice = Choice(given, held, {'decided_by': 'configuration'})
        if given == 'auto':
            choice = _chosen(left, held)
        # of equals the first counts: nothing is held where there is no reversal
        found.setdefault(float(left[choice.model].sum()), choice)
        gains = [float(choice.evidence.get(f'gain_{model}', 1.0)) for model in MODELS]
        if choice.model == 'none' and max(gains[1:]) <= 0.0:
            break  # no reversal at all, so none that is held
    return found[min(found)]


def _line_folds(done: JointSolution) -> list[Index]:
    """Fold of every line of every run: passes over one line are held out together."""
    count = [len(solved.whitener.once.bounds) for solved in done.runs]
    return np.split(fold_of(np.arange(sum(count))), np.cumsum(count)[:-1])


def _chosen(left: dict[str, Array], held: bool) -> Choice:
    """Choose among the models by the squares (lines,) that each leaves."""
    lines = len(left['none'])
    evidence: Evidence = {
        'decided_by': 'held-out lines',
        'lines': lines,
        'folds': FOLDS,
        'needed': CLEAR,
        **{f'held_out_{model}': float(square.sum()) for model, square in left.items()},
    }
    best = 'none'
    for model, square in left.items():
        if model == best or (best == 'none' and model == RIVAL.name):
            continue
        difference = left[best] - square
        gain, scatter = float(difference.sum()), float(np.sqrt(lines) * difference.std(ddof=1))
        evidence |= {f'gain_{model}': gain, f'scatter_{model}': scatter}
        if gain > CLEAR * scatter:
            best = model
    if best == RIVAL.name:
        return Choice('none', False, evidence | {'rival': RIVAL.name})
    return Choice(best, held, evidence)


def _held_out_squares(
    runs: Sequence[Observed], done: JointSolution, fold: Sequence[Index], limit: float, held: bool
) -> dict[str, Array]:
    """Squared whitened residual of every leg under every model fitted to the other folds."""
    unknowns = layout(done.unknowns.bases, len(runs), max(MODELS.values()), held=held)
    tables = tables_of(runs[0].machine, done.unknowns, done.solution)
    lines, rivals = [], []
    for k, (run, solved) in enumerate(zip(runs, done.runs, strict=True)):
        system = build_system(run.machine, run.pieces, solved.pose, unknowns, tables, run=k)
        lines.append(weigh_repeated_lines(system, solved.whitener))
        rivals.append(_rival_columns(run, system)[:, lines[k].pieces])
    seen = done.solution.accepted
    blocks = [n for n in unknowns.blocks if _motion(n) in seen]
    sums = [
        sum_groups(own.system, unknowns, own.whitener, group, rival, FOLDS, blocks)
        for own, group, rival in zip(lines, fold, rivals, strict=True)
    ]
    parts = [reduce(add, of_fold) for of_fold in zip(*sums, strict=True)]
    total = reduce(add, parts)
    visible = identifiable_blocks(total, unknowns, limit)
    columns = {
        model: free_columns(
            unknowns,
            [n for n in visible if reversal_order(n) < count and _motion(n) in seen],
        )
        for model, count in MODELS.items()
    }
    width = rivals[0].shape[2]
    columns[RIVAL.name] = np.append(columns['none'], unknowns.free + np.arange(width))
    loose = unknowns.free - done.unknowns.free + width
    prior = linalg.block_diag(done.roughness.precision, TRACE / limit**2 * np.eye(loose))
    held_out = [_folds(*run) for run in zip(lines, fold, rivals, strict=True)]
    for some in (part for folds in held_out for part in folds):
        some.rows.prepare()

    values = side_by_side(lambda part: _estimates(total.less(part), columns, prior), parts)

    def left(model: str) -> Array:
        own = [of_fold[model] for of_fold in values]
        pairs = zip(lines, held_out, strict=True)
        return np.concatenate([_squares(line, folds, unknowns, own) for line, folds in pairs])

    return dict(zip(columns, side_by_side(left, list(columns)), strict=True))


def _estimates(
    normal: NormalEquations, columns: Mapping[str, Index], prior: Array
) -> dict[str, Array]:
    """Estimates of some columns each, see ``estimated``; one factor for all that begin alike."""
    most = max(columns.values(), key=len)
    place = np.ix_(most, most)
    factor = linalg.cholesky(normal.matrix[place] + prior[place], lower=True)
    half = linalg.solve_triangular(factor, normal.right[most], lower=True)
    found = {}
    for model, use in columns.items():
        own = slice(0, len(use))
        if not np.array_equal(use, most[own]):
            found[model] = estimated(normal, use, prior)
            continue
        value = linalg.solve_triangular(factor[own, own], half[own], lower=True, trans='T')
        found[model] = np.zeros(len(normal.right))
        found[model][use] = value
    return found


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
    rows : Design
    rival : ndarray, shape (c, m, k)
        Columns of the rival.
    """

    pieces: Index
    rows: Design
    rival: Array


def _folds(own: Once, fold: Index, rival: Array) -> list[_Fold]:
    """Folds of a run, by the fold of every line."""
    of_piece = fold[_line_of_piece(own)]
    places = (np.flatnonzero(of_piece == k) for k in range(FOLDS))
    return [_Fold(p, own.system.rows.at(p), rival[:, p]) for p in places]


def _line_of_piece(own: Once) -> Index:
    size = [high - low for low, high in own.whitener.bounds]
    return np.repeat(np.arange(len(size)), size)


def _squares(
    own: Once, folds: Sequence[_Fold], unknowns: Unknowns, values: Sequence[Array]
) -> Array:
    """Sum of squares of each line of a run with the values (columns,) of its fold.

    What passes over a line differ among themselves is left out: it is the same for every model.
    """
    rest = own.system.deviation.copy()
    for fold, value in zip(folds, values, strict=True):
        rest[:, fold.pieces] -= fold.rows.times(unknowns.gauge @ value[: unknowns.free])
        rest[:, fold.pieces] -= fold.rival @ value[unknowns.free :]
    white, number, size = own.whitener.whiten(rest), _line_of_piece(own), own.whitener.bounds
    return np.asarray(np.bincount(number, (white**2).sum(axis=0), len(size)), dtype=float)
