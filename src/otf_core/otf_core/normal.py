# SPDX-License-Identifier: Apache-2.0
"""Normal equations with noise that is correlated in time (generalised least squares).

Pieces of one leg share slow noise, so their covariance is a full matrix; legs are separated by
corners and count as independent. Each leg's rows are freed of the correlation by the inverse
Cholesky factor of its covariance and added to the normal equations: the cost grows linearly with
the path, and only the normal matrix is kept. With independent samples this is the paper's
weighting (Eq. 4-6).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from otf_core.errors import InputError
from otf_core.noise import NoiseModel, mean_covariance
from otf_core.pieces import Pieces
from otf_core.system import System
from otf_core.unknowns import Unknowns

Array = NDArray[np.float64]

MODEL_FLOOR = 5e-8
"""m; independent uncertainty of every piece at least: tables are not better than that."""
COHERENCE = 5.0
"""Found by simulating smooth errors between nodes: from here on the tables are as good as those
of plain least squares, which such shapes disturb less (docs/uncertainty.md)."""
SIGNIFICANT = 4.0
"""Standard deviations."""


@dataclass(frozen=True)
class NormalEquations:
    """Sums over rows.

    Attributes
    ----------
    matrix : ndarray, shape (k, k)
    right : ndarray, shape (k,)
    square : float
        Sum of the squared whitened deviations.
    rows : int
    """

    matrix: Array
    right: Array
    square: float
    rows: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Return the sums over the rows of both."""
        return NormalEquations(
            self.matrix + other.matrix,
            self.right + other.right,
            self.square + other.square,
            self.rows + other.rows,
        )

    def less(self, part: NormalEquations) -> NormalEquations:
        """Return the sums over the rows that are not in ``part``."""
        return NormalEquations(
            self.matrix - part.matrix,
            self.right - part.right,
            self.square - part.square,
            self.rows - part.rows,
        )


class Whitener:
    """Frees the rows of each leg of the correlation of their noise.

    Parameters
    ----------
    system : System
        Its noise shares are used; they change little from iteration to iteration.
    pieces : Pieces
    noise : NoiseModel
    floor : float
        m; independent uncertainty of every piece besides the noise.
    """

    def __init__(
        self, system: System, pieces: Pieces, noise: NoiseModel, floor: float = MODEL_FLOOR
    ) -> None:
        self.bounds = leg_bounds(pieces.leg)
        self.floor = floor
        self._step_variance = np.zeros(system.deviation.shape)
        self._factors = [
            [
                self._factor(system, pieces, noise, component, slice(low, high))
                for component in range(len(system.deviation))
            ]
            for low, high in self.bounds
        ]

    def _factor(
        self, system: System, pieces: Pieces, noise: NoiseModel, component: int, part: slice
    ) -> Array:
        window = (pieces.time[part], pieces.duration[part], pieces.count[part])
        total = np.eye(part.stop - part.start) * self.floor**2
        for level, white, share in (
            (noise.u_range, noise.white_range, system.along[component, part]),
            (noise.u_angle, noise.white_angle, system.across[component, part]),
        ):
            weight = level * share
            total += mean_covariance(white, noise.correlation_time, *window) * np.outer(
                weight, weight
            )
        own = np.diag(total)
        step = own[1:] + own[:-1] - 2.0 * np.diag(total, 1)
        self._step_variance[component, part.start + 1 : part.stop] = step
        try:
            return np.asarray(cholesky(total, lower=True, check_finite=False))
        except LinAlgError:
            raise InputError(
                f'leg {pieces.leg[part.start]} of the path: its samples belong to two passes; '
                f'path and track do not agree there'
            ) from None

    @property
    def factors(self) -> tuple[tuple[Array, ...], ...]:
        """Lower Cholesky factor of every leg and component, m."""
        return tuple(tuple(leg) for leg in self._factors)

    @property
    def expected(self) -> Array:
        """Standard deviation of the noise of every piece, shape (c, p), m."""
        result = np.empty_like(self._step_variance)
        for (low, high), leg in zip(self.bounds, self._factors, strict=True):
            for component, factor in enumerate(leg):
                result[component, low:high] = np.linalg.norm(factor, axis=1)
        return result

    def floor_seen(self, residual: Array) -> float:
        """Independent uncertainty of pieces that the residuals call for, m.

        Neighbouring pieces of a leg differ by the fast part of the noise, which is known; what
        they differ by beyond it is the shape of errors that the tables cannot follow. Such
        shapes repeat on every line, so they bend the tables more than noise of that size does:
        they are weighted down ``COHERENCE`` times.

        Parameters
        ----------
        residual : ndarray, shape (c, p), m
        """
        inside = self._step_variance > 0
        if not inside.any():  # stops: no two pieces of one leg
            return self.floor
        step = np.zeros_like(residual)
        step[:, 1:] = np.diff(residual, axis=1)
        excess = 0.5 * (step[inside] ** 2 - self._step_variance[inside])
        excess = np.minimum(excess, 20 * np.mean(np.abs(excess)))
        mean = float(np.mean(excess))
        if mean < SIGNIFICANT * float(np.std(excess)) / np.sqrt(excess.size):
            return self.floor
        return float(
            np.hypot(MODEL_FLOOR, COHERENCE * np.sqrt((self.floor / COHERENCE) ** 2 + mean))
        )

    def leg_rows(self, leg: int, component: int, rows: Array) -> Array:
        """Whiten the rows (m, k) of one component of one leg."""
        factor = self._factors[leg][component]
        return np.asarray(solve_triangular(factor, rows, lower=True, check_finite=False))

    def vector(self, values: Array) -> Array:
        """Whiten values of shape (c, p)."""
        result = np.empty_like(values)
        for leg, (low, high) in enumerate(self.bounds):
            for component in range(len(values)):
                part = values[component, low:high]
                result[component, low:high] = self.leg_rows(leg, component, part)
        return result


