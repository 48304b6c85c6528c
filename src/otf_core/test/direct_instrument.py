# SPDX-License-Identifier: Apache-2.0
"""Simulated direct instrument: a stand-in for a six-degree-of-freedom laser, not a model of one.

Its noise has the order of magnitude that makers of such instruments state; nothing here was
measured on a real one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.direct import AxisReadings, DirectMeasurement
from otf_core.model.chain import displacement
from otf_core.model.motions import DIRECTIONS
from otf_core.model.tables import ErrorTables


@dataclass(frozen=True)
class InstrumentNoise:
    """Standard deviations of the readings.

    Attributes
    ----------
    length : float
        m, positioning, per reading.
    length_scale : float
        m/m, of the wavelength compensation, one value per axis set-up.
    lateral : float
        m, straightness, per reading.
    angle : float
        rad, per reading.
    drift : float
        m and, per metre, rad: drift over one run, to and fro.
    """

    length: float = 0.2e-6
    length_scale: float = 0.3e-6
    lateral: float = 0.4e-6
    angle: float = 0.7e-6
    drift: float = 0.3e-6


def measure_directly(
    tables: ErrorTables,
    seed: int,
    runs: int = 5,
    positions: int = 21,
    noise: InstrumentNoise | None = None,
) -> DirectMeasurement:
    """Measure the three axes one after the other along lines through the middle of the volume.

    Parameters
    ----------
    tables : ErrorTables
        Errors of the truth machine.
    runs, positions : int
        Paper 2.3: five runs, forward and backward.
    """
    rng = np.random.default_rng([seed, 77])
    noise = noise or InstrumentNoise()
    machine = tables.machine
    middle = 0.5 * (machine.lower + machine.upper)
    axes = {}
    for k, axis in enumerate(machine.axis_names):
        position = np.linspace(machine.lower[k], machine.upper[k], positions)
        true = _true_readings(tables, axis, position, middle)
        true[:, k] += rng.normal(0, noise.length_scale) * (position - position[0])
        for lateral in set(range(3)) - {k}:  # the beam is aligned by hand
            true[:, lateral] += rng.normal(0, 20e-6) * (position - position[0])
        value = true + _reading_noise(rng, noise, k, (runs, 2, positions))
        axes[axis] = AxisReadings(position, value, middle)
    return DirectMeasurement(axes, u_length_scale=noise.length_scale)


def _true_readings(tables: ErrorTables, axis: str, position: Array, middle: Array) -> Array:
    """Six errors along the line through ``middle``, relative to its start, shape (k, 6)."""
    q = np.tile(middle, (len(position), 1))
    q[:, tables.machine.axis_names.index(axis)] = position
    moved = displacement(tables, q)
    turned = np.stack([tables.motions[f'E{d}{axis}'].at(position) for d in DIRECTIONS[3:]], axis=1)
    return np.hstack([moved - moved[0], turned - turned[0]])


def _reading_noise(
    rng: np.random.Generator, noise: InstrumentNoise, along: int, shape: tuple[int, int, int]
) -> Array:
    runs, _, positions = shape
    size = np.array([noise.lateral] * 3 + [noise.angle] * 3)
    size[along] = noise.length
    offset = rng.normal(0, 1, (runs, 1, 1, 6)) * size
    # drift over the run: forward 0 to 1, then backward 1 to 2 in the order of time
    time = np.stack([np.linspace(0, 1, positions), np.linspace(2, 1, positions)])
    drift = rng.normal(0, noise.drift, (runs, 1, 1, 6)) * time[None, :, :, None]
    return np.asarray(offset + drift + rng.normal(0, 1, (*shape, 6)) * size)
