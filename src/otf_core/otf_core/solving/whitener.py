# SPDX-License-Identifier: Apache-2.0
"""Rows whitened: freed of the correlation of their noise (generalised least squares).

Pieces of one leg share slow noise, so their covariance is a full matrix; legs are separated by
corners and count as independent. Legs with the same number of pieces are factored together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from otf_core.arrays import Array, Index
from otf_core.errors import InputError
from otf_core.model.path import leg_bounds
from otf_core.noise.noise_model import (
    Misfit,
    NoiseModel,
    Windows,
    add_to_diagonal,
    covariance_parts,
)
from otf_core.pieces.pieces import Pieces
from otf_core.solving.system import System


@dataclass(frozen=True)
class Covariances:
    """Covariances of the rows of a run.

    Attributes
    ----------
    shares : ndarray, shape (3, c, p)
        See ``system.System``.
    windows : tuple of time, duration (s) and count, each of shape (p,)
    """

    noise: NoiseModel
    misfit: Misfit
    shares: Array
    windows: Windows

    def among(self, own: Index) -> Array:
        """Of the pieces (n, m) of n lines, shape (c, n, m, m), m^2."""
        time, duration, count = self.windows
        windows = (time[own], duration[own], count[own])
        white, slow, own_misfit, lasting = covariance_parts(
            self.noise, self.misfit, self.shares[:, :, own], windows
        )
        slow += lasting
        return add_to_diagonal(slow, white + own_misfit)


def inverse_factor(covariance: Array) -> Array:
    """Inverses of the lower Cholesky factors (..., m, m); LinAlgError if there is none."""
    return inverse_of_lower(np.asarray(np.linalg.cholesky(covariance)))


@dataclass(frozen=True)
class CovarianceMoments:
    """Quantities of the covariances S of lines besides their inverses.

    Attributes
    ----------
    variance : ndarray, shape (c, n, m), m^2
        Of every piece.
    square : ndarray, shape (c, n), m^4
        tr S S.
    """

    variance: Array
    square: Array

    @classmethod
    def of(cls, covariance: Array) -> CovarianceMoments:
        """Of covariances (c, n, m, m)."""
        own = np.diagonal(covariance, axis1=-2, axis2=-1)
        return cls(own.copy(), np.einsum('cnij,cnij->cn', covariance, covariance))

    def only(self, some: NDArray[np.bool_] | slice) -> CovarianceMoments:
        """Those of some of the lines."""
        return CovarianceMoments(self.variance[:, some], self.square[:, some])


@dataclass(frozen=True)
class EqualLegs:
    """Some legs of as many pieces.

    Attributes
    ----------
    legs : ndarray of int64, shape (n,)
        Which of all legs, by their place in ``Whitener.bounds``.
    pieces : ndarray of int64, shape (n, m)
    held : ndarray, shape (c, n, m, m), 1/m, or Covariances
        ``inverse``, or what it is made of.
    known : CovarianceMoments, optional
        ``moments``, where the covariances were at hand.
    """

    legs: Index
    pieces: Index
    held: Array | Covariances
    known: CovarianceMoments | None = None

    @property
    def inverse(self) -> Array:
        """Inverses of the lower Cholesky factors of every component, shape (c, n, m, m), 1/m."""
        if isinstance(self.held, Covariances):
            return inverse_factor(self.held.among(self.pieces))
        return self.held

    @property
    def moments(self) -> CovarianceMoments:
        """Those of the covariances."""
        if self.known is not None:
            return self.known
        factor = inverse_of_lower(self.inverse)
        return CovarianceMoments.of(factor @ np.swapaxes(factor, -1, -2))

    def inverse_of(self, k: int) -> Array:
        """Those of one leg, by its place in ``legs``, shape (c, m, m)."""
        if isinstance(self.held, Covariances):
            return inverse_factor(self.held.among(self.pieces[k : k + 1]))[:, 0]
        return self.held[:, k]

    def only(self, some: NDArray[np.bool_] | slice) -> EqualLegs:
        """Some of the legs, by a mask (n,) or their places."""
        held = self.held if isinstance(self.held, Covariances) else self.held[:, some]
        known = None if self.known is None else self.known.only(some)
        return EqualLegs(self.legs[some], self.pieces[some], held, known)

    def between(self, low: int, high: int) -> EqualLegs:
        """Those of the legs from one up to another."""
        return self.only(slice(*np.searchsorted(self.legs, [low, high]).tolist()))


def inverse_of_lower(lower: Array) -> Array:
    """Inverses of lower triangular matrices (..., m, m)."""
    size = lower.shape[-1]
    inverses = [dtrtri(own.T)[0].T for own in lower.reshape(-1, size, size)]
    return np.stack(inverses).reshape(lower.shape)


NO_MISFIT = Misfit()
SAME_PLACE = 5e-4
"""m; half a step between samples at a usual feed: so far pieces of two passes may be apart."""
BYTES_PER_BLOCK = 1e6
"""Bytes of covariances that are factored at once."""
MAX_BYTES_IN_MEMORY = 1e8
"""Bytes of matrices that are held; those of a longer run are made anew whenever they are used."""


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
    line : ndarray of int64, shape (legs,)
        Line that each leg is a pass over, from 0: laps drive the same lines.
    """

    bounds: Sequence[tuple[int, int]]
    alike: tuple[EqualLegs, ...]
    line: Index

    @classmethod
    def of(
        cls, system: System, pieces: Pieces, noise: NoiseModel, misfit: Misfit = NO_MISFIT
    ) -> Whitener:
        """For the noise of pieces.

        Parameters
        ----------
        system : System
            Its shares of noise change little between iterations.

        Raises
        ------
        InputError
            If a covariance is not positive definite.
        """
        bounds = leg_bounds(pieces.leg)
        low, high = np.array(bounds, dtype=np.int64).reshape(-1, 2).T
        windows = (pieces.time, pieces.duration, pieces.count)
        covariances = Covariances(noise, misfit, system.shares, windows)
        groups = list(_alike(high - low))
        size = [system.deviation.itemsize * len(system.deviation) * len(legs) *
                int(high[legs[0]] - low[legs[0]]) ** 2 for legs in groups]  # fmt: skip
        held = (np.cumsum(size) <= MAX_BYTES_IN_MEMORY).tolist()

        def alike(k: int) -> EqualLegs:
            legs = groups[k]
            own = low[legs, None] + np.arange(high[legs[0]] - low[legs[0]])
            among = covariances.among(own)
            try:
                inverse = inverse_factor(among)
            except np.linalg.LinAlgError:
                raise _two_passes(pieces, own, among) from None
            moments = CovarianceMoments.of(among)
            return EqualLegs(legs, own, inverse if held[k] else covariances, moments)

        groups_alike = map(alike, range(len(groups)))
        return cls(bounds, tuple(groups_alike), _lines_of(pieces, system.q, bounds))

    @classmethod
    def from_factors(
        cls, bounds: Sequence[tuple[int, int]], factors: Sequence[Sequence[Array]]
    ) -> Whitener:
        """From the lower Cholesky factors (m, m) of every leg and component."""
        size = np.array([high - low for low, high in bounds])
        alike = []
        for legs in _alike(size):
            own = np.array([np.arange(*bounds[k]) for k in legs.tolist()])
            stacked = np.stack([np.stack(list(factors[k])) for k in legs.tolist()], axis=1)
            alike.append(EqualLegs(legs, own, inverse_of_lower(stacked)))
        return cls(bounds, tuple(alike), np.arange(len(bounds)))

    def scaled(self, factor: Array) -> Whitener:
        """The same for noise with a factor (c, p) on the standard deviation of every piece."""
        alike = (
            EqualLegs(one.legs, one.pieces, one.inverse / factor[:, one.pieces][:, :, None])
            for one in self.alike
        )
        return Whitener(self.bounds, tuple(alike), self.line)

    @property
    def factors(self) -> tuple[tuple[Array, ...], ...]:
        """Lower Cholesky factors (m, m) of every leg and component, m."""
        return tuple(tuple(inverse_of_lower(inverse)) for inverse in self.inverses)

    @cached_property
    def inverses(self) -> Sequence[Array]:
        """Their inverses, shape (c, m, m), 1/m, leg by leg."""
        return _Legs(self.alike)

    @cached_property
    def expected(self) -> Array:
        """Standard deviation of the noise of every piece, shape (c, p), m."""
        components = len(self.inverses[0]) if self.alike else 2
        scatter = np.empty((components, self.bounds[-1][1] if self.bounds else 0))
        for alike in self.alike:
            scatter[:, alike.pieces] = np.sqrt(alike.moments.variance)
        return scatter

    def _applied(
        self,
        product: Callable[[Array, Array], Array],
        values: Array,
        legs: tuple[int, int] | None = None,
    ) -> Array:
        """Products of the inverses (c, n, m, m) of the legs with values (c, p, ...)."""
        wide = values.reshape(*values.shape[:2], -1)
        result = np.zeros_like(wide)
        first = self.bounds[legs[0]][0] if legs else 0
        for alike in self.alike if legs is None else [a.between(*legs) for a in self.alike]:
            if len(alike.legs):
                place = alike.pieces - first
                result[:, place] = product(alike.inverse, wide[:, place])
        return result.reshape(values.shape)

    def whiten(self, values: Array) -> Array:
        """Free values (c, p, ...) of the correlation: noise as expected has unit variance."""
        return self._applied(np.matmul, values)

    def whiten_transposed(self, values: Array) -> Array:
        """Apply the transpose of ``whiten``: for products with columns."""
        return self._applied(lambda inverse, own: np.swapaxes(inverse, -1, -2) @ own, values)

    def unwhiten(self, values: Array) -> Array:
        """Undo ``whiten``."""
        return self._applied(lambda inverse, own: inverse_of_lower(inverse) @ own, values)

    def weighted(self, values: Array, legs: tuple[int, int] | None = None) -> Array:
        """Multiply values (c, p, ...) by the inverse covariance of the noise.

        Of all legs, or of the pieces of the ``legs`` from one up to another.
        """

        def product(inverse: Array, own: Array) -> Array:
            return np.asarray(np.swapaxes(inverse, -1, -2) @ (inverse @ own))

        return self._applied(product, values, legs)


