# SPDX-License-Identifier: Apache-2.0
"""Simulated laser tracker: range and angle noise, white and correlated in time, own clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from otf_core.config import SimulationConfig
from otf_core.model.machine import Machine

Array = NDArray[np.float64]

PACKETS = 3.0
"""Packets per second: recorded trackers send a third of a second at once, whatever the rate."""


@dataclass(frozen=True)
class NoiseLevel:
    """Departure of the noise from the specification.

    Attributes
    ----------
    range, angle : float
        Factors on u_range and u_angle.
    dof : float
        Degrees of freedom of Student's t that the white part follows; infinite: normal.
    """

    range: float = 1.0
    angle: float = 1.0
    dof: float = math.inf


def _white(rng: np.random.Generator, n: int, dof: float) -> Array:
    """White noise of unit variance."""
    if math.isinf(dof):
        return rng.standard_normal(n)
    return np.asarray(rng.standard_t(dof, n) * math.sqrt((dof - 2.0) / dof))


def coloured_noise(
    rng: np.random.Generator, n: int, config: SimulationConfig, dof: float = math.inf
) -> Array:
    """Noise of unit variance: white part plus first-order Gauss-Markov part.

    Parameters
    ----------
    rng : numpy.random.Generator
    n : int
    config : SimulationConfig
        Share, correlation time and rate.
    dof : float
        Degrees of freedom of the white part, above 2; infinite: normal.

    Returns
    -------
    ndarray, shape (n,)
    """
    share = config.correlated_share
    decay = float(np.exp(-1.0 / (config.rate * config.correlation_time)))
    drive = rng.standard_normal(n) * np.sqrt(1.0 - decay**2)
    drive[0] = rng.standard_normal()
    slow = lfilter([1.0], [1.0, -decay], drive)
    return np.asarray(np.sqrt(1.0 - share) * _white(rng, n, dof) + np.sqrt(share) * slow)


def beam_frame(xyz: Array) -> tuple[Array, Array, Array]:
    """Range and the two unit vectors across the beam.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3), m
        Points in the tracker frame.

    Returns
    -------
    distance : ndarray, shape (n,), m
    along_azimuth, along_elevation : ndarray, shape (n, 3)
    """
    distance = np.linalg.norm(xyz, axis=1)
    level = np.hypot(xyz[:, 0], xyz[:, 1])
    zero = np.zeros_like(level)
    along_azimuth = np.stack([-xyz[:, 1], xyz[:, 0], zero], axis=1) / level[:, None]
    return distance, along_azimuth, np.cross(xyz / distance[:, None], along_azimuth)


def measure(
    xyz: Array,
    machine: Machine,
    config: SimulationConfig,
    rng: np.random.Generator,
    level: NoiseLevel | None = None,
) -> Array:
    """Return noisy points for true points ``xyz`` (n, 3) in the tracker frame, m."""
    level = level or NoiseLevel()
    distance, along_azimuth, along_elevation = beam_frame(xyz)
    n = len(xyz)
    along = level.range * machine.tracker.u_range * coloured_noise(rng, n, config, level.dof)
    u_across = level.angle * machine.tracker.u_angle * distance
    across = [u_across * coloured_noise(rng, n, config, level.dof) for _ in range(2)]
    return np.asarray(
        xyz
        + xyz / distance[:, None] * along[:, None]
        + along_azimuth * across[0][:, None]
        + along_elevation * across[1][:, None]
    )


def received(time: Array, loss: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which samples arrive: those of whole packets are lost together.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Since the start.
    loss : float
        Share of packets that is lost.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    packet = (time * PACKETS).astype(np.int64)
    return np.asarray(rng.random(int(packet[-1]) + 1) >= loss)[packet]


def place_tracker(machine: Machine, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a place beside the working volume and any orientation.

    Returns
    -------
    rotation : ndarray, shape (3, 3)
        Takes machine coordinates (less the place) to tracker coordinates.
    place : ndarray, shape (3,), m
        Beam origin in the machine frame.
    """
    size = machine.upper - machine.lower
    centre = 0.5 * (machine.lower + machine.upper)
    side = rng.uniform(0, 2 * np.pi)
    radius = 0.5 * np.hypot(size[0], size[1]) + rng.uniform(0.15, 0.35)
    place = centre + np.array([radius * np.cos(side), radius * np.sin(side), 0.0])
    place[2] += size[2] * rng.uniform(-0.6, 0.2)
    return Rotation.random(random_state=rng).as_matrix(), place
