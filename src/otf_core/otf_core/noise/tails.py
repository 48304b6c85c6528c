# SPDX-License-Identifier: Apache-2.0
"""Tails of noise: excess kurtosis and the degrees of freedom of a Student distribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from otf_core.arrays import Array

SMOOTHING = 0.1
"""s; slower noise is taken off first, so that its wandering does not count as tails."""
MAX_VALUES = 5_000
"""Values that the likelihood is taken over."""
FREEDOMS = np.geomspace(2.2, 60.0, 30)
"""Degrees of freedom tried; more are not told from normal."""


@dataclass(frozen=True)
class Tails:
    """Tails of the fast noise of one quantity.

    Attributes
    ----------
    excess_kurtosis : float
        0 for normal noise.
    freedom : float or None
        Degrees of freedom of the likeliest Student distribution; None if normal serves as well.
    beyond : float
        Share of values beyond 4 standard deviations; 6e-5 for normal noise.
    """

    excess_kurtosis: float
    freedom: float | None
    beyond: float


def _log_likelihoods(square: Array, freedom: Array) -> Array:
    """Largest log-likelihoods over the scale, found by expectation and maximisation.

    Of squares (n,) for degrees of freedom (f,), shape (f,).
    """
    free, scale = freedom[:, None], np.full((len(freedom), 1), float(np.median(square)) or 1.0)
    for _ in range(20):
        share = square / (square + free * scale)
        scale = (free + 1) * scale * share.mean(axis=1, keepdims=True)
    rest = (0.5 * (free + 1) * np.log1p(square / (free * scale))).sum(axis=1)
    constant = gammaln(0.5 * (freedom + 1)) - gammaln(0.5 * freedom)
    constant -= 0.5 * np.log(np.pi * freedom * scale[:, 0])
    return np.asarray(square.size * constant - rest)


def student_likelihood(values: Array) -> tuple[Array, float]:
    """Log-likelihoods of Student's t for each of ``FREEDOMS``, and of the normal distribution."""
    values = values[:: max(1, values.size // MAX_VALUES)]
    square = values**2 / max(float(np.mean(values**2)), 1e-300)
    normal = -0.5 * square.size * (np.log(2 * np.pi) + 1.0)
    return _log_likelihoods(square, FREEDOMS), float(normal)


def student_freedom(values: Array) -> float | None:
    """Degrees of freedom by maximum likelihood; None if normal fits as well (1 % level)."""
    likelihood, normal = student_likelihood(values)
    best = int(likelihood.argmax())
    return float(FREEDOMS[best]) if likelihood[best] > normal + 3.3 else None


def _moving_mean(values: Array, half: int) -> Array:
    """Means of values (n, c) and ``half`` on either side, mirrored at the ends.

    Of values about zero, as sums are subtracted; importing ``scipy.ndimage`` takes 25 ms.
    """
    padded = np.pad(values, ((half + 1, half), (0, 0)), mode='symmetric')
    sums = np.cumsum(padded, axis=0)
    return np.asarray((sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1))


def fast_part(windows: Sequence[Array], step: float) -> Array:
    """Values (n, c) of all windows less slower noise, of unit variance in every window."""
    half = max(2, round(0.5 * SMOOTHING / step))
    width = 2 * half + 1
    rest = [w - w.mean(axis=0) for w in windows]
    rest = [w - _moving_mean(w, half) for w in rest]
    sized = [r / np.maximum(r.std(axis=0), 1e-300) for r in rest if len(r) > width]
    return np.concatenate(sized or rest)


def tails(windows: Sequence[Array], step: float) -> tuple[Tails, ...]:
    """Tails of each quantity over windows (n, c) of values ``step`` seconds apart."""
    found = []
    for column in fast_part(windows, step).T:
        square = float(np.mean(column**2)) or 1.0
        found.append(
            Tails(
                float(np.mean(column**4) / square**2 - 3.0),
                student_freedom(column),
                float(np.mean(np.abs(column) > 4.0 * np.sqrt(square))),
            )
        )
    return tuple(found)
