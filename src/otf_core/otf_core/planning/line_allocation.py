# SPDX-License-Identifier: Apache-2.0
"""How much driving time each candidate line deserves, were lines divisible (A-optimal design).

Minimise trace(target @ inv(prior + sum w_i N_i)) over w >= 0 with sum w_i cost_i = time. The
multiplicative rule w_i <- w_i (gain_i / mean gain)^0.7 converges monotonically in practice, and
max gain / mean gain bounds how far any plan can be better (equivalence theorem). The path that is
driven is judged against this bound.

References
----------
Pukelsheim, Optimal Design of Experiments, SIAM 2006, chapters 5 and 7 (equivalence theorem).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from otf_core.arrays import Array
from otf_core.planning.candidate_lines import CandidateLines

ITERATIONS = 60
_POWER = 0.7


@dataclass(frozen=True)
class Judgement:
    """Mean variance of the grid and what every line would take off it.

    Attributes
    ----------
    variance : float
        In units of ``unidentifiable_above`` squared.
    gain : ndarray, shape (n, f)
        Decrease of the variance per unit weight of each line at each feed.
    """

    variance: float
    gain: Array


def variance(lines: CandidateLines, matrix: Array) -> float:
    """Mean variance of the grid for a sum of normal matrices."""
    factor = linalg.cho_factor(matrix + lines.prior, lower=True, check_finite=False)
    return float(np.trace(linalg.cho_solve(factor, lines.target, check_finite=False)))


def judge(lines: CandidateLines, matrix: Array) -> Judgement:
    """Mean variance of the grid and its derivative with respect to every line.

    Parameters
    ----------
    lines : CandidateLines
    matrix : ndarray, shape (u, u)
        Sum of normal matrices.

    Returns
    -------
    Judgement
    """
    factor = linalg.cho_factor(matrix + lines.prior, lower=True, check_finite=False)
    half = linalg.cho_solve(factor, lines.target, check_finite=False)
    gradient = linalg.cho_solve(factor, half.T, check_finite=False)
    flat = lines.information.reshape(len(lines.information), -1)
    return Judgement(float(np.trace(half)), (flat @ gradient.ravel()).reshape(lines.cost.shape))


def total(lines: CandidateLines, weight: Array) -> Array:
    """Sum of normal matrices for weights of shape (n, f)."""
    size = lines.prior.shape[0]
    flat = lines.information.reshape(len(lines.information), -1)
    return np.asarray((weight.ravel() @ flat).reshape(size, size))


def allocate(lines: CandidateLines, time: float, iterations: int = ITERATIONS) -> Array:
    """Share out driving time among lines and feeds.

    Parameters
    ----------
    lines : CandidateLines
    time : float
        s, connections not counted: every line is a candidate, so are they.

    Returns
    -------
    ndarray, shape (n, f)
        How often each line is driven, not whole numbers.
    """
    weight = time / lines.cost / lines.cost.size
    for _ in range(iterations):
        worth = judge(lines, total(lines, weight)).gain / lines.cost
        weight = weight * np.maximum(worth / worth.max(), 1e-12) ** _POWER
        weight *= time / float(np.sum(weight * lines.cost))
    return np.asarray(weight)
