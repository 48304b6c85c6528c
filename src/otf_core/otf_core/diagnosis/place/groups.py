# SPDX-License-Identifier: Apache-2.0
"""Residual of groups of path pieces against what noise leaves there.

With S the sum of squared residuals of a group and C the noise covariance of a leg, noise alone
gives S the mean sum tr(C) and the variance 2 sum tr(C C), both over the legs; the correlation of
the noise within a leg is in C. How well groups are told from one another also counts the scatter
of the legs, where it is larger.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.place.groupings import Grouping
from otf_core.diagnosis.place.views import RunView

FEWEST_LEGS = 4
"""From here on the scatter of the legs is looked at."""


@dataclass(frozen=True)
class Group:
    """Some path pieces.

    Attributes
    ----------
    kind : str
        What the pieces were grouped by.
    rms, expected : float
        m; root mean square of the perpendicular distance, and what noise leaves.
    excess, u_excess : float
        m^2; mean square beyond noise and its standard deviation, scatter of the legs included.
    significance : float
        How unlikely noise alone is to give so much: in standard deviations of a normal quantity.
    """

    label: str
    kind: str
    rms: float
    expected: float
    excess: float
    u_excess: float
    significance: float
    pieces: int
    legs: int

    def with_noise(self, factor: float) -> Group:
        """The same with a factor on the noise expected, and the excess beyond that."""
        expected = factor * self.expected
        return replace(self, expected=expected, excess=self.rms**2 - expected**2)

    def row(self, **further: Any) -> dict[str, Any]:
        """Plain data for gap.json."""
        return {
            'label': self.label,
            'kind': self.kind,
            'rms_um': 1e6 * self.rms,
            'expected_um': 1e6 * self.expected,
            'significance': self.significance,
            'pieces': self.pieces,
            'legs': self.legs,
            **further,
        }


@dataclass(frozen=True)
class LegRows:
    """One component of one leg, or its image under a rotation such as a Fourier transform.

    Attributes
    ----------
    values : ndarray, shape (n,), m
    covariance : ndarray, shape (n, n), m^2
        Of the noise.
    """

    values: Array
    covariance: Array


@dataclass(frozen=True)
class LegSums:
    """Sums of one leg for each of g groups: squares, noise, variance of the squares, pieces."""

    square: Array
    noise: Array
    variance: Array
    pieces: Array

    def only(self, groups: slice) -> LegSums:
        """Sums for some of the groups."""
        return LegSums(*(getattr(self, part.name)[groups] for part in fields(self)))


def leg_rows(view: RunView, residual: Array) -> Iterator[tuple[slice, list[LegRows]]]:
    """Yield the pieces of each leg and its components."""
    for (low, high), leg in zip(view.bounds, view.covariances, strict=True):
        yield slice(low, high), [LegRows(residual[c, low:high], k) for c, k in enumerate(leg)]


def rows_along(rows: Sequence[LegRows], weights: Array) -> LegRows:
    """Sum of components with weights, shape (c, n)."""
    values = sum(w * r.values for w, r in zip(weights, rows, strict=True))
    parts = (w[:, None] * r.covariance * w for w, r in zip(weights, rows, strict=True))
    return LegRows(np.asarray(values), np.asarray(sum(parts)))


def leg_sums(rows: Sequence[LegRows], member: NDArray[np.bool_], pieces: Array) -> LegSums:
    """Sums of one leg.

    Parameters
    ----------
    member : ndarray of bool, shape (n, g)
        Which groups each value belongs to.
    pieces : ndarray, shape (g,)
    """
    square, noise, variance = (np.zeros(member.shape[1]) for _ in range(3))
    here = np.flatnonzero(member.any(axis=0))
    inside = member[:, here].astype(float)
    for row in rows:
        square[here] += inside.T @ row.values**2
        noise[here] += inside.T @ np.diag(row.covariance)
        variance[here] += 2.0 * ((row.covariance**2 @ inside) * inside).sum(axis=0)
    return LegSums(square, noise, variance, pieces)


def normal_score(square: float, noise: float, variance: float) -> float:
    """Standard deviations of a normal quantity that is as unlikely as a sum of squares.

    The sum is taken as chi-square with as many degrees of freedom as its mean and variance call
    for, and turned by its cube root (Wilson and Hilferty 1931).

    Parameters
    ----------
    square, noise, variance : float
        Sum of squares, its mean and its variance if there is only noise.
    """
    spread = variance / (9.0 * noise**2)
    return float((np.cbrt(square / noise) - (1.0 - spread)) / np.sqrt(spread))


def make_groups(labels: Sequence[str], kind: str, sums: Sequence[LegSums]) -> list[Group]:
    """Groups with at least one piece, from the sums of all legs of all runs."""
    square, noise, variance, pieces = (
        np.stack([getattr(s, name) for s in sums], axis=1)
        for name in ('square', 'noise', 'variance', 'pieces')
    )
    groups = []
    for g, label in enumerate(labels):
        part = pieces[g] > 0
        if not part.any():
            continue
        count = float(pieces[g].sum())
        difference = square[g, part] - noise[g, part]
        spread = float(variance[g].sum())
        if part.sum() >= FEWEST_LEGS:
            mean = difference.sum() * pieces[g, part] / count
            legs = part.sum()
            spread = max(spread, float(((difference - mean) ** 2).sum()) * legs / (legs - 1))
        excess, deviation = float(difference.sum()), float(np.sqrt(spread))
        chance = normal_score(
            float(square[g].sum()), float(noise[g].sum()), float(variance[g].sum())
        )
        groups.append(
            Group(
                label,
                kind,
                float(np.sqrt(square[g].sum() / count)),
                float(np.sqrt(noise[g].sum() / count)),
                excess / count,
                deviation / count,
                chance,
                round(count),
                int(part.sum()),
            )
        )
    return groups


def partition(
    views: Sequence[RunView],
    groupings: Sequence[Grouping],
    residuals: Sequence[Array] | None = None,
) -> list[list[Group]]:
    """Groups of pieces that have the same index, of every grouping.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), optional
        ``residual_before`` where not given.
    """
    sums = []
    for k, view in enumerate(views):
        residual = view.residual_before if residuals is None else residuals[k]
        member = np.concatenate(
            [own.indices[k][:, None] == np.arange(len(own.labels)) for own in groupings], axis=1
        )
        for part, rows in leg_rows(view, residual):
            sums.append(leg_sums(rows, member[part], member[part].sum(axis=0)))
    found, start = [], 0
    for own in groupings:
        part = slice(start, start + len(own.labels))
        start = part.stop
        found.append(make_groups(own.labels, own.kind, [one.only(part) for one in sums]))
    return found


def unevenness(groups: Sequence[Group]) -> float:
    """How much more the excess differs between groups than chance makes it.

    Returns
    -------
    float
        Sum of squared differences over their variances, less three times what chance gives.
    """
    if len(groups) < 2:
        return 0.0
    excess = np.array([g.excess for g in groups])
    weight = 1.0 / np.maximum([g.u_excess for g in groups], 1e-300) ** 2
    mean = float((weight * excess).sum() / weight.sum())
    return float((weight * (excess - mean) ** 2).sum() - 3.0 * (len(groups) - 1))
