# SPDX-License-Identifier: Apache-2.0
"""Where the target of the simulated cell is, seen by the tracker, at every tick of its clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.model.machine import Machine
from otf_core.model.tables import ErrorTables
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate

TICK = 1e-3
"""s on the tracker's clock; the shortest time between samples."""
STANDING = 1000
"""Ticks at the end of the run that are repeated for as long as found there."""


class Cell:
    """A run of the planned path, sampled a thousand times per second of the tracker's clock.

    Parameters
    ----------
    planning : PlannerConfig
        The path is that of a path planner with the same parameters.
    seed : int
        Of all random numbers.
    drift : float
        Rate of the tracker's clock, less one.
    truth : ErrorTables, optional
        Errors of the machine; drawn from the seed if not given.
    """

    def __init__(
        self,
        machine: Machine,
        planning: PlannerConfig,
        seed: int,
        drift: float,
        truth: ErrorTables | None = None,
    ) -> None:
        rate = (1 + drift) / TICK
        config = SimulationConfig(seed=seed, rate=rate, clock_drift=0.0)
        if truth is not None:
            truth = truth.on(machine)
        run = simulate(machine, plan_path(machine, planning), config, truth)
        self._xyz = run.samples.xyz
        self.truth = run.truth

    @property
    def ticks(self) -> int:
        """Ticks of the whole run."""
        return len(self._xyz)

    def at(self, tick: NDArray[np.int64]) -> NDArray[np.float64]:
        """Measured points at these ticks since the machine started, shape (n, 3), m."""
        standing = min(STANDING, self.ticks)
        start = self.ticks - standing
        index = np.where(tick < self.ticks, tick, start + (tick - start) % standing)
        return np.asarray(self._xyz[np.maximum(index, 0)])
