# SPDX-License-Identifier: Apache-2.0
"""The recorded run of a machine with rotary axes, its truth; read once."""

from functools import cache
from pathlib import Path

from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.inputs.recordings import read_recording
from otf_core.model.axis_path import nominal_track
from otf_core.model.machine import load_machine
from otf_core.model.plan import plan_along
from otf_core.pieces.runs import Recording
from otf_core.planning.forecast import Setup
from otf_core.planning.part_choice import planned
from otf_core.prediction.calibration_document import load_tables
from otf_core.sim.cell import simulate

BAG = Path(__file__).parents[3] / 'bags' / 'trunnion'


@cache
def machine():
    return load_machine(BAG / 'machine.yaml')


@cache
def recorded():
    return read_recording([BAG / 'bag'], machine())


def truth():
    return load_tables(BAG / 'truth.json').tables


@cache
def parts():
    """A short path that shows its errors."""
    plan = planned(Setup.of(machine()), PlannerConfig(passes=1, levels=2))
    return [part.path for part in plan.parts]


def plan_of(paths, of=None, feed=0.1, dwell=0.1):
    """Drive paths at one feed, stopping where they are not smooth."""
    return plan_along(of or machine(), paths, PlannerConfig(feed=feed, corner_dwell=dwell))


def simulated(paths, seed=12, of=None, **options):
    """A simulated recording of the small trunnion, or one like it, and its truth."""
    m, config = of or machine(), SimulationConfig(seed=seed, rate=40.0)
    run = simulate(m, plan_of(paths, m), config, **options)
    path = nominal_track(m, run.parts)
    return Recording(run.samples, path, m, 'simulated'), run
