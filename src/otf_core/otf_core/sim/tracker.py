# SPDX-License-Identifier: Apache-2.0
"""Simulated laser tracker: range and angle noise, white and correlated in time, own clock."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtbsv
from scipy.spatial.transform import Rotation

from otf_core.arrays import Array
from otf_core.config import SimulationConfig
from otf_core.model.frames import RigidTransform, beam_frame
from otf_core.model.machine import Machine
from otf_core.model.motions import AXES
from otf_core.noise.noise_model import NoiseComponent, NoiseModel

PACKETS = 3.0
"""Packets per second: recorded trackers send a third of a second at once, whatever the rate."""


def specified_noise(machine: Machine, config: SimulationConfig) -> NoiseModel:
    """Levels of machine.yaml with the colour of the simulation, normal."""
    return NoiseModel.from_spec(
        machine.tracker, 1.0 - config.correlated_share, config.correlation_time
    )


def _white(rng: np.random.Generator, n: int, dof: float | None) -> Array:
    """White noise of unit variance."""
    if dof is None:
        return rng.standard_normal(n)
    return np.asarray(rng.standard_t(dof, n) * math.sqrt((dof - 2.0) / dof))


def draw_noise(noise: NoiseComponent, rng: np.random.Generator, n: int, rate: float) -> Array:
    """Draw noise: white part plus first-order Gauss-Markov part.

    Parameters
    ----------
    rate : float
        Samples per second.

    Returns
    -------
    ndarray, shape (n,), m or rad
    """
    step, time = 1.0 / rate, noise.correlation_time
    decay = math.exp(-step / time) if time > 0 else 0.0
    drive = rng.standard_normal(n) * math.sqrt(1.0 - decay**2)
    drive[0] = rng.standard_normal()
    band = np.stack([np.ones(n), np.full(n, -decay)])  # slow[k] - decay slow[k - 1] = drive[k]
    slow = dtbsv(1, band, drive, lower=1, diag=1)
    return np.asarray(noise.white * _white(rng, n, noise.dof) + noise.slow * slow)


def measure(xyz: Array, noise: NoiseModel, rate: float, rng: np.random.Generator) -> Array:
    """Return noisy points for true points ``xyz`` (n, 3) in the tracker frame, m."""
    distance, along, horizontal, vertical = beam_frame(xyz)
    off_range, off_azimuth, off_elevation = (draw_noise(c, rng, len(xyz), rate) for c in noise)
    return np.asarray(
        xyz
        + along * off_range[:, None]
        + horizontal * (off_azimuth * distance)[:, None]
        + vertical * (off_elevation * distance)[:, None]
    )


def draw_received(time: Array, loss: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which samples arrive: those of whole packets are lost together.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Since the start.
    loss : float
        Share of packets that is lost.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    packet = (time * PACKETS).astype(np.int64)
    return np.asarray(rng.random(int(packet[-1]) + 1) >= loss)[packet]


def place_tracker(machine: Machine, rng: np.random.Generator) -> RigidTransform:
    """Draw the pose of a tracker: a place beside the working volume and any orientation."""
    reach = max(float(np.linalg.norm(target.place)) for target in machine.targets.values())
    axes = [machine.axes.get(letter) for letter in AXES]
    low, high = np.array([(a.min, a.max) if a else (-reach, reach) for a in axes]).T
    size, centre = high - low, 0.5 * (low + high)
    side = rng.uniform(0, 2 * np.pi)
    radius = 0.5 * np.hypot(size[0], size[1]) + rng.uniform(0.15, 0.35)
    place = centre + np.array([radius * np.cos(side), radius * np.sin(side), 0.0])
    place[2] += size[2] * rng.uniform(-0.6, 0.2)
    return RigidTransform(Rotation.random(random_state=rng).as_matrix().T, place)
