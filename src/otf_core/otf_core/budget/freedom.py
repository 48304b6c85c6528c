# SPDX-License-Identifier: Apache-2.0
"""Effective degrees of freedom (GUM annex G).

The level of the noise rests on the residuals and on the standstills. Residuals with covariance S
have (tr S)^2 / tr S^2 degrees of freedom (Welch-Satterthwaite for their mean square), less one for
every estimated quantity; correlation beyond the assumed one divides them. A standstill of length T
with correlation time tau has T / tau.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from otf_core.arrays import Array
from otf_core.noise.standstill import MIN_TOTAL, find_standstills
from otf_core.pieces.runs import Run
from otf_core.solving.joint import JointSolution


def residual_freedom(done: JointSolution, correlation_factor: float) -> float:
    """Degrees of freedom of the noise level as the residuals tell it; at least 1."""
    moments = [alike.moments for solved in done.runs for alike in solved.whitener.alike]
    trace = sum(float(np.sum(m.variance)) for m in moments)
    square = sum(float(np.sum(m.square)) for m in moments)
    return max(1.0, (trace**2 / square - done.solution.rank) / correlation_factor)


def standstill_freedom(runs: Sequence[Run], speed: float) -> float:
    """Degrees of freedom of the noise level as the standstills tell it; zero if too short.

    Parameters
    ----------
    runs : sequence of Run
    speed : float
        m/s; slower counts as standstill.
    """
    total = 0.0
    for run in runs:
        samples = run.samples
        if len(samples) < 2:
            continue
        found = find_standstills(samples, speed)
        length = float(np.diff(found, axis=1).sum()) * samples.step
        slowest = max(c.correlation_time for c in run.noise)
        total += length / slowest if length >= MIN_TOTAL else 0.0
    return total


def welch_satterthwaite(variances: Array, freedoms: Array) -> Array:
    """Effective degrees of freedom of sums of variances (GUM G.4.1).

    Parameters
    ----------
    variances : ndarray, shape (sources, n)
    freedoms : ndarray, shape (sources,)
        Infinite for contributions taken from specifications.

    Returns
    -------
    ndarray, shape (n,)
        Infinite where nothing is uncertain.
    """
    share = variances / np.maximum(variances.sum(axis=0), 1e-300)
    slack = np.sum(share**2 / freedoms[:, None], axis=0)
    return np.asarray(1.0 / np.maximum(slack, 1e-300))
