# SPDX-License-Identifier: Apache-2.0
"""Where the target of the simulated cell is, seen by the tracker, at every tick of its clock.

Between the parts of a run the reflector is moved by hand: the beam is broken, and can be found
again at the next target before that part is driven.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.model.machine import Machine
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.planning.forecast import Setup
from otf_core.planning.part_choice import planned
from otf_core.sim.cell import simulate

TICK = 1e-3
"""s on the tracker's clock; the shortest time between samples."""
STANDING = 1000
"""Ticks at the end of the run that are repeated for as long as found there."""


BY_HAND, BACK = 4000, 3000
"""Ticks for which the beam is broken between two parts, and for which the reflector then stands at
the next target before that part is driven."""


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
    plan : Plan, optional
        Instead of the one that is made for the machine.
    """

    def __init__(
        self,
        machine: Machine,
        planning: PlannerConfig,
        seed: int,
        drift: float,
        truth: ErrorTables | None = None,
        plan: Plan | None = None,
    ) -> None:
        rate = (1 + drift) / TICK
        config = SimulationConfig(seed=seed, rate=rate, clock_drift=0.0)
        if truth is not None:
            truth = truth.on(machine)
        run = simulate(machine, plan or planned(Setup.of(machine), planning), config, truth)
        self.truth = run.truth
        ends = np.flatnonzero(np.diff(run.samples.stamp_ns) > 1e9) + 1
        points, lit = [], []
        for drive, own in zip(run.drives, np.split(run.samples.xyz, ends), strict=True):
            if points:
                still = max(1, round(0.5 * drive.part.dwell[0] / TICK))
                points += [np.zeros((BY_HAND, 3)), np.resize(own[:still], (BACK, 3))]
                lit += [np.zeros(BY_HAND, dtype=bool), np.ones(BACK, dtype=bool)]
            points.append(own)
            lit.append(np.ones(len(own), dtype=bool))
        self._xyz, self._lit = np.concatenate(points), np.concatenate(lit)

    @property
    def ticks(self) -> int:
        """Ticks of the whole run."""
        return len(self._xyz)

    def lit(self, tick: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether there is a reflector in view at these ticks since the machine started, (n,)."""
        return np.asarray(self._lit[np.clip(tick, 0, self.ticks - 1)])

    def at(self, tick: NDArray[np.int64]) -> NDArray[np.float64]:
        """Measured points at these ticks since the machine started, shape (n, 3), m."""
        standing = min(STANDING, self.ticks)
        start = self.ticks - standing
        index = np.where(tick < self.ticks, tick, start + (tick - start) % standing)
        return np.asarray(self._xyz[np.maximum(index, 0)])
