# SPDX-License-Identifier: Apache-2.0
"""How much the data speak for an effect.

For columns E (projected, whitened), residuals y with unit variance, and coefficients that are
normal with mean zero and a spread that moves the target by a few micrometres, the logarithm of
the Bayes factor against 'no effect' is

    1/2 v' (I + M)^-1 v - 1/2 log det (I + M),   v = D E' y, M = D E' E D, D the spreads

(the evidence of a linear Gaussian model). The second term is the price of parameters: a flexible
effect does not win by number. Spreads, shapes and subsets of axes are averaged over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.special import logsumexp

from otf_core.effects import Effect, Shape, Terms

Array = NDArray[np.float64]

SPREADS = (5e-7, 2e-6, 8e-6)
"""m; sizes of the displacement that an effect may have, each as likely as the other."""
BLIND = 2e-5
"""m; standard uncertainty of a displacement beyond which a combination is not seen."""


@dataclass(frozen=True)
class Option:
    """One way an effect may act: a shape and the terms that take part.

    Attributes
    ----------
    effect : Effect
    shape : mapping of str to float
    terms : Terms
        Of all runs; columns of one point of the first.
    take : ndarray of int, shape (k,)
        Terms that take part.
    white : ndarray, shape (r, k)
        Whitened columns less what tables, poses and the causes found so far can follow.
    size : ndarray, shape (k,), m
        Root mean square of ``plain`` where it acts at all.
    own : ndarray, shape (r, k)
        Whitened columns less what tables and poses can follow.
    plain : ndarray, shape (r, k)
        Columns as they are, m per unit.
    """

    effect: Effect
    shape: Shape
    terms: Terms
    take: NDArray[np.int64]
    white: Array
    size: Array
    own: Array
    plain: Array

    @property
    def axes(self) -> tuple[str, ...]:
        """Machine axes of the terms that take part."""
        return tuple(sorted({self.terms.axes[i] for i in self.take} - {''}))


@dataclass(frozen=True)
class Estimate:
    """Coefficients of one option.

    Attributes
    ----------
    value : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Of what the data see.
    unseen : ndarray, shape (k, m)
        Combinations that they do not see, each displacing by 1 m.
    gain : float
        Fall of the sum of squares.
    """

    value: Array
    covariance: Array
    unseen: Array
    gain: float


def log_evidence(normal: Array, right: Array, size: Array, variance: float) -> float:
    """Average over ``SPREADS`` of the Bayes factor, as a logarithm.

    Parameters
    ----------
    normal, right : ndarray, shape (k, k) and (k,)
        E'E and E'y.
    size : ndarray, shape (k,), m
    variance : float
        Of the noise left in the residual; 1 if it is as assumed.
    """
    scores = []
    for spread in SPREADS:
        width = spread / np.maximum(size, 1e-300)
        matrix = np.eye(len(width)) + normal * np.outer(width, width) / variance
        scaled = right * width / variance
        factor = linalg.cholesky(matrix, lower=True)
        half = linalg.solve_triangular(factor, scaled, lower=True)
        scores.append(0.5 * float(half @ half) - float(np.log(np.diag(factor)).sum()))
    return float(logsumexp(scores) - np.log(len(SPREADS)))


def estimate(white: Array, size: Array, residual: Array) -> Estimate:
    """Least-squares coefficients; combinations that the data do not see stay zero.

    A combination counts as not seen if the data leave its displacement more than ``BLIND``
    uncertain, such as equal servo lag on all axes.
    """
    scale = np.maximum(size, 1e-300)
    scaled = white / scale
    values, vectors = linalg.eigh(scaled.T @ scaled)
    sure = values > BLIND**-2
    seen = vectors[:, sure]
    inverse = (seen / values[sure]) @ seen.T
    value = inverse @ (scaled.T @ residual)
    fitted = scaled @ value
    gain = float(2 * residual @ fitted - fitted @ fitted)
    unseen = vectors[:, ~sure] / scale[:, None]
    return Estimate(value / scale, inverse / np.outer(scale, scale), unseen, gain)


def axis_subsets(terms: Terms) -> list[NDArray[np.int64]]:
    """All terms, and the terms of each single axis where terms belong to axes."""
    everything = np.arange(len(terms.names))
    subsets = [everything]
    for axis in sorted(set(terms.axes) - {''}):
        own = everything[[a == axis for a in terms.axes]]
        if 0 < own.size < everything.size:
            subsets.append(own)
    return subsets


def average(scores: Sequence[float]) -> float:
    """Logarithm of the mean of Bayes factors given by their logarithms."""
    return float(logsumexp(np.array(scores)) - np.log(len(scores)))
