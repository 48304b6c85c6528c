# SPDX-License-Identifier: Apache-2.0
"""What the comparisons need of a cell: true errors, recorded runs, a direct instrument.

The simulation stands behind it; nothing in this package draws random numbers or sees the truth
before it is judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from otf_core.model.direct_measurement import DirectMeasurement
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec
from otf_core.model.observation import Samples
from otf_core.model.plan import Plan
from otf_core.model.tables import ErrorTables


class Laboratory(Protocol):
    """A cell whose true errors are known."""

    def true_errors(self, machine: Machine, size: float, seed: int) -> ErrorTables:
        """Error tables with a mean volumetric error of ``size``, m."""

    def record(
        self, machine: Machine, plan: Plan, truth: ErrorTables, seed: int, noise: bool = True
    ) -> Samples:
        """Tracker samples of a run, 500 per second."""

    def measure_directly(self, truth: ErrorTables, seed: int) -> DirectMeasurement:
        """Six errors along every axis, five runs forward and backward."""


@dataclass(frozen=True)
class Scale:
    """How much is simulated.

    Attributes
    ----------
    seeds : tuple of int
        One cell each.
    feeds : tuple of float, m/s
        Of the runs on the fly.
    stop_time : float
        s, standstill at every point of the standstill method.
    """

    seeds: tuple[int, ...]
    feeds: tuple[float, ...]
    stop_time: float


MM_PER_MIN = 1.0 / 60e3
FULL_FEEDS = tuple(MM_PER_MIN * f for f in (2500.0, 5000.0, 10000.0, 15000.0))
"""Paper, Table 2."""


def scale(quick: bool, seed: int, cells: int | None = None) -> Scale:
    """Full: eight cells; quick: two cells and shorter stops; or as many cells as asked for."""
    count = cells or (2 if quick else 8)
    return Scale(tuple(range(seed, seed + count)), FULL_FEEDS, 1.0 if quick else 3.0)


def paper_machine() -> Machine:
    """Cell like the paper's: three axes, the longest 600 mm; places of Table 1 scale with it."""
    axes = {
        'X': Axis(0.0, 0.6, 0.03),
        'Y': Axis(0.0, 0.5, 0.03),
        'Z': Axis(-0.4, 0.0, 0.03),
    }
    chain, offset = Chain.parse('w-b-X-Y-Z-t'), np.array([0.0, 0.0, -0.15])
    return Machine('validation', chain, axes, offset, TrackerSpec(0.5e-6, 2.0e-6))
