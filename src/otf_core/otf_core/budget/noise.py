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

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import combinations
from operator import add, attrgetter

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.aside import shared_out
from otf_core.noise.model import (
    MISFIT_TIME,
    NoiseModel,
    misfit_covariance,
    noise_covariance,
    with_diagonal,
)
from otf_core.pieces.observed import Observed
from otf_core.solving.joint import JointSolution, SolvedRun
from otf_core.solving.normal import NormalEquations, of_free, pieces_of, shares_of, white_rows
from otf_core.solving.triangular import turned_times

LINES = 256
"""Lines that are chained at a time."""


@dataclass(frozen=True)
class NoiseParts:
    """Parts of A^T W S W A of all runs; zero for motions that are not solved for.

    Attributes
    ----------
    normal : NormalEquations
        Of the rows of all passes, which the parts are made of: A^T W A.
    misfit : ndarray, shape (full, full)
        Of the misfit within lines.
    between : ndarray, shape (full, full)
        Of the covariance of tracker noise between the rows of one line.
    corners, misfit_corners : ndarray, shape (full, full)
        Of the covariance between different lines: noise of the tracker, lasting misfit.
    """

    normal: NormalEquations
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


@dataclass(frozen=True)
class _Line:
    """Slow noise of a line at its begin and its end: ``vectors`` (k, 6) of ``use`` (k,)."""

    use: Index
    vectors: Array
    begin: float
    end: float


def _line(rows: Array, use: Index, slow: Array, time: Array, tau: Array) -> _Line:
    """For W A (c, m, k), its columns (k,), slow amplitudes (c, m, 3), times (m,) in s."""
    early = np.exp((time[0] - time)[:, None] / tau)
    late = np.exp((time - time[-1])[:, None] / tau)
    both = np.concatenate([slow * early, slow * late], axis=2).reshape(-1, 6)
    vectors = rows.reshape(-1, rows.shape[2]).T @ both
    return _Line(use, vectors, float(time[0]), float(time[-1]))


def _chained(lines: Sequence[_Line], size: int, tau: Array) -> Array:
    """Sum over pairs of lines of tail and head vectors, decaying with the time between."""
    tail, end, half = np.zeros((size, 3)), -np.inf, np.zeros((size, size))
    for low in range(0, len(lines), LINES):
        some = lines[low : low + LINES]
        tails, heads = (np.zeros((size, 3 * len(some))) for _ in range(2))
        for k, line in enumerate(some):
            own = slice(3 * k, 3 * k + 3)
            heads[line.use, own] = line.vectors[:, :3]
            tails[:, own] = np.exp(np.minimum(0.0, (end - line.begin) / tau)) * tail
            tail *= np.exp(np.minimum(0.0, (end - line.end) / tau))
            tail[line.use] += line.vectors[:, 3:]
            end = line.end
        half += tails @ heads.T
    return np.asarray(half + half.T)


@dataclass(frozen=True)
class _Sums:
    """Sums over some lines of a run, and the lines themselves by their number."""

    product: Array
    within: Array
    between: Array
    noise: dict[int, _Line]
    misfit: dict[int, _Line]


def _summed(
    run: Observed, solved: SolvedRun, blocks: Collection[str], batches: Sequence[list[int]]
) -> _Sums:
    """Sum over the lines of some batches, for some blocks of the unknowns."""
    size, pieces = solved.system.rows.unknowns.full, run.pieces
    noise, misfit = run.noise_and_misfit
    slow, lasts = slow_amplitudes(run, solved), np.array([MISFIT_TIME])
    shared = solved.system.axes * misfit.slow * _smoothed(pieces.duration, lasts)
    square = np.zeros((size, size))
    sums = _Sums(np.zeros((size + 1, size + 1)), square, square.copy(), {}, {})
    for legs in batches:
        inverses = [solved.whitener.inverses[leg] for leg in legs]
        parts = pieces_of(solved.whitener, legs)
        deviation = solved.system.deviation[:, :, None]
        columns, white = white_rows(solved.system, inverses, parts, deviation, blocks)
        sums.product[np.ix_(columns, columns)] += white.T @ white
        use, rows = columns[:-1], white.reshape(len(slow), -1, len(columns))[:, :, :-1]
        pairs = list(combinations(range(len(rows)), 2))
        odd, tied, start = np.empty_like(rows), np.empty((len(pairs), *rows.shape[1:])), 0
        for leg, inverse, part in zip(legs, inverses, parts, strict=True):
            own = slice(start, start + inverse.shape[1])
            start = own.stop
            turned_times(inverse, rows[:, own])
            windows = (pieces.time[part], pieces.duration[part], pieces.count[part])
            shares, here = solved.system.shares[:, :, part], rows[:, own]
            odd[:, own] = here
            own_misfit, lasting = misfit_covariance(misfit, windows)
            root = np.asarray(np.linalg.cholesky(with_diagonal(lasting, own_misfit)))
            turned_times(root[None], odd[:, own])
            for k, (a, b) in enumerate(pairs):
                white_noise, slow_noise = noise_covariance(
                    noise, shares[:, a], shares[:, b], windows
                )
                tied[k, own] = with_diagonal(slow_noise, white_noise) @ here[b]
            time = windows[0]
            sums.noise[leg] = _line(here, use, slow[:, part], time, _times(noise))
            sums.misfit[leg] = _line(here, use, shared[:, part], time, lasts)
        place, flat = np.ix_(use, use), odd.reshape(-1, len(use))
        sums.within[place] += flat.T @ flat
        half = sum(rows[a].T @ own for (a, _), own in zip(pairs, tied, strict=True))
        sums.between[place] += half + np.transpose(half)
    return sums


def noise_parts(runs: Sequence[Observed], done: JointSolution) -> NoiseParts:
    """Sum up the misfit and the covariance that the weights leave out.

    Parameters
    ----------
    runs : sequence of Observed
    done : JointSolution
        Of the same runs.
    """
    size, normals, solved_for = done.unknowns.full, [], done.solution.accepted
    within, between, corners, lasting = (np.zeros((size, size)) for _ in range(4))
    for run, solved in zip(runs, done.runs, strict=True):
        shares = shares_of(solved.system, solved.whitener)
        parts = shared_out(partial(_summed, run, solved, solved_for), shares)
        product = reduce(np.add, (sums.product for sums in parts))
        normals.append(of_free(product, done.unknowns, solved.residual.size))
        for sums in parts:
            within += sums.within
            between += sums.between
        order = range(len(solved.whitener.bounds))
        noise, misfit = ({k: v for p in parts for k, v in found(p).items()} for found in _LINES)
        corners += _chained([noise[k] for k in order], size, _times(run.noise_and_misfit[0]))
        lasting += _chained([misfit[k] for k in order], size, np.array([MISFIT_TIME]))
    return NoiseParts(reduce(add, normals), within, between, corners, lasting)


_LINES = (attrgetter('noise'), attrgetter('misfit'))
