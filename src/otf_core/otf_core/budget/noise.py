# SPDX-License-Identifier: Apache-2.0
"""What the weights do not say about the noise: its floor, and its correlation across corners.

The weights W take legs as independent and hold, besides the noise K of the tracker, the floor f.
With the covariance V that is believed, the estimates have the covariance

    (A^T W A)^-1  A^T W V W A  (A^T W A)^-1

V = W^-1 gives the usual inverse. Slow noise does not stop at a corner: pieces i, j of different
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
from otf_core.noise import NoiseModel
from otf_core.runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseParts:
    """Parts of A^T W V W A of all runs.

    Attributes
    ----------
    floors : tuple of ndarray, each of shape (full, full)
        Of the floor of every run.
    corners : ndarray, shape (full, full)
        Of the covariance between different legs.
    """

    floors: tuple[Array, ...]
    corners: Array


def slow_amplitudes(run: Run, solved: SolvedRun, state: State) -> Array:
    """Slow noise of range and two angles in every row, shape (c, p, 3), m."""
    noise, beam = run.noise, beam_of(state)
    level = np.sqrt([
        noise.u_range**2 * (1.0 - noise.white_range),
        *[noise.u_angle**2 * (1.0 - noise.white_angle)] * 2,
    ])  # fmt: skip
    reach = beam.distance[:, None]
    directions = np.stack([beam.e_r, beam.e_h * reach, beam.e_v * reach], axis=2)
    x = np.maximum(run.pieces.duration / noise.correlation_time, 1e-6)
    mean = np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x)
    rows = np.einsum('cij,ijk->cik', solved.system.axes, directions)
    return np.asarray(rows * level * mean[:, None])


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

    def __init__(self, size: int, noise: NoiseModel) -> None:
        self.total = np.zeros((size, size))
        self._tail = np.zeros((size, 3))
        self._end = -np.inf
        self._tau = noise.correlation_time

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
    """Sum up floor and covariance between legs.

    Parameters
    ----------
    runs : sequence of Run
    done : JointSolution
        Of the same runs.
    states : sequence of State
        Of their pieces.
    """
    size = done.unknowns.full
    floors, corners = [], np.zeros((size, size))
    for run, solved, state in zip(runs, done.runs, states, strict=True):
        slow, chain = slow_amplitudes(run, solved, state), _Chain(size, run.noise)
        floor = np.zeros((size, size))
        for leg, (low, high) in enumerate(solved.whitener.bounds):
            active, rows = _leg_weighted(solved, leg)
            flat = rows.reshape(-1, active.size)
            floor[np.ix_(active, active)] += run.floor**2 * (flat.T @ flat)
            chain.add(active, rows, slow[:, low:high], run.pieces.time[low:high])
        floors.append(floor)
        corners += chain.total
    return NoiseParts(tuple(floors), corners)
