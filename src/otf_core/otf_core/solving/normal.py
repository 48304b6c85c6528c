# SPDX-License-Identifier: Apache-2.0
"""Normal equations with noise that is correlated in time (generalised least squares).

Pieces of one leg share slow noise, so their covariance is a full matrix; legs are separated by
corners and count as independent. Each leg's rows are freed of the correlation by the inverse
Cholesky factor of its covariance and added to the normal equations: the cost grows linearly with
the path, and only the normal matrix is kept. With independent samples this is the paper's
weighting (Eq. 4-6).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular

from otf_core.errors import InputError
from otf_core.model.path import leg_bounds
from otf_core.noise.model import Misfit, NoiseModel, covariance_parts
from otf_core.pieces.pieces import Pieces
from otf_core.solving.system import System
from otf_core.solving.unknowns import Unknowns

Array = NDArray[np.float64]

NO_MISFIT = Misfit()


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


@dataclass(frozen=True)
class Whitener:
    """Frees the rows of each leg of the correlation of their noise.

    Every row of a piece has the variance of its own direction. What the rows of one piece share
    where both angles are not equally good is left to the budget (``NoiseParts.between``): taking
    them together would make the matrices of a leg twice as large, for weights that hardly change.

    Attributes
    ----------
    bounds : sequence of (int, int)
        First piece and one past the last of every leg.
    factors : tuple of (tuple of ndarray)
        Lower Cholesky factor of the covariance of every leg and component, m.
    """

    bounds: Sequence[tuple[int, int]]
    factors: tuple[tuple[Array, ...], ...]

    @classmethod
    def of(
        cls, system: System, pieces: Pieces, noise: NoiseModel, misfit: Misfit = NO_MISFIT
    ) -> Whitener:
        """For the noise of pieces; the shares of a system change little between iterations."""
        bounds = leg_bounds(pieces.leg)
        parts = partial(leg_parts, system, pieces, noise, misfit)
        components = range(len(system.deviation))
        factors = [
            tuple(_factor(parts(c, low, high), int(pieces.leg[low])) for c in components)
            for low, high in bounds
        ]
        return cls(bounds, tuple(factors))

    @property
    def expected(self) -> Array:
        """Standard deviation of the noise of every piece, shape (c, p), m."""
        return np.stack([
            np.concatenate([np.linalg.norm(factor, axis=1) for factor in component])
            for component in zip(*self.factors, strict=True)
        ])  # fmt: skip

    def parts(self) -> Iterator[tuple[int, int, int, Array]]:
        """Component, first piece, one past the last and factor of the rows of every leg."""
        for (low, high), leg in zip(self.bounds, self.factors, strict=True):
            for component, factor in enumerate(leg):
                yield component, low, high, factor

    def _applied(self, function: Callable[[Array, Array], Array], values: Array) -> Array:
        result = np.empty_like(values)
        for component, low, high, factor in self.parts():
            part = values[component, low:high]
            result[component, low:high] = function(factor, part)
        return result

    def whiten(self, values: Array) -> Array:
        """Free values (c, p, ...) of the correlation: noise as expected has unit variance."""
        return self._applied(whitened, values)

    def whiten_transposed(self, values: Array) -> Array:
        """Apply the transpose of ``whiten``: for products with columns."""
        return self._applied(partial(whitened, transposed=True), values)

    def unwhiten(self, values: Array) -> Array:
        """Undo ``whiten``."""
        return self._applied(np.matmul, values)

    def weighted(self, values: Array) -> Array:
        """Multiply values (c, p, ...) by the inverse covariance of the noise."""
        return self._applied(weighted, values)


def whitened(factor: Array, rows: Array, *, transposed: bool = False) -> Array:
    """Rows (m, ...) of one leg and component, by its lower Cholesky factor (m, m)."""
    return np.asarray(
        solve_triangular(factor, rows, trans=int(transposed), lower=True, check_finite=False)
    )


def weighted(factor: Array, rows: Array) -> Array:
    """Rows (m, ...) of one leg and component times the inverse of their covariance."""
    return np.asarray(cho_solve((factor, True), rows, check_finite=False))


def leg_parts(
    system: System,
    pieces: Pieces,
    noise: NoiseModel,
    misfit: Misfit,
    component: int,
    low: int,
    high: int,
) -> tuple[Array, Array, Array, Array]:
    """Parts of the covariance of successive pieces of one leg; see ``noise.covariance_parts``."""
    part = slice(low, high)
    shares = system.shares[:, component, part]
    windows = (pieces.time[part], pieces.duration[part], pieces.count[part])
    return covariance_parts(noise, misfit, shares, windows)


def _factor(parts: Sequence[Array], leg: int) -> Array:
    try:
        return np.asarray(cholesky(sum(parts), lower=True, check_finite=False))
    except LinAlgError:
        raise InputError(
            f'leg {leg} of the path: its samples belong to two passes; '
            f'path and track do not agree there'
        ) from None


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
    products = np.zeros((groups, size + 1, size + 1))
    rows = np.zeros(groups, dtype=int)
    of_leg = np.repeat(group, len(system.deviation)).tolist()
    for g, (component, low, high, factor) in zip(of_leg, whitener.parts(), strict=True):
        dense = np.zeros((high - low, size + 1))
        fill_rows(dense, design, component * count + low)
        if extra is not None:
            dense[:, unknowns.free : -1] = extra[component, low:high]
        dense[:, -1] = system.deviation[component, low:high]
        white = whitened(factor, dense)
        products[g] += white.T @ white
        rows[g] += high - low
    return [
        NormalEquations(p[:-1, :-1].copy(), p[:-1, -1].copy(), float(p[-1, -1]), int(n))
        for p, n in zip(products, rows, strict=True)
    ]


def fill_rows(dense: Array, design: sparse.csr_array, start: int) -> None:
    """Write successive rows of a sparse matrix, from ``start`` on, into a dense one of zeros."""
    ends = design.indptr[start : start + len(dense) + 1]
    row = np.repeat(np.arange(len(dense)), np.diff(ends))
    part = slice(ends[0], ends[-1])
    dense[row, design.indices[part]] = design.data[part]


def rows_by_run(values: Array, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Split values (r, ...) of the rows of all runs: one array (c, p, ...) for each of shapes."""
    ends = np.cumsum([np.prod(shape, dtype=int) for shape in shapes])
    parts = zip(np.split(values, ends[:-1]), shapes, strict=True)
    return [part.reshape(*shape, *values.shape[1:]) for part, shape in parts]
