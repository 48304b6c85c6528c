# SPDX-License-Identifier: Apache-2.0
"""Parameters of the causes, fitted together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.engine.evidence import Estimate
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import Cause, fit_jointly, places_of
from otf_core.effects import AppliedEffect

FREE = 3.0
"""Standard deviation of what the data do not see, over the largest displacement found."""
STEP = 0.01
"""Step of a refined shape, in widths of the search for it, by which its trace is differenced."""
SIGNIFICANT = 2.0
"""Standard deviations at which an axis takes part in a cause."""


@dataclass(frozen=True)
class FittedCause:
    """Parameters of one cause.

    Attributes
    ----------
    value, u : ndarray, shape (k,)
        Coefficients of its terms and their standard uncertainties. Combinations that the data do
        not see are zero in ``value``; in ``u`` they may be ``FREE`` times as large as the rest.
    u_seen : ndarray, shape (k,)
        Without these combinations.
    covariance : ndarray, shape (k, k)
        Of what the data see.
    unseen : ndarray, shape (k, m)
        Combinations that they do not see, each as large as ``FREE`` allows.
    """

    cause: Cause
    value: Array
    u: Array
    u_seen: Array
    covariance: Array
    unseen: Array

    @property
    def names(self) -> list[str]:
        """Names of the coefficients."""
        return [self.cause.option.terms.names[i] for i in self.cause.option.take]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose coefficients are significant, strongest first."""
        option = self.cause.option
        strength: dict[str, float] = {}
        rows = zip(option.take, self.value, self.u_seen, option.size, strict=True)
        for i, value, u, size in rows:
            axis = option.terms.axes[i]
            if axis and abs(value) > SIGNIFICANT * u:
                strength[axis] = strength.get(axis, 0.0) + (value * size) ** 2
        largest = max(strength.values(), default=0.0)
        kept = {a: s for a, s in strength.items() if s > 0.02 * largest}
        return tuple(sorted(kept, key=lambda a: -kept[a]))

    def applied(self, run: int) -> AppliedEffect:
        """The effect with its fitted parameters in one run."""
        option = self.cause.option
        of_first = option.terms.columns.shape[2]  # what other runs have of their own comes after
        place = option.take - of_first * (run if option.effect.own_per_run else 0)
        values = {
            option.terms.names[i]: float(value)
            for i, value in zip(place, self.value, strict=True)
            if 0 <= i < of_first
        }
        return AppliedEffect(option.effect, {**option.shape, **values})


def fitted_causes(causes: Sequence[Cause], rows: Rows) -> list[FittedCause]:
    """Fit all causes jointly and split the parameters up again."""
    if not causes:
        return []
    fit = fit_jointly(causes, rows)
    size = np.concatenate([cause.option.size for cause in causes])
    free = FREE * float(np.max(np.abs(fit.value) * size))
    covariance = fit.covariance + _of_shapes(causes, fit, rows)
    seen = np.diag(covariance)
    unseen = free * fit.unseen
    u = np.sqrt(seen + np.sum(unseen**2, axis=1))
    return [
        FittedCause(
            cause, fit.value[own], u[own], np.sqrt(seen[own]), covariance[own, own], unseen[own]
        )
        for cause, own in zip(causes, places_of(causes), strict=True)
    ]


def _of_shapes(causes: Sequence[Cause], fit: Estimate, rows: Rows) -> Array:
    """What refined shapes, such as a period, add to the covariance of the coefficients.

    With C that of the coefficients of columns E alone, and s what a cause changes by per logarithm
    of its shape, which the search knows to within w: C E's (s's - s'E C E's + w^-2)^-1 s'E C.
    """
    total = np.zeros_like(fit.covariance)
    columns = np.concatenate([c.option.own for c in causes], axis=1)
    for cause, own in zip(causes, places_of(causes), strict=True):
        if cause.option.effect.refine:
            slope = _slope(cause, fit.value[own], rows)
            cross = columns.T @ slope
            moved = fit.covariance @ cross
            known = slope @ slope - cross @ moved
            total += np.outer(moved, moved) / (known + cause.option.effect.refine_width**-2)
    return total


def _slope(cause: Cause, value: Array, rows: Rows) -> Array:
    """Change of a cause per logarithm of its refined shape, projected and whitened, shape (r,)."""
    option = cause.option
    name, step = option.effect.refine, STEP * option.effect.refine_width
    shapes = ({**option.shape, name: option.shape[name] * np.exp(k * step)} for k in (-1, 1))
    before, after = (rows.plain_columns(option.effect, s)[:, option.take] @ value for s in shapes)
    change = (after - before) / (2.0 * step)
    return rows.project(rows.whiten(change[:, None]))[:, 0]
