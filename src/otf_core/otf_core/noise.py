# SPDX-License-Identifier: Apache-2.0
"""Tracker noise: from range and angle uncertainty to the uncertainty of path pieces.

Along the beam u_range, across it u_angle * range (paper Eq. 8-10, derived anew in
docs/formulation.md since Eq. 4 prints the path direction where the beam direction belongs).
``NoiseModel`` is the one place that knows how noise averages out over a piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.machine import TrackerSpec

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseModel:
    """Standard uncertainties of a sample and the part of them that averages out.

    Attributes
    ----------
    u_range : float
        m, along the beam.
    u_angle : float
        rad, each angle.
    white_share : float
        Share of the variance that is independent from sample to sample; the rest is taken as
        common to all samples of a piece.
    """

    u_range: float
    u_angle: float
    white_share: float = 1.0

    @classmethod
    def from_spec(cls, spec: TrackerSpec) -> NoiseModel:
        """Noise as specified in machine.yaml, independent samples."""
        return cls(spec.u_range, spec.u_angle)

    def piece_factor(self, count: NDArray[np.int64]) -> Array:
        """Variance of the mean of ``count`` samples, as a ratio to that of one sample."""
        return np.asarray(self.white_share / count + (1.0 - self.white_share))


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


def perpendicular_variance(
    noise: NoiseModel, distance: Array, beam: Array, a2: Array, a3: Array
) -> Array:
    """Variances of one sample along a2 and a3 (paper Eq. 4 with the beam direction).

    Parameters
    ----------
    noise : NoiseModel
    distance : ndarray, shape (n,), m
        Range.
    beam, a2, a3 : ndarray, shape (n, 3)
        Unit vectors in one frame.

    Returns
    -------
    ndarray, shape (n, 2), m^2
        a3 is perpendicular to the beam, so the two components are not correlated.
    """
    along, across = noise.u_range**2, (noise.u_angle * distance) ** 2
    cosine = np.stack([np.einsum('ij,ij->i', beam, a) for a in (a2, a3)], axis=1) ** 2
    return np.asarray(along * cosine + across[:, None] * (1.0 - cosine))
