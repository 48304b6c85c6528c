# SPDX-License-Identifier: Apache-2.0
"""What the weights do not say about the noise: its parts, and its correlation across corners.

The weights W take lines, and the rows of a line, as independent and hold, besides the noise of the
tracker, the misfit. With the covariance C of the estimates and S of any part of the noise, that
part makes

    C  A^T W S W A  C

of C. Slow noise does not stop at a corner: pieces i, j of different
legs share cov_ij = s exp(-|t_i - t_j| / tau) for each of range and two angles. The exponential
splits in a factor per piece, so the sum over all pairs of legs is one pass over the legs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from otf_core.noise.model import MISFIT_TIME, NoiseModel, noise_covariance
from otf_core.pieces.observed import Observed
from otf_core.solving.joint import JointSolution, SolvedRun
from otf_core.solving.whitener import leg_parts

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class NoiseParts:
    """Parts of A^T W S W A of all runs.

    Attributes
    ----------
    misfit : ndarray, shape (full, full)
        Of the misfit within lines.
    between : ndarray, shape (full, full)
        Of the covariance of tracker noise between the rows of one line.
    corners, misfit_corners : ndarray, shape (full, full)
        Of the covariance between different lines: noise of the tracker, lasting misfit.
    """

    misfit: Array
    between: Array
    corners: Array
    misfit_corners: Array


def slow_amplitudes(run: Observed, solved: SolvedRun) -> Array:
    """Slow noise of range and two angles in every row, shape (c, p, 3), m."""
    noise = run.noise_and_misfit[0]
    level = np.array([c.slow for c in noise])
    smoothed = _smoothed(run.pieces.duration, _times(noise))
    return np.asarray(np.moveaxis(solved.system.shares, 0, 2) * level * smoothed)


def _times(noise: NoiseModel) -> Array:
    """Correlation times, shape (3,), s; where there is none any will do."""
    return np.array([c.correlation_time or MISFIT_TIME for c in noise])


def _smoothed(duration: Array, time: Array) -> Array:
    """Weight of slow noise in means over windows (p,), s, in covariances between them, (p, k)."""
    x = np.maximum(duration[:, None] / time, 1e-6)
    return np.asarray(np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x))


class _Chain:
    """Sum over pairs of lines of tail and head vectors, decaying with the time between."""

    def __init__(self, size: int, correlation_time: Array) -> None:
        self._tail = np.zeros((size, 3))
        self._end = -np.inf
        self._tau = correlation_time
        self._pairs: list[tuple[Array, Array]] = []

    def add(self, rows: Array, use: Index, slow: Array, time: Array) -> None:
        """Add a line: W A (c, m, k), its columns (k,), slow amplitudes (c, m, 3), times (m,)."""
        flat = rows.reshape(-1, rows.shape[2]).T
        early = np.exp((time[0] - time)[:, None] / self._tau)
        late = np.exp((time - time[-1])[:, None] / self._tau)
        head, tail = np.zeros_like(self._tail), np.zeros_like(self._tail)
        head[use] = flat @ (slow * early).reshape(-1, 3)
        tail[use] = flat @ (slow * late).reshape(-1, 3)
        gap = np.exp(np.minimum(0.0, (self._end - time[0]) / self._tau))
        self._pairs.append((gap * self._tail, head))
        later = np.exp(np.minimum(0.0, (self._end - time[-1]) / self._tau))
        self._tail = self._tail * later + tail
        self._end = float(time[-1])

    @property
    def total(self) -> Array:
        """The sum, shape (size, size)."""
        tails, heads = (np.concatenate(part, axis=1) for part in zip(*self._pairs, strict=True))
        half = tails @ heads.T
        return np.asarray(half + half.T)


def _weighted_rows(solved: SolvedRun, leg: int) -> tuple[Array, Index]:
    """W A of a line, shape (c, m, k), and the k unknowns that it depends on."""
    use, rows = solved.system.rows.touched(np.arange(*solved.whitener.bounds[leg]))
    for own, inverse in zip(rows, solved.whitener.inverses[leg], strict=True):
        own[:] = inverse.T @ (inverse @ own)
    return rows, use


def _between(run: Observed, solved: SolvedRun, leg: int, rows: Array) -> Array:
    """Part of the covariance between the rows of one line, for W A (c, m, size) of it."""
    low, high = solved.whitener.bounds[leg]
    part, pieces, noise = slice(low, high), run.pieces, run.noise_and_misfit[0]
    windows = (pieces.time[part], pieces.duration[part], pieces.count[part])
    shares = solved.system.shares[:, :, part]
    half = np.zeros((rows.shape[2],) * 2)
    for a, b in combinations(range(len(rows)), 2):
        white, slow = noise_covariance(noise, shares[:, a], shares[:, b], windows)
        half += rows[a].T @ ((white + slow) @ rows[b])
    return half + half.T


def noise_parts(runs: Sequence[Observed], done: JointSolution) -> NoiseParts:
    """Sum up the misfit and the covariance that the weights leave out.

    Parameters
    ----------
    runs : sequence of Observed
    done : JointSolution
        Of the same runs.
    """
    size = done.unknowns.full
    within, between, corners, lasting = (np.zeros((size, size)) for _ in range(4))
    for run, solved in zip(runs, done.runs, strict=True):
        noise, misfit = run.noise_and_misfit
        slow, lasts = slow_amplitudes(run, solved), np.array([MISFIT_TIME])
        shared = solved.system.axes * misfit.slow * _smoothed(run.pieces.duration, lasts)
        chains = _Chain(size, _times(noise)), _Chain(size, lasts)
        for leg, (low, high) in enumerate(solved.whitener.bounds):
            rows, use = _weighted_rows(solved, leg)
            place, own = np.ix_(use, use), np.zeros((use.size, use.size))
            for component, part in enumerate(rows):
                parts = leg_parts(solved.system, run.pieces, noise, misfit, component, low, high)
                own += part.T @ ((parts[2] + parts[3]) @ part)
            within[place] += own
            between[place] += _between(run, solved, leg, rows)
            time = run.pieces.time[low:high]
            chains[0].add(rows, use, slow[:, low:high], time)
            chains[1].add(rows, use, shared[:, low:high], time)
        corners += chains[0].total
        lasting += chains[1].total
    return NoiseParts(within, between, corners, lasting)
