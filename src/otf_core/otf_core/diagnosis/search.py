# SPDX-License-Identifier: Apache-2.0
"""Search for effects: one after the other, each on what the others leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from otf_core.diagnosis.decoys import DECOY_NAMES
from otf_core.diagnosis.evidence import (
    Estimate,
    Option,
    average,
    estimate,
    log_evidence,
)
from otf_core.diagnosis.rows import Rows, column_size
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
    start, total = 0, []
    for run in rows.runs:
        count = len(run.pieces)
        components = 3 if run.pieces.standstill else 2
        part = residual[start : start + components * count].reshape(components, count)
        total.append(check_residuals(part, run.pieces.leg, 0).inflation)
        start += components * count
    return float(np.mean(total))


def fit_out(option: Option, residual: Array) -> Array:
    """Residual less the best fit of one option."""
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
        best = group[int(np.argmax(scores))]
        doubt = DECOY_DOUBT if best.effect.name in DECOY_NAMES else 0.0
        ranking.append((average(scores) - doubt, best))
    return sorted(ranking, key=lambda pair: -pair[0])


def _same_trace(best: Option, other: Option, residual: Array) -> bool:
    """Tell whether another effect can leave the trace of the best one."""
    trace = best.white @ estimate(best.white, best.size, residual).value
    rest = trace - other.white @ estimate(other.white, other.size, trace).value
    power = float(trace @ trace)
    return float(rest @ rest) < max(SAME_TRACE * power, 4.0)


def _refined(option: Option, found: Sequence[Cause], rows: Rows, residual: Array) -> Option:
    """Improve the shape of an option: its spectral line or length is only known to a raster."""
    name = option.effect.refine
    if not name:
        return option
    start = float(option.shape[name])

    def at(place: float) -> Option:
        shape = {**option.shape, name: place}
        plain = rows.plain_columns(option.effect, shape)[:, option.take]
        own = rows.project(rows.whiten(plain))
        white = own
        for cause in found:
            white = _reduced(cause.option.white, white)
        return replace(
            option, shape=shape, plain=plain, own=own, white=white, size=column_size(plain)
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
    remaining = {name: list(group) for name, group in options.items()}
    causes: list[Cause] = []
    considered: list[tuple[str, float]] = []
    while len(causes) < MAX_CAUSES:
        first = _ranking(remaining, residual, 1.0)
        if not first:
            break
        # noise is judged on what the best candidate leaves: its own trace must not count as noise
        variance = noise_variance(rows, fit_out(first[0][1], residual))
        ranking = _ranking(remaining, residual, variance)
        considered = [(o.effect.name, s) for s, o in ranking]
        score, option = ranking[0]
        if score < NEEDED_EVIDENCE:
            break
        option = _refined(option, causes, rows, residual)
        close = [
            o.effect.name
            for s, o in ranking[1:]
            if o.effect.name not in DECOY_NAMES
            and (
                s > score - CLOSE_EVIDENCE
                or (s > NEEDED_EVIDENCE and _same_trace(option, o, residual))
            )
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
        group = remaining.pop(name)
        if option.effect.sample_resolution:  # each axis has a period of its own
            remaining[name] = [o for o in group if not set(o.axes) & set(option.axes) and o.axes]
        residual = _take_out(option, residual, remaining)
    return causes, considered


def _reduced(taken: Array, columns: Array) -> Array:
    """Columns less what the columns of a cause can follow."""
    normal = taken.T @ taken
    ridge = 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    return np.asarray(columns - taken @ np.linalg.solve(normal + ridge, taken.T @ columns))


def _take_out(option: Option, residual: Array, remaining: dict[str, list[Option]]) -> Array:
    """Project an effect out of the residual and of all other effects."""
    for name, group in remaining.items():
        remaining[name] = [
            replace(other, white=_reduced(option.white, other.white)) for other in group
        ]
    return _reduced(option.white, residual)


def fit_jointly(causes: Sequence[Cause], rows: Rows) -> Estimate:
    """Estimate the coefficients of all causes together, jointly with tables and poses."""
    white = np.concatenate([c.option.own for c in causes], axis=1)
    size = np.concatenate([c.option.size for c in causes])
    return estimate(white, size, rows.residual)
