# SPDX-License-Identifier: Apache-2.0
"""Backend that simulates machine and tracker: it drives the published plan.

What simulates is imported when it is used: a driver of a real tracker starts in half the time.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from otf_core.config import SimulationConfig, parameter
from otf_core.errors import ConfigError
from otf_core.model.machine import Machine, load_machine
from otf_core.model.plan import Plan, check_inside
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import load_tables
from otf_tracker_driver.backends.base import CommonConfig
from otf_tracker_driver.backends.paced import PacedBackend

if TYPE_CHECKING:
    from otf_core.effects import AppliedEffect
    from otf_core.sim.cell import SimulatedRun


@dataclass(frozen=True)
class SimulatedConfig(SimulationConfig):
    """The simulated cell, and files with what is wrong in it."""

    truth_tables: str = parameter(
        '', 'errors of the simulated machine (error_tables.json); empty: drawn from the seed'
    )
    effects: str = parameter(
        '', 'additional effects in the simulated cell (effects.yaml); empty: none'
    )


class SimulatedTracker(PacedBackend):
    """Streams a simulated run of the plan, start and end standstill included.

    Between the parts of the plan the reflector is moved by hand: the beam is broken, and found
    again at the next target.
    """

    parameters = SimulatedConfig
    needs_plan = of_now = True
    own: SimulatedConfig

    def __init__(self, common: CommonConfig, own: SimulatedConfig) -> None:
        super().__init__(common, own)
        self._machine: Machine | None = None
        self._truth: ErrorTables | None = None
        self._effects: tuple[AppliedEffect, ...] = ()
        self._worker = ThreadPoolExecutor(1, 'simulation')
        self._run: Future[SimulatedRun] | None = None
        self._targets: tuple[str, ...] = ()
        self.rate = own.rate

    def connect(self) -> str:
        """Read the machine description, the tables of its true errors, and further effects."""
        from otf_core.effects.effects_yaml import read_effects

        if not self.common.machine_file:
            raise ConfigError('parameter machine_file: missing; the backend simulated needs it')
        self._machine = load_machine(self.common.machine_file)
        if self.own.truth_tables:
            tables = load_tables(self.own.truth_tables).tables
            self._truth = tables.on(self._machine)
        if self.own.effects:
            self._effects = read_effects(self.own.effects, self._machine)
        errors = self.own.truth_tables or f'seed {self.own.seed}'
        errors += ''.join(f' and {one.effect.name}' for one in self._effects)
        return f'simulated cell {self._machine.name}, errors from {errors}, {self.rate:.0f} Hz'

    def prepare(self, plan: Plan | None) -> None:
        """Simulate the whole run in a thread; takes about a second per 100 000 samples."""
        from otf_core.sim.cell import simulate

        assert self._machine is not None and plan is not None, 'connected, and given a plan'
        plan = plan.of(self._machine)
        check_inside(plan, self._machine)
        self._targets = tuple(part.target for part in plan.parts)
        arguments = self._machine, plan, self.own, self._truth, self._effects
        self._run = self._worker.submit(simulate, *arguments)

    @property
    def preparing(self) -> str:
        """Not empty while the simulation is under way."""
        if self._run is None:
            return ''
        if not self._run.done():
            return 'simulating the run'
        self.load(self._run.result().samples)
        self._run = None
        return ''

    def moved(self, number: int) -> str:
        """Name the target to which the reflector is moved in a break of the beam."""
        if number + 1 >= len(self._targets):
            return super().moved(number)
        return f"the reflector is moved by hand to the target '{self._targets[number + 1]}'"

    def disconnect(self) -> None:
        """Wait for a running simulation and forget the run."""
        self._worker.shutdown(cancel_futures=True)
        super().disconnect()
