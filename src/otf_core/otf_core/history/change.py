# SPDX-License-Identifier: Apache-2.0
"""Has something changed between two runs: chi-square of a difference, motion by motion.

d' C^+ d of a difference d with covariance C (JCGM 102) is chi-square distributed with rank(C)
degrees of freedom if nothing has changed. Contributions that both runs share, such as the scale
of one tracker, are counted twice in C: the test errs to the side of no change. Motions that are
looked at together share one probability of a false alarm (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.history.series import Series

LEVEL = 0.0027
"""Probability of a false alarm, all motions together: limits of three sigma of a control chart."""
SMALLEST = 1e-9
"""Relative size of singular values that count as zero."""


@dataclass(frozen=True)
class Change:
    """Difference of a motion, a squareness error or of all.

    Attributes
    ----------
    size : float
        Root mean square over the nodes, m or rad.
    expected : float
        The same, if nothing has changed: of the standard uncertainties.
    p : float
        Probability of a difference as large or larger, if nothing has changed.
    tests : int
        Differences that are looked at together with this one.
    """

    size: float
    expected: float
    p: float
    tests: int = 1

    @property
    def significant(self) -> bool:
        """Tell whether it is beyond the limits of a control chart."""
        return self.p < LEVEL / self.tests


def chi_square(difference: Array, covariance: Array) -> tuple[float, int]:
    """Chi-square of a difference and its degrees of freedom."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    seen = values > SMALLEST * max(float(values[-1]), 1e-300)
    parts = vectors[:, seen].T @ (difference / scale)
    return float(np.sum(parts**2 / values[seen])), int(seen.sum())


def probability(chi2: float, dof: int) -> float:
    """Probability of a chi-square as large or larger."""
    from scipy.special import chdtrc  # loaded on use

    return float(chdtrc(dof, chi2)) if dof else 1.0


def change_of(difference: Array, covariance: Array, tests: int = 1) -> Change:
    """Judge a difference by its covariance."""
    variance = np.diag(covariance)
    known = variance > 1e-30
    if not known.any():
        return Change(0.0, 0.0, 1.0, tests)
    part = np.ix_(known, known)
    chi2, dof = chi_square(difference[known], covariance[part])
    return Change(
        math.sqrt(float(np.mean(difference[known] ** 2))),
        math.sqrt(float(np.mean(variance[known]))),
        probability(chi2, dof),
        tests,
    )


def changes(series: Series, a: int, b: int) -> dict[str, Change]:
    """What changed from run a to run b, by motion and squareness error."""
    difference = series.values[b] - series.values[a]
    return by_motion(series, difference, series.covariances[a] + series.covariances[b])


def by_motion(series: Series, difference: Array, covariance: Array) -> dict[str, Change]:
    """Judge a difference of vectors of a series, motion by motion."""
    parts = series.parts
    return {n: change_of(difference[p], covariance[p, p], len(parts)) for n, p in parts.items()}


def volume_change(series: Series, a: int, b: int) -> Change:
    """The same over the volume: mean length of the error vectors, best rigid motion taken out."""
    difference = series.values[b] - series.values[a]
    covariance = series.covariances[a] + series.covariances[b]
    whole = change_of(difference, covariance)
    rows = series.field_rows
    variance = np.einsum('ij,ij->i', rows @ covariance, rows).reshape(-1, 3).sum(axis=1)
    expected = float(np.mean(np.sqrt(np.maximum(variance, 0.0))))
    return Change(float(series.lengths(difference).mean()), expected, whole.p)
