# SPDX-License-Identifier: Apache-2.0
"""How fast a machine drifts, and until when its tables hold.

Least-squares line of every node over time since the last event: rate = sum c_k x_k with
c_k = (t_k - mean t) / sum (t - mean t)^2, covariance sum c_k^2 C_k, widened where the runs scatter
about the line more than their uncertainties say (Birge ratio). The volume drifts by the mean
length of the rates on a grid, best rigid motion taken out.

Whether a line describes the runs at all is tested from three runs on: what is left of every motion
about its generalised least-squares line is chi-square distributed if it does. Where it does not,
the line says nothing about the days to come, and the pace of the last step stands in for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.history.change import LEVEL, Change, by_motion, change_of, chi_square, probability
from otf_core.history.series import Series
from otf_core.model.expanded import COVERAGE_FACTOR

SMALLEST = 1e-9
"""Relative size of eigenvalues that count as zero."""
CHANCE = 0.05
"""Probability of a false alarm of a drift."""


@dataclass(frozen=True)
class Drift:
    """Rates per day since the last event.

    Attributes
    ----------
    rate : ndarray, shape (m,), m or rad per day
    motions : mapping of motion or squareness error to Change
        Per day.
    volume : float
        Mean length of the rates on the grid, m per day.
    u_volume : float
        Its standard uncertainty.
    birge : float
        Scatter about the line over what the uncertainties say; 1 for two runs.
    p : float
        Probability of rates as large or larger without drift.
    runs : int
        Runs that it is estimated from.
    p_line : mapping of motion or squareness error to float
        Probability that what is left about a straight line is as large or larger if there is one;
        empty for two runs, which any line fits.
    """

    rate: Array
    motions: dict[str, Change]
    volume: float
    u_volume: float
    birge: float
    p: float
    runs: int
    p_line: dict[str, float]

    @property
    def significant(self) -> bool:
        """Tell whether the drift is beyond what chance gives (5 %).

        Two runs are one step, which is judged as every other step.
        """
        return self.p < (CHANCE if self.runs > 2 else LEVEL)

    @property
    def bent(self) -> list[str]:
        """Motions that a straight line does not describe, the worst first."""
        found = [n for n, p in self.p_line.items() if p < LEVEL / len(self.p_line)]
        return sorted(found, key=self.p_line.__getitem__)


@dataclass(frozen=True)
class Due:
    """When the drift reaches a limit, days after the last run.

    Attributes
    ----------
    limit : float
        m; mean volumetric drift that is allowed.
    days : float or None
        None if no drift is seen.
    earliest : float
        95 %: not before.
    latest : float or None
        95 %: not after; None if that cannot be said.
    withheld : str
        Why there is no date, in words; empty where there is one or no drift is seen.
    """

    limit: float
    days: float | None
    earliest: float
    latest: float | None
    withheld: str = ''


def drift_of(series: Series) -> Drift | None:
    """Estimate the drift; None from fewer than two runs at different times."""
    days = series.days
    spread = days - days.mean()
    total = float(np.sum(spread**2))
    if len(days) < 2 or total <= 0.0:
        return None
    weight = spread / total
    rate = weight @ series.values
    covariance = np.einsum('r,rij->ij', weight**2, series.covariances)
    birge = _scatter(series, rate, spread)
    covariance = covariance * birge**2
    rows = series.field_rows
    field = (rows @ rate).reshape(-1, 3)
    length = np.linalg.norm(field, axis=1)
    unit = field / np.maximum(length, 1e-300)[:, None]
    slope = np.einsum('nc,ncm->m', unit, rows.reshape(len(unit), 3, -1)) / len(unit)
    return Drift(
        rate,
        by_motion(series, rate, covariance),
        float(length.mean()),
        float(np.sqrt(max(float(slope @ covariance @ slope), 0.0))),
        birge,
        change_of(rate, covariance).p,
        len(days),
        _line_probabilities(series),
    )


def _inverse(matrix: Array) -> tuple[Array, int]:
    """Pseudo-inverse of a symmetric matrix, and its rank."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    seen = values > SMALLEST * max(float(values[-1]), 1e-300)
    root = vectors[:, seen] / np.sqrt(values[seen]) / scale[:, None]
    return root @ root.T, int(seen.sum())


def _line_probabilities(series: Series) -> dict[str, float]:
    if len(series.runs) < 3:
        return {}
    return {name: _line_probability(series, part) for name, part in series.parts.items()}


def _line_probability(series: Series, part: slice) -> float:
    """Probability of the scatter of a motion about its generalised least-squares line."""
    known = np.all(np.diagonal(series.covariances, axis1=1, axis2=2)[:, part] > 1e-30, axis=0)
    which = np.arange(part.start, part.stop)[known]
    if not len(which):
        return 1.0
    values = series.values[:, which] - series.values[:, which].mean(axis=0)
    spread = series.days - series.days.mean()
    spread = spread / np.sqrt(np.mean(spread**2))
    normal = np.zeros((2 * len(which),) * 2)
    right, square, dof = np.zeros(len(normal)), 0.0, 0
    for time, value, covariance in zip(spread, values, series.covariances, strict=True):
        weight, rank = _inverse(covariance[np.ix_(which, which)])
        line = np.array([1.0, time])
        normal += np.kron(np.outer(line, line), weight)
        right += np.kron(line, weight @ value)
        square += float(value @ weight @ value)
        dof += rank
    inverse, rank = _inverse(normal)
    return probability(max(square - float(right @ inverse @ right), 0.0), dof - rank)


def _scatter(series: Series, rate: Array, spread: Array) -> float:
    """Birge ratio of the runs about their line, at least 1."""
    if len(spread) < 3:
        return 1.0
    left = series.values - series.values.mean(axis=0) - spread[:, None] * rate
    found = [
        chi_square(x[seen], c[np.ix_(seen, seen)])
        for x, c in zip(left, series.covariances, strict=True)
        for seen in [np.diag(c) > 1e-30]
    ]
    chi2, dof = sum(f[0] for f in found), sum(f[1] for f in found)
    free = dof * (len(spread) - 2) / len(spread)
    return float(np.sqrt(max(1.0, chi2 / max(free, 1.0))))


def due(drift: Drift, last: Drift, limit: float) -> Due:
    """When the mean volumetric drift since the last run reaches a limit.

    Parameters
    ----------
    drift : Drift
        Since the last event.
    last : Drift
        Of the last step alone.
    limit : float
        m

    Returns
    -------
    Due
        By the line where the runs lie on one; else without a date, and no earlier than at the pace
        of the line or of the last step, whichever is faster.
    """
    line = drift.volume + COVERAGE_FACTOR * drift.u_volume
    if drift.bent:
        pace = max(line, last.volume + COVERAGE_FACTOR * last.u_volume)
        why = f'a straight line does not describe {", ".join(drift.bent)}'
        return Due(limit, None, limit / max(pace, 1e-300), None, why)
    earliest = limit / max(line, 1e-300)
    if not drift.significant:
        return Due(limit, None, earliest, None)
    low = drift.volume - COVERAGE_FACTOR * drift.u_volume
    return Due(limit, limit / drift.volume, earliest, limit / low if low > 0 else None)
