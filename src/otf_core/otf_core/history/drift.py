# SPDX-License-Identifier: Apache-2.0
"""How fast a machine drifts, and until when its tables hold.

Least-squares line of every node over time since the last event: rate = sum c_k x_k with
c_k = (t_k - mean t) / sum (t - mean t)^2, covariance sum c_k^2 C_k, widened where the runs scatter
about the line more than their uncertainties say (Birge ratio). The volume drifts by the mean
length of the rates on a grid, best rigid motion taken out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.history.change import Change, change_of, chi_square
from otf_core.history.series import Series

Array = NDArray[np.float64]

FACTOR = 1.96
"""k of intervals of 95 %."""


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
    """

    rate: Array
    motions: dict[str, Change]
    volume: float
    u_volume: float
    birge: float
    p: float

    @property
    def significant(self) -> bool:
        """Tell whether the drift is beyond what chance gives (5 %)."""
        return self.p < 0.05


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
    """

    limit: float
    days: float | None
    earliest: float
    latest: float | None


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
        {n: change_of(rate[p], covariance[p, p]) for n, p in series.parts.items()},
        float(length.mean()),
        float(np.sqrt(max(float(slope @ covariance @ slope), 0.0))),
        birge,
        change_of(rate, covariance).p,
    )


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


def due(drift: Drift, limit: float) -> Due:
    """When the mean volumetric drift since the last run reaches a limit.

    Parameters
    ----------
    drift : Drift
    limit : float
        m
    """
    high = drift.volume + FACTOR * drift.u_volume
    earliest = limit / max(high, 1e-300)
    if not drift.significant:
        return Due(limit, None, earliest, None)
    low = drift.volume - FACTOR * drift.u_volume
    return Due(limit, limit / drift.volume, earliest, limit / low if low > 0 else None)
