# SPDX-License-Identifier: Apache-2.0
"""Tracker of the independent nature: range and two angles, each with white and coloured noise.

Noise across the beam is u_angle * range in two directions, of which the first is level in the
tracker's own frame; the three channels are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter


@dataclass(frozen=True)
class Noise:
    """Noise of a tracker: levels, colour and tails.

    Attributes
    ----------
    u_range, u_angle : float
        m and rad, standard deviations of single samples, coloured and white together.
    colour : float
        Share of the variance that is Gauss-Markov with the time constant ``tau``, s.
    tails : float, optional
        Degrees of freedom of Student's t of the white part, its variance kept; normal if None.
    factor : float
        On all of it.
    """

    u_range: float = 0.5e-6
    u_angle: float = 1.5e-6
    colour: float = 0.6
    tau: float = 0.3
    tails: float | None = None
    factor: float = 1.0


def coloured(rng, count, step, share, tau, tails):
    """Noise of unit variance: the share is Gauss-Markov of time constant tau, the rest white."""
    keep = np.exp(-step / tau)
    kicks = rng.standard_normal(count) * np.sqrt(1 - keep**2)
    kicks[0] = rng.standard_normal()
    slow = lfilter([1.0], [1.0, -keep], kicks)
    if tails is None:
        fast = rng.standard_normal(count)
    else:
        fast = rng.standard_t(tails, count) * np.sqrt((tails - 2) / tails)
    return np.sqrt(share) * slow + np.sqrt(1 - share) * fast


def beam_frame(xyz):
    """Unit vectors along the beam and twice across it, (3, n, 3), for points (n, 3)."""
    beam = xyz / np.linalg.norm(xyz, axis=1)[:, None]
    first = np.cross(beam, [0.0, 0.0, 1.0])
    steep = np.linalg.norm(first, axis=1) < 1e-3
    first[steep] = np.cross(beam[steep], [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([beam, first, np.cross(beam, first)])


def spoiled(xyz, noise, step, rng):
    """Points (n, 3) in the tracker frame, one every ``step`` seconds, with noise."""
    distance = np.linalg.norm(xyz, axis=1)
    size = (noise.u_range, noise.u_angle * distance, noise.u_angle * distance)
    for direction, level in zip(beam_frame(xyz), size, strict=True):
        series = coloured(rng, len(xyz), step, noise.colour, noise.tau, noise.tails)
        xyz = xyz + (noise.factor * level * series)[:, None] * direction
    return xyz
