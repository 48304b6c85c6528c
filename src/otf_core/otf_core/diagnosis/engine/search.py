# SPDX-License-Identifier: Apache-2.0
"""Search for effects: one after the other, each on what the others leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from otf_core.diagnosis.engine.decoys import DECOY_NAMES
from otf_core.diagnosis.engine.evidence import Estimate, Option, average, estimate, log_evidence
from otf_core.diagnosis.engine.rows import Rows
from otf_core.solving.columns import column_size
from otf_core.solving.residual_check import check_residuals

Array = NDArray[np.float64]

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
    fit = estimate(option.white, option.size, residual)
    return residual - option.white @ fit.value


class _Candidate:
    """An option beside the causes found so far, by its products alone.

    With Q an orthonormal basis of the columns of the causes and a residual y free of them, the
    columns E less what Q can follow have the products E'E - (Q'E)'(Q'E) and E'y; no columns are
    written again.
    """

    def __init__(self, option: Option) -> None:
        self.option = option
        self.normal = option.own.T @ option.own

    def take_out(self, basis: Array) -> None:
        """Leave out what further orthonormal columns (r, k) can follow."""
        shared = basis.T @ self.option.own
        self.normal = self.normal - shared.T @ shared


Candidates = Mapping[str, Sequence[_Candidate]]


def _products(candidates: Candidates, residual: Array) -> dict[str, list[Array]]:
    """Return E'y of every candidate, for a residual free of the causes found."""
    return {n: [c.option.own.T @ residual for c in group] for n, group in candidates.items()}


def _ranking(
    candidates: Candidates, products: Mapping[str, Sequence[Array]], variance: float
) -> list[tuple[float, Option]]:
    """Score and best option of every effect, best first."""
    ranking = []
    for name, group in candidates.items():
        if not group:
            continue
        scores = [
            log_evidence(c.normal, right, c.option.size, variance)
            for c, right in zip(group, products[name], strict=True)
        ]
        doubt = DECOY_DOUBT if group[0].option.effect.name in DECOY_NAMES else 0.0
        ranking.append((average(scores) - doubt, group[int(np.argmax(scores))].option))
    return sorted(ranking, key=lambda pair: -pair[0])


def _same_trace(best: Option, other: Option, residual: Array) -> bool:
    """Tell whether another effect can leave the trace of the best one."""
    trace = best.white @ estimate(best.white, best.size, residual).value
    rest = trace - other.white @ estimate(other.white, other.size, trace).value
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
        return -estimate(trial.white, trial.size, residual).gain

    width = option.effect.refine_width
    best = minimize_scalar(
        loss, bounds=(-width, width), method='bounded', options={'xatol': width / 200}
    )
    refined = at(start * float(np.exp(best.x)))
    better = estimate(refined.white, refined.size, residual).gain
    return refined if better > estimate(option.white, option.size, residual).gain else option


def search(
    rows: Rows, options: Mapping[str, Sequence[Option]]
) -> tuple[list[Cause], list[tuple[str, float]]]:
    """Find effects one after the other.

    Returns
    -------
    causes : list of Cause
        In the order found.
    considered : list of (name, score)
        The ranking of the last round.
    """
    residual = rows.residual
    basis = np.zeros((len(residual), 0))
    candidates = {name: [_Candidate(o) for o in group] for name, group in options.items()}
    causes: list[Cause] = []
    considered: list[tuple[str, float]] = []
    while len(causes) < MAX_CAUSES:
        products = _products(candidates, residual)
        first = _ranking(candidates, products, 1.0)
        if not first:
            break
        # noise is judged on what the best candidate leaves: its own trace must not count as noise
        left = fit_out(_free_of(basis, first[0][1]), residual)
        ranking = _ranking(candidates, products, noise_variance(rows, left))
        considered = [(o.effect.name, s) for s, o in ranking]
        if ranking[0][0] < NEEDED_EVIDENCE:
            break
        causes.append(_cause(ranking, basis, rows, residual))
        option = causes[-1].option
        name = option.effect.name
        group = candidates.pop(name)
        if option.effect.wave is not None:  # each axis has a period of its own
            others = [c for c in group if c.option.axes]
            candidates[name] = [c for c in others if not set(c.option.axes) & set(option.axes)]
        taken = _orthonormal(option.white)
        basis = np.concatenate([basis, taken], axis=1)
        residual = residual - taken @ (taken.T @ residual)
        for candidate in chain.from_iterable(candidates.values()):
            candidate.take_out(taken)
    return causes, considered


def _cause(
    ranking: Sequence[tuple[float, Option]], basis: Array, rows: Rows, residual: Array
) -> Cause:
    """The first of a ranking as a cause, with what is not told from it."""
    score = ranking[0][0]
    option = _refined(_free_of(basis, ranking[0][1]), basis, rows, residual)
    close = [
        o.effect.name
        for s, o in ranking[1:]
        if o.effect.name not in DECOY_NAMES
        and (
            s > score - CLOSE_EVIDENCE
            or (s > NEEDED_EVIDENCE and _same_trace(option, _free_of(basis, o), residual))
        )
    ]
    odds = np.array([0.0] + [s for s, _ in ranking])
    confidence = float(np.exp(score - np.logaddexp.reduce(odds)))
    return Cause(option, score, confidence, tuple(close[:4]))


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
    return estimate(white, size, rows.residual)
