# SPDX-License-Identifier: Apache-2.0
"""Sizes of noise and misfit of a run, fitted to its residuals as variance components.

Standstills show the noise of the tracker at rest, some of it for too short a time, and nothing of
model errors. So the sizes of five parts of the covariance S of a line are fitted: white and slow
noise of the tracker, its correlation time, misfit of single pieces and of whole lines. Their
logarithms (of factors, for the tracker) maximise the restricted likelihood: with e the residual
of a solution whose estimates have the posterior covariance V, E[e e^T] = S - A V A^T, and for K =
dS by a logarithm

    score = (e^T S^-1 K S^-1 e - tr P K) / 2,  P = S^-1 - S^-1 A V A^T S^-1,
    information = tr(P K P K') / 2

The prior is what standstills or the specification state.

References
----------
Harville, J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.model.path import leg_bounds
from otf_core.noise.noise_model import (
    INDEPENDENT,
    LASTING,
    MODEL_FLOOR,
    SLOW,
    WHITE,
    NoiseModel,
    Windows,
    add_to_diagonal,
    covariance_parts,
    misfit_of,
    noise_covariance,
    scale_noise,
)
from otf_core.pieces.pieces import Pieces
from otf_core.solving.design import Design
from otf_core.solving.system import System

PRIOR_SIGMAS = np.array([0.7, 0.7, 0.7, 5.0, 5.0])
"""Standard deviation of the logarithms of the four variances and of the correlation time."""
LOWER_BOUNDS = np.array([-4.0, -6.0, np.log(1.0 / 30.0), np.log(4e-16), np.log(4e-16)])
UPPER_BOUNDS = np.array([8.0, 8.0, np.log(200.0), np.log(1e-6), np.log(1e-6)])
MAX_LINES, MAX_PIECES_PER_LINE = 48, 100
"""Lines and pieces of each that are used: five numbers need no more."""
MAX_STEPS = 6
MAX_STEP = 1.5
FINAL_STEP, FINAL_SHARE_OF_SIGMA = 0.03, 0.3
"""Steps that are smaller, or than this share of their standard deviation, end the search."""
_DIAGONAL = (WHITE, INDEPENDENT)
"""Parts of the covariance without any between pieces."""
_DERIVATIVE = 1e-3
_LONGER = np.array([0.0, 0.0, np.log1p(_DERIVATIVE)])


@dataclass(frozen=True)
class FittedNoise:
    """Sizes of noise and misfit.

    Attributes
    ----------
    logs : ndarray, shape (5,)
        For ``noise_model.scale_noise`` and ``noise_model.misfit_of``.
    u : ndarray, shape (5,)
        Their standard uncertainties.
    """

    logs: Array
    u: Array


@dataclass(frozen=True)
class _Lines:
    """Parts of lines, n of them of m pieces, all c components.

    Attributes
    ----------
    shares : ndarray, shape (3, c, n, m)
        See ``noise_model.beam_shares``.
    windows : tuple of time, duration (s) and count, each of shape (n, m)
    residual : ndarray, shape (c, n, m), m
    explained : ndarray, shape (c, n, m, m), m^2
        A V A^T.
    """

    shares: Array
    windows: Windows
    residual: Array
    explained: Array


def _lines(system: System, pieces: Pieces, residual: Array, covariance: Array) -> list[_Lines]:
    bounds = [(low, min(high, low + MAX_PIECES_PER_LINE)) for low, high in leg_bounds(pieces.leg)]
    chosen = np.unique(np.linspace(0, len(bounds) - 1, MAX_LINES).round().astype(int))
    low, high = np.array(bounds)[chosen].T

    def of_size(size: int) -> _Lines:
        own = low[high - low == size, None] + np.arange(size)
        explained = _explained(system.rows, own, covariance)
        windows = (pieces.time[own], pieces.duration[own], pieces.count[own])
        return _Lines(system.shares[:, :, own], windows, residual[:, own], explained)

    return [of_size(size) for size in np.unique(high - low).tolist()]


def _explained(rows: Design, lines: Index, covariance: Array) -> Array:
    """A V A^T of the pieces (n, m) of lines, shape (c, n, m, m), m^2."""
    use, flat = rows.touched(lines.ravel())
    own = flat.reshape(len(flat), *lines.shape, len(use))
    half = (flat @ covariance[np.ix_(use, use)]).reshape(own.shape)
    return np.asarray(half @ np.swapaxes(own, -1, -2))


def _derivatives(noise: NoiseModel, logs: Array, lines: _Lines) -> list[Array]:
    """Parts of the covariance by their places, (..., m) where diagonal, else (..., m, m), m^2."""
    now, misfit = scale_noise(noise, logs), misfit_of(logs)
    white, slow, independent, lasting = covariance_parts(now, misfit, lines.shares, lines.windows)
    longer = scale_noise(now, _LONGER)
    other = noise_covariance(longer, lines.shares, lines.shares, lines.windows)[1]
    return [white, slow, (other - slow) / _DERIVATIVE, independent, lasting]


def _slopes(noise: NoiseModel, logs: Array, groups: list[_Lines]) -> tuple[Array, Array]:
    """Score and information of the logarithms, prior left out."""
    parts = [_slopes_of(noise, logs, lines) for lines in groups]
    score, information = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    return score, information


def _slopes_of(noise: NoiseModel, logs: Array, lines: _Lines) -> tuple[Array, Array]:
    """What some lines add to the score and to the information."""
    parts = _derivatives(noise, logs, lines)
    whole = add_to_diagonal(parts[SLOW] + parts[LASTING], parts[WHITE] + parts[INDEPENDENT])
    inverse = np.linalg.inv(whole)
    P = inverse - inverse @ lines.explained @ inverse
    pull = inverse @ lines.residual[..., None]
    moved, pulled = np.empty((len(parts), *P.shape)), np.empty(len(parts))
    for k, K in enumerate(parts):
        if k in _DIAGONAL:
            np.multiply(P, K[..., None, :], out=moved[k])
            pulled[k] = np.sum(pull * (K[..., None] * pull))
        else:
            np.matmul(P, K, out=moved[k])
            pulled[k] = np.sum(pull * (K @ pull))
    trace = np.trace(moved, axis1=-2, axis2=-1).sum(axis=(1, 2))
    score = 0.5 * (pulled - trace)
    turned = np.ascontiguousarray(np.swapaxes(moved, -1, -2)).reshape(len(parts), -1)
    return score, 0.5 * (moved.reshape(len(parts), -1) @ turned.T)


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
    residual : ndarray, shape (c, p), m
    noise : NoiseModel
        From standstills or specification; the prior.
    covariance : ndarray, shape (full, full)
        Posterior covariance of the estimates.
    start : ndarray, shape (5,), optional
    """
    floor = 2.0 * np.log(MODEL_FLOOR)
    prior = np.array([0.0, 0.0, 0.0, floor, floor])
    logs = prior.copy() if start is None else start
    lines = _lines(system, pieces, residual, covariance)
    share, last = 1.0, np.zeros(len(logs))
    for _ in range(MAX_STEPS):
        score, information = _slopes(noise, logs, lines)
        score -= (logs - prior) / PRIOR_SIGMAS**2
        information += np.diag(1.0 / PRIOR_SIGMAS**2)
        step = np.linalg.solve(information, score)
        share *= 0.5 if step @ last < 0.0 else 1.0  # to and fro: too far each time
        step *= min(share, MAX_STEP / float(np.abs(step).max()))
        moved = np.clip(logs + step, LOWER_BOUNDS, UPPER_BOUNDS)
        last, logs = moved - logs, moved
        known = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.all(np.abs(last) < np.maximum(FINAL_STEP, FINAL_SHARE_OF_SIGMA * known)):
            break
    return FittedNoise(logs, known)


NOISE_SETTLED = 0.1
"""Change of the logarithms of noise and misfit below which they count as settled."""


def is_same_noise(fitted: FittedNoise, before: Array) -> bool:
    """Return whether noise has settled: it changed by little, or by less than is known of it."""
    change = np.abs(fitted.logs - before)
    return bool(np.all(change < np.maximum(NOISE_SETTLED, 0.5 * fitted.u)))
