# SPDX-License-Identifier: Apache-2.0
"""Tracker noise: from range and angle noise of samples to the covariance of path pieces.

Along the beam u_range, across it u_angle * range (paper Eq. 8-10, derived anew in
docs/formulation.md since Eq. 4 prints the path direction where the beam direction belongs).
Samples are not independent: each variance has a white part and a part that is correlated in time
(first-order Gauss-Markov). ``NoiseModel`` is the one place that knows how noise averages out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.model.machine import TrackerSpec

Array = NDArray[np.float64]
Windows = tuple[Array, Array, NDArray[np.int64]]
"""Mean time, duration (s) and number of samples of pieces."""

TYPICAL_WHITE_SHARE = 0.5
TYPICAL_CORRELATION_TIME = 0.3
"""Taken where a run has too little standstill to tell: real trackers show 0.1 s to 0.5 s."""


MODEL_FLOOR = 5e-8
"""m; independent uncertainty of every piece at least: tables are not better than that."""
MISFIT_TIME = 3.0
"""s; about a line of the path."""


@dataclass(frozen=True)
class NoiseModel:
    """Noise of single samples.

    Attributes
    ----------
    u_range : float
        m, total standard deviation along the beam.
    u_angle : float
        rad, total standard deviation of each angle.
    white_range, white_angle : float
        Shares of these variances that are independent from sample to sample.
    correlation_time : float
        s, of the rest.
    """

    u_range: float
    u_angle: float
    white_range: float = TYPICAL_WHITE_SHARE
    white_angle: float = TYPICAL_WHITE_SHARE
    correlation_time: float = TYPICAL_CORRELATION_TIME

    @classmethod
    def from_spec(cls, spec: TrackerSpec) -> NoiseModel:
        """Levels as specified in machine.yaml, colour as typical."""
        return cls(spec.u_range, spec.u_angle)


@dataclass(frozen=True)
class Misfit:
    """What the model leaves besides the noise of the tracker, alike in all directions.

    Attributes
    ----------
    independent : float
        m, of every piece on its own.
    slow : float
        m, correlated over ``MISFIT_TIME``: shared by the pieces of a line.
    """

    independent: float = MODEL_FLOOR
    slow: float = 0.0


WHITE, SLOW, TIME, INDEPENDENT, LASTING = range(5)
"""Places of five logarithms: factors on the white and on the slow variance of the tracker's noise,
its correlation time (s), variances of the misfit (m^2)."""


def scaled(noise: NoiseModel, logs: Array) -> NoiseModel:
    """Noise with its white and slow variances multiplied and another correlation time."""
    white, slow = np.exp(logs[WHITE]), np.exp(logs[SLOW])

    def level(u: float, share: float) -> tuple[float, float]:
        own, rest = u**2 * share * white, u**2 * (1.0 - share) * slow
        return float(np.sqrt(own + rest)), float(own / max(own + rest, 1e-300))

    u_range, white_range = level(noise.u_range, noise.white_range)
    u_angle, white_angle = level(noise.u_angle, noise.white_angle)
    return NoiseModel(u_range, u_angle, white_range, white_angle, float(np.exp(logs[TIME])))


def misfit_of(logs: Array) -> Misfit:
    """Misfit for the logarithms of its variances."""
    return Misfit(float(np.exp(0.5 * logs[INDEPENDENT])), float(np.exp(0.5 * logs[LASTING])))


def path_frame(direction: Array, beam: Array) -> tuple[Array, Array]:
    """The two axes of the path coordinate system perpendicular to the path (paper Eq. 1).

    a2 is the beam direction less its part along the path, a3 = a1 x a2. Eq. 1 prints
    b - b . a1, which subtracts a number from a vector; meant is b - (b . a1) a1.

    Parameters
    ----------
    direction : ndarray, shape (n, 3)
        Unit direction of the path, a1.
    beam : ndarray, shape (n, 3)
        Unit direction of the beam in the same frame.

    Returns
    -------
    a2, a3 : ndarray, shape (n, 3)
        Where the beam runs along the path, any two perpendicular unit vectors.
    """
    across = beam - direction * np.einsum('ij,ij->i', beam, direction)[:, None]
    size = np.linalg.norm(across, axis=1)
    parallel = size < 1e-6
    if np.any(parallel):
        helper = np.eye(3)[np.argmin(np.abs(direction[parallel]), axis=1)]
        across[parallel] = np.cross(direction[parallel], helper)
        size[parallel] = np.linalg.norm(across[parallel], axis=1)
    a2 = across / size[:, None]
    return a2, np.cross(direction, a2)


def beam_shares(distance: Array, beam: Array, axes: Array) -> tuple[Array, Array]:
    """How range and angle noise enter the two perpendicular components.

    Parameters
    ----------
    distance : ndarray, shape (p,), m
    beam : ndarray, shape (p, 3)
        Unit vectors.
    axes : ndarray, shape (2, p, 3)
        a2 and a3.

    Returns
    -------
    along : ndarray, shape (2, p)
        Component per m of range noise (paper Eq. 4 with the beam direction).
    across : ndarray, shape (2, p), m
        Component per rad of angle noise. a3 is perpendicular to the beam, so the noise of the
        two components is not correlated.
    """
    along = np.einsum('kij,ij->ki', axes, beam)
    return along, distance * np.sqrt(np.maximum(1.0 - along**2, 0.0))


def sample_variance(noise: NoiseModel, along: Array, across: Array) -> Array:
    """Variance of single samples, shape (2, p), m^2, for the shares of ``beam_shares``."""
    return (noise.u_range * along) ** 2 + (noise.u_angle * across) ** 2


def covariance_parts(
    noise: NoiseModel, misfit: Misfit, shares: tuple[Array, Array], windows: Windows
) -> tuple[Array, Array, Array, Array]:
    """Covariance of the pieces of a line in one component, part by part.

    Parameters
    ----------
    noise : NoiseModel
    misfit : Misfit
    shares : two ndarrays, shape (m,)
        Of range and angle noise, see ``beam_shares``.
    windows : tuple of time, duration (s) and count, each of shape (m,)
        See ``mean_covariance``.

    Returns
    -------
    white, slow : ndarray, shape (m, m), m^2
        Noise of the tracker.
    independent, lasting : ndarray, shape (m, m), m^2
        The parts of the misfit.
    """
    time, duration, count = windows
    weights = (noise.u_range * shares[0], noise.u_angle * shares[1])
    whites = (noise.white_range, noise.white_angle)
    white = sum(w * g**2 for w, g in zip(whites, weights, strict=True)) / count
    slow = mean_covariance(0.0, noise.correlation_time, time, duration, count)
    slow *= sum((1.0 - w) * np.outer(g, g) for w, g in zip(whites, weights, strict=True))
    lasting = np.zeros_like(slow)
    if misfit.slow:
        lasting = misfit.slow**2 * mean_covariance(0.0, MISFIT_TIME, time, duration, count)
    independent = misfit.independent**2 * np.eye(len(time))
    return np.diag(white), slow, independent, lasting


def mean_covariance(
    white: float, correlation_time: float, time: Array, duration: Array, count: NDArray[np.int64]
) -> Array:
    """Covariance of means over time windows for noise of unit variance.

    Parameters
    ----------
    white : float
        White share of the variance.
    correlation_time : float
        s, of the rest.
    time, duration : ndarray, shape (m,), s
        Centres and lengths of the windows, which do not overlap.
    count : ndarray, shape (m,)
        Samples in each.

    Returns
    -------
    ndarray, shape (m, m)
        Exact for windows sampled densely.
    """
    x = np.maximum(duration / correlation_time, 1e-6)
    half = np.sinh(np.minimum(0.5 * x, 50.0)) / (0.5 * x)
    gap = np.abs(time[:, None] - time[None, :]) / correlation_time
    matrix = np.exp(-gap) * np.minimum(half[:, None] * half[None, :], np.exp(0.999 * gap))
    own = np.where(x < 1e-3, 1.0 - x / 3.0, 2.0 * (x - 1.0 + np.exp(-x)) / x**2)
    np.fill_diagonal(matrix, own)
    matrix *= 1.0 - white
    matrix[np.diag_indices_from(matrix)] += white / count
    return matrix
