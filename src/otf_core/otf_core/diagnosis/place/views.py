# SPDX-License-Identifier: Apache-2.0
"""What figures and words about a gap are made from: plain arrays of every run.

Legs are the independent units: corners separate them, and the noise within one is correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky

from otf_core.arrays import Array, Index
from otf_core.model.path import leg_bounds
from otf_core.noise.noise_model import TYPICAL_CORRELATION_TIME
from otf_core.solving.whitener import Whitener


@dataclass(frozen=True)
class RunView:
    """One run, piece by piece, in driving order.

    Attributes
    ----------
    axis_names : tuple of str
        Of the machine, in the order of the components of ``q``.
    time : ndarray, shape (p,), s
        Since the start of the recording.
    leg : ndarray of int64, shape (p,)
        Number of the leg; a leg driven again has another number.
    q : ndarray, shape (p, 3), m
        Nominal axis positions.
    direction : ndarray, shape (p, 3)
        Unit direction of travel.
    speed : ndarray, shape (p,), m/s
    beam : ndarray, shape (p, 3), m
        From the tracker to the target, machine frame.
    axes : ndarray, shape (c, p, 3)
        Unit directions of the c rows of every piece, perpendicular to the path.
    residual_before, residual_after : ndarray, shape (c, p), m
        Without and with the causes.
    expected : ndarray, shape (c, p), m
        Standard deviation of the noise that the simulation shows there.
    factors : tuple of (tuple of ndarray), optional
        Lower Cholesky factor of the noise covariance, m, of every leg and component: what
        ``normal.Whitener`` uses. Without it, ``expected`` with a typical correlation time.
    """

    name: str
    axis_names: tuple[str, ...]
    time: Array
    leg: Index
    q: Array
    direction: Array
    speed: Array
    beam: Array
    axes: Array
    residual_before: Array
    residual_after: Array
    expected: Array
    factors: tuple[tuple[Array, ...], ...] = ()

    @cached_property
    def bounds(self) -> list[tuple[int, int]]:
        """First piece and one past the last of every leg."""
        return leg_bounds(self.leg)

    @cached_property
    def _scaled(self) -> list[list[Array]]:
        """Factors of the noise of every leg and component, scaled so that it is ``expected``."""
        given = self.factors or tuple(self._typical(low, high) for low, high in self.bounds)
        return [
            [
                factor * (self.expected[c, low:high] / np.linalg.norm(factor, axis=1))[:, None]
                for c, factor in enumerate(leg)
            ]
            for (low, high), leg in zip(self.bounds, given, strict=True)
        ]

    @cached_property
    def whitener(self) -> Whitener:
        """Frees rows of the correlation of the noise."""
        return Whitener.from_factors(self.bounds, self._scaled)

    @cached_property
    def covariances(self) -> list[list[Array]]:
        """Noise covariance of every leg and component, m^2."""
        return [[factor @ factor.T for factor in leg] for leg in self._scaled]

    def _typical(self, low: int, high: int) -> tuple[Array, ...]:
        gap = np.abs(self.time[low:high, None] - self.time[None, low:high])
        matrix = 0.99 * np.exp(-gap / TYPICAL_CORRELATION_TIME) + 0.01 * np.eye(high - low)
        factor = np.asarray(cholesky(matrix, lower=True))
        return (factor,) * len(self.axes)

    def with_noise(self, factor: float) -> RunView:
        """The same with a factor on the noise."""
        return replace(self, expected=factor * self.expected)

    def whiten(self, columns: Array) -> Array:
        """Whiten columns (c, p, k), m, component by component, shape (c p, k)."""
        return self.whitener.whiten(columns).reshape(-1, columns.shape[2])

    def vectors(self, residual: Array) -> Array:
        """Residual (c, p) as vectors in the machine frame, shape (p, 3)."""
        return np.asarray(np.einsum('cp,cpk->pk', residual, self.axes))


def noise_factor(views: Sequence[RunView], simulated: float) -> float:
    """Factor on the noise of runs with which it leaves the residual ``simulated``, m, in all."""
    square = sum(float((v.expected**2).sum()) for v in views)
    pieces = sum(len(v.leg) for v in views)
    return simulated / max(float(np.sqrt(square / pieces)), 1e-300)
