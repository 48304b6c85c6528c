# SPDX-License-Identifier: Apache-2.0
"""Search for effects: one after the other, each on what the others leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.evidence import (
    Estimate,
    Option,
    average,
    axis_subsets,
    estimate,
    log_evidence,
)
from otf_core.diagnosis.rows import Rows
from otf_core.effects import Effect, Shape
from otf_core.uncertainty import check_residuals

Array = NDArray[np.float64]

NEEDED_EVIDENCE = 9.0
"""Logarithm of the odds that an effect needs before it is named (8000 to 1)."""
CLOSE_EVIDENCE = 5.0
"""Effects within these odds (150 to 1) of the best are not told from it."""
SAME_TRACE = 0.03
"""An effect that can leave all but this share of the squared trace of another is not told
from it."""
MAX_CAUSES = 4
NO_TRACE = 1e-9
"""m per unit; terms that move the target less across the path have no trace at all."""


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


def collect_options(
    rows: Rows, effects: Sequence[Effect], shapes: Mapping[str, Sequence[Shape]]
) -> tuple[dict[str, list[Option]], dict[str, float]]:
    """Project all columns of all effects.

    Parameters
    ----------
    rows : Rows
    effects : sequence of Effect
    shapes : mapping of effect name to shapes
        Where not given, those of the effect itself.

    Returns
    -------
    options : mapping of effect name to list of Option
    visible : mapping of effect name to float
        Largest share of a term that tables and poses leave.
    """
    options: dict[str, list[Option]] = {}
    visible: dict[str, float] = {}
    for effect in effects:
        options[effect.name], visible[effect.name] = [], 0.0
        for shape in shapes.get(effect.name, effect.shapes(rows.states[0])):
            terms = effect.terms(rows.states[0], shape)
            if not terms.names:
                continue
            white, size = rows.columns(lambda s, e=effect, p=shape: e.terms(s, p).columns)
            before = np.einsum('ij,ij->j', white, white)
            white = rows.project(white)
            left = np.einsum('ij,ij->j', white, white) / np.maximum(before, 1e-300)
            left = np.where(size > NO_TRACE, left, 0.0)
            visible[effect.name] = max(visible[effect.name], float(left.max(initial=0.0)))
            for subset in axis_subsets(terms):
                take = subset[size[subset] > NO_TRACE]
                if not take.size:
                    continue
                own = white[:, take]
                part = Option(effect, shape, terms, take, own, size[take], own)
                options[effect.name].append(part)
    return options, visible


def _noise_variance(rows: Rows, residual: Array) -> float:
    """Variance of the noise left in residuals, correlation between pieces included."""
    start, total = 0, []
    for run in rows.runs:
        count = len(run.pieces)
        components = 3 if run.pieces.standstill else 2
        part = residual[start : start + components * count].reshape(components, count)
        total.append(check_residuals(part, run.pieces.leg, 0).inflation)
        start += components * count
    return float(np.mean(total))


def _fit_out(option: Option, residual: Array) -> Array:
    fit = estimate(option.white, option.size, residual)
    return residual - option.white @ fit.value


def _ranking(
    options: Mapping[str, Sequence[Option]], residual: Array, variance: float
) -> list[tuple[float, Option]]:
    """Score and best option of every effect, best first."""
    ranking = []
    for group in options.values():
        if not group:
            continue
        scores = [log_evidence(o.white, o.size, residual, variance) for o in group]
        ranking.append((average(scores), group[int(np.argmax(scores))]))
    return sorted(ranking, key=lambda pair: -pair[0])


def _same_trace(best: Option, other: Option, residual: Array) -> bool:
    """Tell whether another effect can leave the trace of the best one."""
    trace = best.white @ estimate(best.white, best.size, residual).value
    rest = trace - other.white @ estimate(other.white, other.size, trace).value
    power = float(trace @ trace)
    return float(rest @ rest) < max(SAME_TRACE * power, 4.0)


def search(
    rows: Rows, options: Mapping[str, Sequence[Option]]
) -> tuple[list[Cause], Array, list[tuple[str, float]]]:
    """Find effects one after the other.

    Returns
    -------
    causes : list of Cause
        In the order found.
    residual : ndarray, shape (r,)
        Whitened residual with all of them fitted jointly with tables and poses.
    considered : list of (name, score)
        The ranking of the last round.
    """
    residual = rows.residual
    remaining = {name: list(group) for name, group in options.items()}
    causes: list[Cause] = []
    considered: list[tuple[str, float]] = []
    while len(causes) < MAX_CAUSES:
        first = _ranking(remaining, residual, 1.0)
        if not first:
            break
        # noise is judged on what the best candidate leaves: its own trace must not count as noise
        variance = _noise_variance(rows, _fit_out(first[0][1], residual))
        ranking = _ranking(remaining, residual, variance)
        considered = [(o.effect.name, s) for s, o in ranking]
        score, option = ranking[0]
        if score < NEEDED_EVIDENCE:
            break
        close = [
            o.effect.name
            for s, o in ranking[1:]
            if s > score - CLOSE_EVIDENCE or (s > NEEDED_EVIDENCE and _same_trace(option, o, residual))
        ]
        odds = np.array([0.0] + [s for s, _ in ranking])
        confidence = float(np.exp(score - np.logaddexp.reduce(odds)))
        name = option.effect.name
        causes.append(
            Cause(
                option,
                score,
                confidence,
                tuple(close[:4]),
            )
        )
        remaining.pop(name)
        residual = _take_out(option, residual, remaining)
    return causes, residual, considered


def _take_out(option: Option, residual: Array, remaining: dict[str, list[Option]]) -> Array:
    """Project an effect out of the residual and of all other effects."""
    normal = option.white.T @ option.white
    ridge = 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    inverse = np.linalg.inv(normal + ridge)

    def reduced(columns: Array) -> Array:
        return np.asarray(columns - option.white @ (inverse @ (option.white.T @ columns)))

    for name, group in remaining.items():
        remaining[name] = [replace(other, white=reduced(other.white)) for other in group]
    return reduced(residual)


def fit_jointly(causes: Sequence[Cause], rows: Rows) -> Estimate:
    """Estimate the coefficients of all causes together, jointly with tables and poses."""
    white = np.concatenate([c.option.own for c in causes], axis=1)
    size = np.concatenate([c.option.size for c in causes])
    return estimate(white, size, rows.residual)
