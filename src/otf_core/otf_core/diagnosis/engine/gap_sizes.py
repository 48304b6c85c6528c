# SPDX-License-Identifier: Apache-2.0
"""Sizes of the gap: residuals of path pieces with and without causes, on legs not fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.diagnosis.engine.evidence import estimate
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import Cause
from otf_core.solving.residuals import FOLDS, leg_numbers

JACKKNIFE = 20
"""Groups of legs."""
SIMULATED_U = 0.04
"""Relative standard uncertainty of the simulated residual: how fast noise averages out."""


@dataclass(frozen=True)
class Residuals:
    """Squared residual of every piece.

    Attributes
    ----------
    square : ndarray, shape (p,), m^2
    leg : ndarray of int, shape (p,)
        Legs of all runs, numbered through.
    rows : ndarray, shape (r,), m
        Residuals of the rows they come from.
    """

    square: Array
    leg: NDArray[np.int64]
    rows: Array

    @property
    def rms_um(self) -> float:
        """Root mean square over the pieces, um."""
        return float(1e6 * np.sqrt(self.square.mean()))


def _per_piece(rows: Rows, values: Array) -> Residuals:
    square = [np.sum(part**2, axis=0) for part in rows.by_run(values)]
    return Residuals(np.concatenate(square), np.concatenate(leg_numbers(rows.done)), values)


def plain_residuals(rows: Rows) -> Residuals:
    """Residuals that the calibration leaves."""
    return _per_piece(rows, rows.left(rows.plain_deviation))


def residuals_with(rows: Rows, causes: Sequence[Cause], *, held_out: bool = True) -> Residuals:
    """Residuals once causes are added.

    Parameters
    ----------
    held_out : bool
        Each leg is judged with coefficients fitted without the legs of its fold; tables and
        poses are fitted to all legs with the weights of the calibration without the causes.
    """
    if not causes:
        return plain_residuals(rows)
    plain = np.concatenate([c.option.plain for c in causes], axis=1)
    own = np.concatenate([c.option.own for c in causes], axis=1)
    size = np.concatenate([c.option.size for c in causes])
    width = np.concatenate([c.option.widths for c in causes])
    values = np.zeros(len(rows.deviation))
    for fold in range(FOLDS) if held_out else [-1]:
        fit = rows.fold != fold
        judge = ~fit if held_out else fit
        if not judge.any():
            continue
        coefficients = estimate(own[fit], size, rows.residual[fit], width).value
        left = rows.left(rows.plain_deviation - plain @ coefficients)
        values[judge] = left[judge]
    return _per_piece(rows, values)


def gap_um(measured_um: float, simulated_um: float) -> float:
    """Gap between a measured and a simulated residual (docs/conventions.md, gap.json), um."""
    return float(np.sqrt(max(0.0, measured_um**2 - simulated_um**2)))


def shrink_percent(before_um: float, after_um: float) -> float:
    """Share of a gap that is gone, percent; 0 where there was none."""
    return float(np.clip(100.0 * (1.0 - after_um / before_um), 0.0, 100.0)) if before_um else 0.0


def shrink_interval(
    before: Residuals, after: Residuals, simulated_um: float
) -> tuple[float, float]:
    """95 % interval of the shrink.

    Scatter between groups of legs, left out in turn (jackknife), and ``SIMULATED_U``.
    """
    group = before.leg % JACKKNIFE
    sums = [np.bincount(group, r.square, JACKKNIFE) for r in (before, after)]
    count = np.bincount(group, minlength=JACKKNIFE)

    def shrink(keep: NDArray[np.bool_], level: float = 1.0) -> float:
        sizes = (1e6 * np.sqrt(s[keep].sum() / count[keep].sum()) for s in sums)
        return shrink_percent(*(gap_um(float(x), level * simulated_um) for x in sizes))

    used = np.flatnonzero(count)
    if len(used) < 2:
        return 0.0, 100.0
    whole = shrink(count > 0)
    left = np.array([shrink((count > 0) & (np.arange(JACKKNIFE) != k)) for k in used])
    u = float(np.sqrt((len(used) - 1) / len(used) * np.sum((left - left.mean()) ** 2)))
    levels = [shrink(count > 0, 1.0 + k * SIMULATED_U) - whole for k in (-2.0, 2.0)]
    low = whole - float(np.hypot(2 * u, min(0.0, *levels)))
    high = whole + float(np.hypot(2 * u, max(0.0, *levels)))
    return max(0.0, low), min(100.0, high)
