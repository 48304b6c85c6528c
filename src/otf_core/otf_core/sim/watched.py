# SPDX-License-Identifier: Apache-2.0
"""A simulated tracker that watches a machine which somebody else moves.

The tracker has a clock of its own: another rate, another start than that of the motion.
"""

from __future__ import annotations

import numpy as np

from otf_core.arrays import Array
from otf_core.config import SimulationConfig
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.sim.cell import EPOCH_NS
from otf_core.sim.tracker import measure, specified_noise


def sample_moving_target(
    time: Array,
    position: Array,
    T_machine_tracker: RigidTransform,
    machine: Machine,
    config: SimulationConfig,
    rng: np.random.Generator,
) -> Samples:
    """Samples of a moving target.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Ascending, on the clock of the motion.
    position : ndarray, shape (n, 3), m
        Target relative to the table, machine frame; straight between the times.
    T_machine_tracker : RigidTransform
        Tracker to machine.
    machine : Machine
        Its tracker says the noise.
    config : SimulationConfig
        Rate, clock and colour of the noise.
    """
    step = 1.0 / (config.rate * (1.0 + config.clock_drift))
    moments = np.arange(time[0] + step * rng.uniform(), time[-1], step)
    actual = np.stack([np.interp(moments, time, position[:, k]) for k in range(3)], axis=1)
    seen = (actual - T_machine_tracker.translation) @ T_machine_tracker.rotation
    xyz = measure(seen, specified_noise(machine, config), config.rate, rng)
    stamp = EPOCH_NS + np.rint(1e9 * np.arange(len(moments)) / config.rate).astype(np.int64)
    return Samples(stamp, xyz)
