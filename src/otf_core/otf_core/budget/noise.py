# SPDX-License-Identifier: Apache-2.0
"""What the weights do not say about the noise: its parts, and its correlation across corners.

The weights W take lines as independent and hold, besides the noise of the tracker, the misfit.
With the covariance C of the estimates and S of any part of the noise, that part makes

    C  A^T W S W A  C

of C. Slow noise does not stop at a corner: pieces i, j of different
legs share cov_ij = s exp(-|t_i - t_j| / tau) for each of range and two angles. The exponential
splits in a factor per piece, so the sum over all pairs of legs is one pass over the legs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from otf_core.effects import State
from otf_core.effects.beam import beam_of
from otf_core.joint import JointSolution, SolvedRun
from otf_core.noise import MISFIT_TIME
from otf_core.normal import leg_parts
from otf_core.runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseParts:
    """Parts of A^T W S W A of all runs.

    Attributes
    ----------
    misfit : ndarray, shape (full, full)
        Of the misfit within lines.
    corners, misfit_corners : ndarray, shape (full, full)
        Of the covariance between different lines: noise of the tracker, lasting misfit.
    """

    misfit: Array
    corners: Array
    misfit_corners: Array


def slow_amplitudes(run: Run, solved: SolvedRun, state: State) -> Array:
    """Slow noise of range and two angles in every row, shape (c, p, 3), m."""
    noise, beam = run.noise_and_misfit[0], beam_of(state)
    level = np.sqrt([
        noise.u_range**2 * (1.0 - noise.white_range),
        *[noise.u_angle**2 * (1.0 - noise.white_angle)] * 2,
    ])  # fmt: skip
    reach = beam.distance[:, None]
    directions = np.stack([beam.e_r, beam.e_h * reach, beam.e_v * reach], axis=2)
    rows = np.einsum('cij,ijk->cik', solved.system.axes, directions)
    return np.asarray(rows * level * _smoothed(run.pieces.duration, noise.correlation_time))


def _smoothed(duration: Array, time: float) -> Array:
    """Weight of slow noise in means over windows (p,), s, in covariances between them."""
    x = np.maximum(duration / time, 1e-6)
    return np.asarray(np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x))[:, None]


def _leg_weighted(solved: SolvedRun, leg: int) -> tuple[NDArray[np.int64], Array]:
    """Columns that a leg touches, and W A of its rows, shape (c, m, active)."""
    low, high = solved.whitener.bounds[leg]
    design, count = solved.system.design, solved.system.deviation.shape[1]
    blocks = [design[c * count + low : c * count + high] for c in range(len(solved.system.axes))]
    active = np.unique(np.concatenate([b.indices for b in blocks]))
    place = np.zeros(design.shape[1], dtype=np.int64)
    place[active] = np.arange(active.size)
    result = []
    for block, factor in zip(blocks, solved.whitener.factors[leg], strict=True):
        dense = np.zeros((high - low, active.size))
        np.add.at(dense, (np.repeat(np.arange(high - low), np.diff(block.indptr)),
                          place[block.indices]), block.data)  # fmt: skip
        white = solve_triangular(factor, dense, lower=True, check_finite=False)
        result.append(solve_triangular(factor, white, lower=True, trans=1, check_finite=False))
    return active, np.stack(result)


class _Chain:
    """Sum over pairs of legs of tail and head vectors, decaying with the time between."""

    def __init__(self, size: int, correlation_time: float) -> None:
        self.total = np.zeros((size, size))
        self._tail = np.zeros((size, 3))
        self._end = -np.inf
        self._tau = correlation_time

    def add(self, active: NDArray[np.int64], rows: Array, slow: Array, time: Array) -> None:
        """Add a leg: W A (c, m, active), slow amplitudes (c, m, 3), times (m,)."""
        flat = rows.reshape(-1, len(active)).T
        early = np.exp((time[0] - time) / self._tau)[:, None]
        late = np.exp((time - time[-1]) / self._tau)[:, None]
        head, tail = flat @ (slow * early).reshape(-1, 3), flat @ (slow * late).reshape(-1, 3)
        gap = np.exp(min(0.0, (self._end - time[0]) / self._tau))
        cross = gap * self._tail @ head.T
        self.total[:, active] += cross
        self.total[active] += cross.T
        self._tail *= np.exp(min(0.0, (self._end - time[-1]) / self._tau))
        self._tail[active] += tail
        self._end = float(time[-1])


def noise_parts(runs: Sequence[Run], done: JointSolution, states: Sequence[State]) -> NoiseParts:
    """Sum up the misfit and the covariance between lines.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
        Of the same runs.
    states : sequence of State
        Of their pieces.
    """
    size = done.unknowns.full
    within, corners, lasting = (np.zeros((size, size)) for _ in range(3))
    for run, solved, state in zip(runs, done.runs, states, strict=True):
        noise, misfit = run.noise_and_misfit
        slow = slow_amplitudes(run, solved, state)
        shared = solved.system.axes * misfit.slow * _smoothed(run.pieces.duration, MISFIT_TIME)
        chains = _Chain(size, noise.correlation_time), _Chain(size, MISFIT_TIME)
        for leg, (low, high) in enumerate(solved.whitener.bounds):
            active, rows = _leg_weighted(solved, leg)
            for component, part in enumerate(rows):
                parts = leg_parts(solved.system, run.pieces, noise, misfit, component, low, high)
                within[np.ix_(active, active)] += part.T @ (parts[2] + parts[3]) @ part
            time = run.pieces.time[low:high]
            chains[0].add(active, rows, slow[:, low:high], time)
            chains[1].add(active, rows, shared[:, low:high], time)
        corners += chains[0].total
        lasting += chains[1].total
    return NoiseParts(within, corners, lasting)
