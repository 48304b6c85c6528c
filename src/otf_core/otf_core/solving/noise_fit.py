# SPDX-License-Identifier: Apache-2.0
"""How much noise there is, as the residuals of a run say it.

Standstills show the noise of the tracker at rest, some of it for too short a time, and nothing of
what the model lacks. So the sizes of five parts of the covariance S of a line are fitted: white
and slow noise of the tracker, its correlation time, misfit of single pieces and of whole lines.
Their logarithms (of factors, for the tracker) maximise the restricted likelihood: with e the
residual of a solution whose estimates have the posterior covariance V, E[e e^T] = S - A V A^T, and
for K = dS by a logarithm

    score = (e^T S^-1 K S^-1 e - tr P K) / 2,  P = S^-1 - S^-1 A V A^T S^-1,
    information = tr(P K P K') / 2

What standstills or the specification say is the prior.

References
----------
Harville, J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from otf_core.model.path import leg_bounds
from otf_core.noise.model import (
    INDEPENDENT,
    LASTING,
    MODEL_FLOOR,
    SLOW,
    WHITE,
    NoiseModel,
    misfit_of,
    scaled,
)
from otf_core.pieces.pieces import Pieces
from otf_core.solving.system import System
from otf_core.solving.whitener import leg_parts

Array = NDArray[np.float64]

PRIOR = np.array([0.7, 0.7, 0.7, 5.0, 5.0])
"""Standard deviation of the logarithms of the four variances and of the correlation time."""
LOWEST = np.array([-4.0, -6.0, np.log(1.0 / 30.0), np.log(4e-16), np.log(4e-16)])
HIGHEST = np.array([8.0, 8.0, np.log(200.0), np.log(1e-6), np.log(1e-6)])
LINES, PIECES = 48, 100
"""Lines and pieces of each that are looked at: five numbers need no more."""
STEPS = 6
LONGEST_STEP = 1.5
SETTLED, CERTAIN = 0.03, 0.3
"""Steps that are smaller, or than this share of their standard deviation, end the search."""
_DERIVATIVE = 1e-3
_LONGER = np.array([0.0, 0.0, np.log1p(_DERIVATIVE)])


@dataclass(frozen=True)
class FittedNoise:
    """Sizes of noise and misfit.

    Attributes
    ----------
    logs : ndarray, shape (5,)
        For ``noise.scaled`` and ``noise.misfit_of``.
    u : ndarray, shape (5,)
        Their standard uncertainties.
    """

    logs: Array
    u: Array


@dataclass(frozen=True)
class _Line:
    """A part of a line of one component: where it is, residual, and A V A^T."""

    component: int
    low: int
    high: int
    residual: Array
    explained: Array


def _lines(system: System, pieces: Pieces, residual: Array, covariance: Array) -> list[_Line]:
    bounds = [(low, min(high, low + PIECES)) for low, high in leg_bounds(pieces.leg)]
    chosen = np.unique(np.linspace(0, len(bounds) - 1, LINES).round().astype(int))
    found = []
    for low, high in (bounds[k] for k in chosen):
        for component in range(len(residual)):
            dense = system.rows.dense(slice(low, high))[component]
            explained = dense @ covariance @ dense.T
            found.append(_Line(component, low, high, residual[component, low:high], explained))
    return found


def _derivatives(
    system: System, pieces: Pieces, noise: NoiseModel, logs: Array, line: _Line
) -> list[Array]:
    now, misfit = scaled(noise, logs), misfit_of(logs)
    place = (line.component, line.low, line.high)
    white, slow, independent, lasting = leg_parts(system, pieces, now, misfit, *place)
    longer = scaled(now, _LONGER)
    other = leg_parts(system, pieces, longer, misfit, *place)[1]
    return [white, slow, (other - slow) / _DERIVATIVE, independent, lasting]


def _slopes(
    system: System, pieces: Pieces, noise: NoiseModel, logs: Array, lines: list[_Line]
) -> tuple[Array, Array]:
    """Score and information of the logarithms, prior left out."""
    score, information = np.zeros(5), np.zeros((5, 5))
    for line in lines:
        parts = _derivatives(system, pieces, noise, logs, line)
        total = parts[WHITE] + parts[SLOW] + parts[INDEPENDENT] + parts[LASTING]
        inverse = linalg.cho_solve(linalg.cho_factor(total, lower=True), np.eye(len(total)))
        P = inverse - inverse @ line.explained @ inverse
        pull = inverse @ line.residual
        moved = [P @ K for K in parts]
        for i, K in enumerate(parts):
            score[i] += 0.5 * float(pull @ K @ pull - np.trace(moved[i]))
            for j in range(i + 1):
                information[i, j] += 0.5 * float(np.sum(moved[i] * moved[j].T))
    return score, information + np.tril(information, -1).T


def fit_noise(
    system: System,
    pieces: Pieces,
    residual: Array,
    noise: NoiseModel,
    covariance: Array,
    start: Array | None = None,
) -> FittedNoise:
    """Fit the sizes of noise and misfit to the residuals of a run.

    Parameters
    ----------
    system : System
    pieces : Pieces
    residual : ndarray, shape (c, p), m
    noise : NoiseModel
        As standstills or specification say it; the prior.
    covariance : ndarray, shape (full, full)
        Posterior covariance of the estimates.
    start : ndarray, shape (5,), optional

    Returns
    -------
    FittedNoise
    """
    floor = 2.0 * np.log(MODEL_FLOOR)
    prior = np.array([0.0, 0.0, 0.0, floor, floor])
    logs = prior.copy() if start is None else start
    lines = _lines(system, pieces, residual, covariance)
    for _ in range(STEPS):
        score, information = _slopes(system, pieces, noise, logs, lines)
        score -= (logs - prior) / PRIOR**2
        information += np.diag(1.0 / PRIOR**2)
        step = np.linalg.solve(information, score)
        step *= min(1.0, LONGEST_STEP / float(np.abs(step).max()))
        moved = np.clip(logs + step, LOWEST, HIGHEST)
        change, logs = np.abs(moved - logs), moved
        known = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.all(change < np.maximum(SETTLED, CERTAIN * known)):
            break
    return FittedNoise(logs, known)
