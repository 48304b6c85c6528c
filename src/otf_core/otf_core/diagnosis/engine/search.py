# SPDX-License-Identifier: Apache-2.0
"""Search for effects: one after the other, each on what the others leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.engine.decoys import DECOY_NAMES
from otf_core.diagnosis.engine.evidence import (
    Estimate,
    Option,
    average,
    estimate,
    log_evidence,
)
from otf_core.diagnosis.engine.rows import Rows
from otf_core.diagnosis.engine.tried import Tried
from otf_core.solving.columns import column_size
from otf_core.solving.residual_check import check_residuals

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NEEDED_EVIDENCE = 9.0
"""Logarithm of the odds that an effect needs before it is named (8000 to 1)."""
CLOSE_EVIDENCE = 5.0
"""Effects within these odds (150 to 1) of the best are not told from it."""
SAME_TRACE = 0.03
"""An effect that can leave all but this share of the squared trace of another is not told
from it."""
MAX_CAUSES = 4
NEXT_TO_NOTHING = 1e-9
"""Share of the largest squared singular value."""
DECOY_DOUBT = 10.0
"""Evidence by which a shape outside the catalogue must be better than any effect in it."""
FREE_DOUBT = 10.0
"""Evidence by which a free form must be better than the formula, which is named else."""


@dataclass(frozen=True)
class Cause:
    """An effect that was found.

    Attributes
    ----------
    option : Option
    score : float
    confidence : float
        Probability among the candidates and 'none'.
    indistinguishable : tuple of str
    """

    option: Option
    score: float
    confidence: float
    indistinguishable: tuple[str, ...]


def noise_variance(rows: Rows, residual: Array) -> float:
    """Variance of the noise left in residuals, correlation between pieces included."""
    parts = zip(rows.observed, rows.by_run(residual), strict=True)
    return float(np.mean([check_residuals(p, r.pieces.leg, 0).inflation for r, p in parts]))


def fit_out(option: Option, residual: Array) -> Array:
    """Residual less the best fit of one option."""
    fit = estimate(option.white, option.size, residual, option.widths)
    return residual - option.white @ fit.value


Candidates = Mapping[str, Sequence[Tried]]
Ranking = list[tuple[float, Tried, Index]]
"""Score of every effect, and its best option: the shape and its terms."""


def _pairs(group: Sequence[Tried], variance: float) -> tuple[list[tuple[Tried, Index]], Array]:
    """Options of an effect, shapes with their terms, and their scores."""
    pairs = [(tried, take) for tried in group for take in tried.takes]
    return pairs, np.array([tried.odds(take, variance) for tried, take in pairs])


def _ranking(candidates: Candidates, variance: float) -> Ranking:
    """Score and best option of every effect, best first."""
    ranking: Ranking = []
    for group in candidates.values():
        pairs, scores = _pairs(group, variance)
        if not pairs:
            continue
        doubt = DECOY_DOUBT if group[0].effect.name in DECOY_NAMES else 0.0
        free = np.array([is_free(tried) for tried, _ in pairs])
        best = int(np.argmax(scores - FREE_DOUBT * free))
        kinds = [average(scores[free == kind]) for kind in np.unique(free)]
        ranking.append((average(kinds) - doubt, *pairs[best]))
    return sorted(ranking, key=lambda entry: -entry[0])


def is_free(tried: Tried) -> bool:
    """Tell whether this is the free form of an effect."""
    return bool(tried.terms.orders)


def _same_trace(best: Option, other: Option, residual: Array) -> bool:
    """Tell whether another effect can leave the trace of the best one."""
    trace = best.white @ estimate(best.white, best.size, residual, best.widths).value
    rest = trace - other.white @ estimate(other.white, other.size, trace, other.widths).value
    power = float(trace @ trace)
    return float(rest @ rest) < max(SAME_TRACE * power, 4.0)


def _refined(option: Option, basis: Array, rows: Rows, residual: Array) -> Option:
    """Improve the shape of an option: its spectral line or length is only known to a raster."""
    name = option.effect.refine
    if not name:
        return option
    start = float(option.shape[name])

    def at(place: float) -> Option:
        shape = {**option.shape, name: place}
        plain = rows.plain_columns(option.effect, shape)[:, option.take]
        own = rows.project(rows.whiten(plain))
        return _free_of(
            basis, replace(option, shape=shape, plain=plain, own=own, size=column_size(plain))
        )

    def loss(logarithm: float) -> float:
        trial = at(start * float(np.exp(logarithm)))
        return -estimate(trial.white, trial.size, residual, trial.widths).gain

    from scipy.optimize import minimize_scalar  # 0.1 s

    width = option.effect.refine_width
    best = minimize_scalar(
        loss, bounds=(-width, width), method='bounded', options={'xatol': width / 200}
    )
    refined = at(start * float(np.exp(best.x)))
    better = estimate(refined.white, refined.size, residual, refined.widths).gain
    now = estimate(option.white, option.size, residual, option.widths).gain
    return refined if better > now else option


def search(rows: Rows, tried: Candidates) -> tuple[list[Cause], list[tuple[str, float]]]:
    """Find effects one after the other.

    With Q an orthonormal basis of the columns of the causes, what is left of the columns P of an
    effect has the products P'P - (Q'P)'(Q'P) and P'y - (Q'P)'(Q'y): no columns are written again.

    Returns
    -------
    causes : list of Cause
        In the order found.
    considered : list of (name, score)
        The ranking of the last round.
    """
    residual = rows.residual
    basis = np.zeros((len(residual), 0))
    candidates = {name: list(group) for name, group in tried.items()}
    causes: list[Cause] = []
    considered: list[tuple[str, float]] = []
    while True:
        first = _ranking(candidates, 1.0)
        if not first:
            break
        # noise is judged on what the best candidate leaves: its own trace must not count as noise
        best = _free_of(basis, first[0][1].made(first[0][2], 1.0))
        variance = noise_variance(rows, fit_out(best, residual))
        ranking = _ranking(candidates, variance)
        considered = [(t.effect.name, s) for s, t, _ in ranking]
        if ranking[0][0] < NEEDED_EVIDENCE:
            break
        causes.append(_cause(ranking, candidates, basis, rows, residual, variance))
        option = causes[-1].option
        group = candidates.pop(option.effect.name)
        if option.effect.wave is not None:  # each axis has a period of its own
            candidates[option.effect.name] = [_other_axes(t, option.axes) for t in group]
        if len(causes) == MAX_CAUSES:
            break
        taken = _orthonormal(option.white)
        basis = np.concatenate([basis, taken], axis=1)
        amount, pulled = taken.T @ residual, rows.pulled(taken)
        residual = residual - taken @ amount
        candidates = {n: [t.without(pulled, amount) for t in g] for n, g in candidates.items()}
    return causes, considered


def _other_axes(tried: Tried, axes: Sequence[str]) -> Tried:
    """Keep the options of single axes that are not among these."""
    takes = [take for take in tried.takes if tried.axes(take)]
    return tried.only([take for take in takes if not set(tried.axes(take)) & set(axes)])


def _cause(
    ranking: Ranking,
    candidates: Candidates,
    basis: Array,
    rows: Rows,
    residual: Array,
    variance: float,
) -> Cause:
    """The first of a ranking as a cause, with what is not told from it."""
    score, tried, take = ranking[0]
    option = _refined(_free_of(basis, tried.made(take, variance)), basis, rows, residual)
    group = [t for t in candidates[tried.effect.name] if not is_free(t) and t.effect.refine]
    if is_free(tried) and group:  # it may only make up for the raster of the formula
        pairs, scores = _pairs(group, variance)
        near, own = pairs[int(np.argmax(scores))]
        plain = _refined(_free_of(basis, near.made(own, variance)), basis, rows, residual)
        gained = _score(option, residual, variance) - _score(plain, residual, variance)
        option = option if gained > FREE_DOUBT else plain

    def same(other: Tried, take: Index) -> bool:
        return _same_trace(option, _free_of(basis, other.source.option(take)), residual)

    close = [
        t.effect.name
        for s, t, own in ranking[1:]
        if t.effect.name not in DECOY_NAMES
        and (
            s > score - CLOSE_EVIDENCE or (s > NEEDED_EVIDENCE and not is_free(t) and same(t, own))
        )
    ]
    odds = np.array([0.0] + [s for s, _, _ in ranking])
    confidence = float(np.exp(score - np.logaddexp.reduce(odds)))
    return Cause(option, score, confidence, tuple(close[:4]))


def _score(option: Option, residual: Array, variance: float) -> float:
    """Evidence of an option with its columns as they are."""
    orders = np.array(option.terms.orders)
    products = option.white.T @ option.white, option.white.T @ residual
    own = orders[option.take] if len(orders) else orders
    return log_evidence(*products, option.size, variance, own)


def _free_of(basis: Array, option: Option) -> Option:
    """Leave out of an option what the causes found so far, spanned by ``basis``, can follow."""
    return replace(option, white=option.own - basis @ (basis.T @ option.own))


def _orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns (r, k), those that are next to nothing left out."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > NEXT_TO_NOTHING * values[-1]
    return np.asarray(columns @ (vectors[:, kept] / np.sqrt(values[kept])))


def fit_jointly(causes: Sequence[Cause], rows: Rows) -> Estimate:
    """Estimate the coefficients of all causes together, jointly with tables and poses."""
    white = np.concatenate([c.option.own for c in causes], axis=1)
    size = np.concatenate([c.option.size for c in causes])
    width = np.concatenate([c.option.widths for c in causes])
    return estimate(white, size, rows.residual, width)