def leg_bounds(leg: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First piece and one past the last of every leg, in driving order."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(leg)) + 1, [len(leg)]])
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def normal_equations(system: System, unknowns: Unknowns, whitener: Whitener) -> NormalEquations:
    """Sum up the whitened rows of all legs for the free unknowns."""
    return sum_groups(system, unknowns, whitener, np.zeros(len(whitener.bounds), dtype=int))[0]


def sum_groups(
    system: System,
    unknowns: Unknowns,
    whitener: Whitener,
    group: NDArray[np.int64],
    extra: Array | None = None,
    groups: int = 0,
) -> list[NormalEquations]:
    """Sum up whitened rows, group by group of legs.

    Parameters
    ----------
    system : System
    unknowns : Unknowns
    whitener : Whitener
    group : ndarray of int, shape (legs,)
        Group of each entry of ``whitener.bounds``, from 0.
    extra : ndarray, shape (c, p, k), optional
        Further columns, appended to the free unknowns.
    groups : int
        Number of groups, if some may be empty.

    Returns
    -------
    list of NormalEquations
    """
    design = sparse.csr_array(system.design @ unknowns.gauge)
    count = system.deviation.shape[1]
    width = 0 if extra is None else extra.shape[2]
    size = unknowns.free + width
    groups = max(groups, int(group.max()) + 1)
    matrix, right = np.zeros((groups, size, size)), np.zeros((groups, size))
    square, rows = np.zeros(groups), np.zeros(groups, dtype=int)
    for leg, (low, high) in enumerate(whitener.bounds):
        g = int(group[leg])
        for component in range(len(system.deviation)):
            block = design[component * count + low : component * count + high]
            active, local = np.unique(block.indices, return_inverse=True)
            dense = np.zeros((high - low, active.size + width + 1))
            row = np.repeat(np.arange(high - low), np.diff(block.indptr))
            np.add.at(dense, (row, local), block.data)
            if extra is not None:
                dense[:, active.size : -1] = extra[component, low:high]
            dense[:, -1] = system.deviation[component, low:high]
            white = whitener.leg_rows(leg, component, dense)
            product = white.T @ white
            place = np.concatenate([active, np.arange(unknowns.free, size)])
            matrix[g][np.ix_(place, place)] += product[:-1, :-1]
            right[g][place] += product[:-1, -1]
            square[g] += product[-1, -1]
            rows[g] += high - low
    return [
        NormalEquations(matrix[g], right[g], float(square[g]), int(rows[g])) for g in range(groups)
    ]
