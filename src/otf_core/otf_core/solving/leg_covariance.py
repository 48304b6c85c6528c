# SPDX-License-Identifier: Apache-2.0
"""Covariances of the noise of legs of as many pieces, factored together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri, dtrtrs

from otf_core.arrays import Array, Index
from otf_core.noise.noise_model import Misfit, NoiseModel, Windows, covariance_parts, with_diagonal


@dataclass(frozen=True)
class Covariances:
    """Covariances of the rows of a run.

    Attributes
    ----------
    noise : NoiseModel
    misfit : Misfit
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
        return with_diagonal(slow, white + own_misfit)


def inverse_factor(covariance: Array) -> Array:
    """Inverses of the lower Cholesky factors (..., m, m); LinAlgError if there is none."""
    return inverse_of_lower(np.asarray(np.linalg.cholesky(covariance)))


@dataclass(frozen=True)
class Moments:
    """What is asked of the covariances S of lines besides their inverses.

    Attributes
    ----------
    variance : ndarray, shape (c, n, m), m^2
        Of every piece.
    step : ndarray, shape (c, n, m - 1), m^2
        Of the difference of two neighbouring pieces.
    square : ndarray, shape (c, n), m^4
        tr S S.
    """

    variance: Array
    step: Array
    square: Array

    @classmethod
    def of(cls, covariance: Array) -> Moments:
        """Of covariances (c, n, m, m)."""
        own = np.diagonal(covariance, axis1=-2, axis2=-1)
        beside = np.diagonal(covariance, 1, axis1=-2, axis2=-1)
        step = own[..., 1:] + own[..., :-1] - 2.0 * beside
        return cls(own.copy(), step, np.einsum('cnij,cnij->cn', covariance, covariance))

    def only(self, some: NDArray[np.bool_] | slice) -> Moments:
        """Those of some of the lines."""
        return Moments(self.variance[:, some], self.step[:, some], self.square[:, some])


@dataclass(frozen=True)
class Alike:
    """Some legs of as many pieces.

    Attributes
    ----------
    legs : ndarray of int64, shape (n,)
        Which of all legs, by their place in ``Whitener.bounds``.
    pieces : ndarray of int64, shape (n, m)
    held : ndarray, shape (c, n, m, m), 1/m, or Covariances
        ``inverse``, or what it is made of.
    known : Moments, optional
        ``moments``, where the covariances were at hand.
    """

    legs: Index
    pieces: Index
    held: Array | Covariances
    known: Moments | None = None

    @property
    def inverse(self) -> Array:
        """Inverses of the lower Cholesky factors of every component, shape (c, n, m, m), 1/m."""
        if isinstance(self.held, Covariances):
            return inverse_factor(self.held.among(self.pieces))
        return self.held

    @property
    def moments(self) -> Moments:
        """Those of the covariances."""
        if self.known is not None:
            return self.known
        factor = inverse_of_lower(self.inverse)
        return Moments.of(factor @ np.swapaxes(factor, -1, -2))

    def inverse_of(self, k: int) -> Array:
        """Those of one leg, by its place in ``legs``, shape (c, m, m)."""
        if isinstance(self.held, Covariances):
            return inverse_factor(self.held.among(self.pieces[k : k + 1]))[:, 0]
        return self.held[:, k]

    def only(self, some: NDArray[np.bool_] | slice) -> Alike:
        """Some of the legs, by a mask (n,) or their places."""
        held = self.held if isinstance(self.held, Covariances) else self.held[:, some]
        known = None if self.known is None else self.known.only(some)
        return Alike(self.legs[some], self.pieces[some], held, known)

    def between(self, low: int, high: int) -> Alike:
        """Those of the legs from one up to another."""
        return self.only(slice(*np.searchsorted(self.legs, [low, high]).tolist()))


def inverse_of_lower(lower: Array) -> Array:
    """Inverses of lower triangular matrices (..., m, m)."""
    size = lower.shape[-1]
    inverses = [dtrtri(own.T)[0].T for own in lower.reshape(-1, size, size)]
    return np.stack(inverses).reshape(lower.shape)


def covariance_times(inverse: Array, values: Array) -> Array:
    """Covariances (..., m, m) of inverse lower factors T, T^-1 T^-T, times values (..., m, k)."""
    size, found = inverse.shape[-1], np.empty(values.shape)
    flat = found.reshape(-1, *values.shape[-2:])
    pairs = zip(inverse.reshape(-1, size, size), values.reshape(flat.shape), strict=True)
    for k, (factor, own) in enumerate(pairs):
        half = dtrtrs(factor.T, own)[0]
        flat[k] = dtrtrs(factor.T, half, trans=1)[0]
    return found
