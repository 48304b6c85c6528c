# SPDX-License-Identifier: Apache-2.0
"""How much the data speak for an effect.

For columns E (projected, whitened), residuals y with unit variance, and coefficients that are
normal with mean zero and a spread that moves the target by a few micrometres, the logarithm of
the Bayes factor against 'no effect' is

    1/2 v' (I + M)^-1 v - 1/2 log det (I + M),   v = D E' y, M = D E' E D, D the spreads

(the evidence of a linear Gaussian model). The second term is the price of parameters: a flexible
effect does not win by number. Spreads, shapes and subsets of axes are averaged over.

Coefficients of a free form are the smaller the higher their order, by a power that is averaged
over as well; they are estimated with the spread and the power that the data make most likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import lapack

from otf_core.arrays import Array
from otf_core.effects import Effect, Shape, Terms

SPREADS = (5e-7, 2e-6, 8e-6)
"""m; sizes of the displacement that an effect may have, each as likely as the other."""
ROUGHNESS = (1.0, 2.0)
"""Powers of 1 + order by which the coefficients of a free form become smaller."""
BLIND = 2e-5
"""m; standard uncertainty of a displacement beyond which a combination is not seen."""

TOGETHER = 3
"""Motions that waves between the nodes are looked for in at once, beside all of an axis."""


@dataclass(frozen=True)
class Option:
    """One way an effect may act: a shape and the terms that take part.

    Attributes
    ----------
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
    width : ndarray, shape (k,), m
        Standard deviation of the displacement by each coefficient before the data; empty for a
        formula, whose coefficients are free.
    """

    effect: Effect
    shape: Shape
    terms: Terms
    take: NDArray[np.int64]
    white: Array
    size: Array
    own: Array
    plain: Array
    width: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def widths(self) -> Array:
        """``width``, infinite for a formula, shape (k,)."""
        return self.width if len(self.width) else np.full(len(self.take), np.inf)

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


def prior_widths(orders: Array) -> list[Array]:
    """Standard deviations of the displacement by each coefficient that are averaged over, m.

    Parameters
    ----------
    orders : ndarray, shape (k,)
        Of the functions of a free form; empty for a formula.
    """
    if not len(orders):
        return [np.array(spread) for spread in SPREADS]
    return [spread * (1.0 + orders) ** -power for spread in SPREADS for power in ROUGHNESS]


def log_evidence(
    normal: Array, right: Array, size: Array, variance: float, orders: Array | None = None
) -> float:
    """Average of the Bayes factor over ``prior_widths``, as a logarithm.

    Parameters
    ----------
    normal, right : ndarray, shape (k, k) and (k,)
        E'E and E'y.
    size : ndarray, shape (k,), m
    variance : float
        Of the noise left in the residual; 1 if it is as assumed.
    orders : ndarray, shape (k,), optional
        Of the functions of a free form.
    """
    widths = prior_widths(np.zeros(0) if orders is None else orders)
    scores = [_evidence(normal, right, _per_unit(w, size), variance) for w in widths]
    return average(scores)


def joint_evidence(options: Sequence[Option], residual: Array, variance: float) -> float:
    """Bayes factor of options together against nothing, as a logarithm.

    Free forms have their likeliest widths; the coefficients of formulas are averaged over
    ``SPREADS``, the same for all.
    """
    if not options:
        return 0.0
    size = np.concatenate([o.size for o in options])
    normal, right = products_of(options, residual)
    widths = [np.concatenate([o.widths for o in options])] * len(SPREADS)
    widths = [
        np.where(np.isfinite(w), w, spread) for w, spread in zip(widths, SPREADS, strict=True)
    ]
    return average([_evidence(normal, right, _per_unit(w, size), variance) for w in widths])


def products_of(
    options: Sequence[Option], residual: Array, rows: slice | NDArray[np.bool_] = slice(None)
) -> tuple[Array, Array]:
    """E'E, shape (k, k), and E'y, shape (k,), of options together, by some of the rows."""
    parts, y = [o.own[rows] for o in options], residual[rows]
    normal = np.block([[one.T @ other for other in parts] for one in parts])
    return normal, np.concatenate([part.T @ y for part in parts])


def likeliest_width(
    normal: Array, right: Array, size: Array, variance: float, orders: Array
) -> Array:
    """The one of ``prior_widths`` that makes the data most likely, shape (k,), m."""
    widths = prior_widths(orders)
    scores = [_evidence(normal, right, _per_unit(w, size), variance) for w in widths]
    return widths[int(np.argmax(scores))]


def _per_unit(width: Array, size: Array) -> Array:
    """Widths in units of the coefficients; 0 of those that displace nothing anywhere."""
    return np.where(size > 1e-300, width / np.maximum(size, 1e-300), 0.0)


def _evidence(normal: Array, right: Array, width: Array, variance: float) -> float:
    # straight from LAPACK: some ten thousand small ones, for which the checks take longer
    matrix = normal * np.outer(width, width) / variance
    matrix.flat[:: len(width) + 1] += 1.0
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if failed:
        raise np.linalg.LinAlgError('products of columns are not positive definite')
    half, _ = lapack.dtrtrs(factor, right * width / variance, lower=1)
    return 0.5 * float(half.ravel() @ half.ravel()) - float(np.log(factor.diagonal()).sum())


def estimate(white: Array, size: Array, residual: Array, width: Array | None = None) -> Estimate:
    """Least-squares coefficients; combinations that the data do not see stay zero.

    A combination counts as not seen if the data leave its displacement more than ``BLIND``
    uncertain, such as equal servo lag on all axes.

    Parameters
    ----------
    white, size, residual
        See ``Option`` and ``Rows``.
    width : ndarray, shape (k,), m, optional
        Standard deviation of the displacement by each coefficient before the data, infinite where
        nothing is known.
    """
    return estimate_of(white.T @ white, white.T @ residual, size, width)


def estimate_of(normal: Array, right: Array, size: Array, width: Array | None = None) -> Estimate:
    """``estimate`` by the products E'E, shape (k, k), and E'y, shape (k,), alone."""
    scale = np.maximum(size, 1e-150)  # what does not move at all; its square must not vanish
    scaled, pull = normal / np.outer(scale, scale), right / scale
    known = np.zeros(len(scale)) if width is None else width**-2.0
    values, vectors = linalg.eigh(scaled + np.diag(known))
    sure = values > BLIND**-2
    seen = vectors[:, sure]
    inverse = (seen / values[sure]) @ seen.T
    value = inverse @ pull
    gain = float(2 * pull @ value - value @ scaled @ value)
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


def motions_of(option: Option) -> set[str]:
    """Motions of the terms that take part: MOTION@... is a term of MOTION."""
    return {_motion(option.terms.names[k]) for k in option.take}


def motions_of_takes(
    names: Sequence[str], takes: Sequence[NDArray[np.int64]]
) -> list[frozenset[str]]:
    """Motions of several choices of terms."""
    motions = [_motion(name) for name in names]
    return [frozenset(motions[k] for k in take.tolist()) for take in takes]


def _motion(name: str) -> str:
    return name.partition('@')[0]


def motion_subsets(terms: Terms) -> list[NDArray[np.int64]]:
    """The same, and the terms of any one to ``TOGETHER`` motions."""
    motions = np.array([_motion(name) for name in terms.names])
    names = list(dict.fromkeys(motions.tolist()))
    chosen = (c for count in range(1, TOGETHER + 1) for c in combinations(names, count))
    return axis_subsets(terms) + [np.flatnonzero(np.isin(motions, c)) for c in chosen]


def average(scores: Sequence[float] | Array) -> float:
    """Logarithm of the mean of Bayes factors given by their logarithms."""
    return float(np.logaddexp.reduce(scores) - np.log(len(scores)))
