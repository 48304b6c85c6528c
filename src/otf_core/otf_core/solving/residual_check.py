# SPDX-License-Identifier: Apache-2.0
"""How far residuals exceed the assumed noise, in size and in correlation along a leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array

MAX_LAG = 200
"""pieces; longest distance at which residuals are searched for correlation."""


@dataclass(frozen=True)
class ResidualCheck:
    """How the residuals compare with the noise that the weights assume.

    Attributes
    ----------
    variance_ratio : float
        Sum of squared normalised residuals per degree of freedom (s0^2; 1 as specified).
    correlation_factor : float
        1 + 2 * sum of the autocorrelation of successive pieces; 1 for independent residuals.
    """

    variance_ratio: float
    correlation_factor: float

    @property
    def inflation(self) -> float:
        """Factor on the covariance of the estimates; never below 1."""
        return max(1.0, self.variance_ratio * self.correlation_factor)


def check_residuals(whitened: Array, leg: NDArray[np.int64], rank: int) -> ResidualCheck:
    """Compare residuals with the assumed noise.

    Parameters
    ----------
    whitened : ndarray, shape (c, p)
        Residuals freed of the assumed noise covariance, pieces in driving order: independent
        and of unit variance if nothing but that noise is in them. What the model lacks shows as
        size and as correlation between neighbouring pieces of a leg.
    leg : ndarray of int64, shape (p,)
    rank : int
        Number of estimated quantities.
    """
    square = float(np.mean(whitened**2))
    freedom = max(1.0, whitened.size - rank)
    total = 0.0
    for lag in range(1, min(MAX_LAG, len(leg) - 1)):
        same = leg[lag:] == leg[:-lag]
        if same.sum() < 20:
            break
        products = whitened[:, lag:][:, same] * whitened[:, :-lag][:, same]
        correlation = float(products.mean()) / max(square, 1e-300)
        if correlation < 0.05:
            break
        total += correlation
    return ResidualCheck(square * whitened.size / freedom, 1.0 + 2.0 * total)
