# SPDX-License-Identifier: Apache-2.0
"""The simulated laboratory of ``./otf validate``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from otf_core.config import SimulationConfig
from otf_core.model.direct_measurement import DirectMeasurement
from otf_core.model.machine import Machine, TrackerSpec
from otf_core.model.observation import Samples
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables
from otf_core.sim.cell import random_tables, simulate
from otf_core.sim.direct_instrument import measure_directly

NOISELESS = TrackerSpec(1e-12, 1e-12)


class SimulatedLaboratory:
    """Simulated cell and direct instrument; see ``validation.paper.Laboratory``."""

    def __init__(self, config: SimulationConfig | None = None) -> None:
        self._config = config or SimulationConfig()

    def true_errors(self, machine: Machine, size: float, seed: int) -> ErrorTables:
        """Draw error tables with a mean volumetric error of ``size``, m."""
        return random_tables(machine, size, np.random.default_rng([seed, 0]))

    def record(
        self, machine: Machine, plan: Plan, truth: ErrorTables, seed: int, noise: bool = True
    ) -> Samples:
        """Simulate a run; ``noise`` False leaves the tracker noise out."""
        tracker = machine if noise else replace(machine, tracker=NOISELESS)
        return simulate(tracker, plan, replace(self._config, seed=seed), truth).samples

    def measure_directly(self, truth: ErrorTables, seed: int) -> DirectMeasurement:
        """Simulate the direct instrument."""
        return measure_directly(truth, seed)