class _Legs(Sequence[Array]):
    """Inverses leg by leg."""

    def __init__(self, alike: Sequence[EqualLegs]) -> None:
        places = {leg: (a, k) for a in alike for k, leg in enumerate(a.legs.tolist())}
        self._places = [places[leg] for leg in range(len(places))]

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, leg: int) -> Array:  # type: ignore[override]
        alike, k = self._places[leg]
        return alike.inverse_of(k)


def _alike(size: Index) -> Iterator[Index]:
    """Legs of one size at a time, by the sizes (n,) of all, at most ``BYTES_PER_BLOCK``."""
    for m in np.unique(size).tolist():
        legs = np.flatnonzero(size == m)
        most = max(1, int(BYTES_PER_BLOCK / (16.0 * m**2)))
        yield from (legs[k : k + most] for k in range(0, len(legs), most))


def _two_passes(pieces: Pieces, own: Index, covariance: Array) -> InputError:
    """State which of some legs has a covariance that is not positive definite."""
    lowest = np.linalg.eigvalsh(covariance)[..., 0]
    leg = int(pieces.leg[own[np.unravel_index(np.argmin(lowest), lowest.shape)[-1], 0]])
    return InputError(
        f'leg {leg} of the path: its samples belong to two passes; '
        f'path and track do not agree there'
    )


def _lines_of(pieces: Pieces, q: Array, bounds: Sequence[tuple[int, int]]) -> Index:
    """Number the lines of legs: the same pieces, travel and side of play are one.

    Parameters
    ----------
    q : ndarray, shape (p, 3), m
        Nominal positions.
    bounds : sequence of (int, int)
        First piece and one past the last of every leg.

    Returns
    -------
    ndarray of int64, shape (legs,)
        Line of each leg, from 0.
    """
    lines = np.hstack([pieces.origin, pieces.direction, pieces.side]).round(6)
    known: dict[tuple[float, ...], list[int]] = {}
    first = np.arange(len(bounds))
    for leg, (low, high) in enumerate(bounds):
        others = known.setdefault((high - low, *lines[low].tolist()), [])
        for other in others:
            start = bounds[other][0]
            if np.abs(q[start : start + high - low] - q[low:high]).max() < SAME_PLACE:
                first[leg] = other
                break
        else:
            others.append(leg)
    return np.unique(first, return_inverse=True)[1]
