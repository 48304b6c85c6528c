# SPDX-License-Identifier: Apache-2.0
"""Public functions that come before a measurement, or stand for one: plan, simulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.effects import AppliedEffect
from otf_core.effects.effects_yaml import effects_from_data, read_effects
from otf_core.errors import ConfigError
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Machine
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan, check_inside, plan_for_path
from otf_core.model.tables import ErrorTables, load_tables
from otf_core.noise.fields import read_noise as noise_from_file
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path
from otf_core.planning.plan_report import PlanReport, PlanRequest, make_plan
from otf_core.sim import cell

Effects = Mapping[str, Mapping[str, float]] | str | Path


@dataclass(frozen=True)
class Simulation:
    """A simulated run and the truth behind it.

    Attributes
    ----------
    recording : Recording
        As `read_bag` returns a real one.
    truth : ErrorTables
        The errors of the simulated machine.
    T_machine_tracker : RigidTransform
        The true pose of the tracker: takes tracker to machine coordinates.
    """

    recording: Recording
    truth: ErrorTables
    T_machine_tracker: RigidTransform


def plan(
    machine: Machine,
    path: Plan | NominalPath | ArrayLike | None = None,
    *,
    time_budget: float | None = None,
    wanted_uncertainty: float | None = None,
    tracker_place: ArrayLike | None = None,
    noise: str | Path | None = None,
    config: PlannerConfig | None = None,
    forecast: ForecastConfig | None = None,
) -> PlanReport:
    """Path for a machine, and what it will show before anything moves.

    Parameters
    ----------
    machine : Machine
    path : Plan, NominalPath or array_like, shape (n, 3), m, optional
        Judge this path instead of making one.
    time_budget : float, optional
        s; choose lines, passes and feeds so that the grid is known best after this time.
    wanted_uncertainty : float, optional
        m; the same for this mean grid uncertainty in a short time.
    tracker_place : array_like, shape (3,), m, optional
        Beam origin in the machine frame; in front of the volume if not given.
    noise : str or Path, optional
        noise.json of ``otf noise``; as specified in machine.yaml if not given.
    config : PlannerConfig, optional
    forecast : ForecastConfig, optional

    Returns
    -------
    PlanReport
        ``plan`` is the plan, ``forecast`` what it will show.

    Raises
    ------
    ConfigError
        If the wishes contradict each other or cannot be met.
    InputError
        If the path leaves the axis ranges.

    Examples
    --------
    >>> few = otf_core.PlannerConfig(passes=1, levels=2)
    >>> report = otf_core.plan(machine, config=few)
    >>> len(report.plan.path.points), round(report.plan.duration)
    (72, 102)
    >>> 0 < report.forecast.mean_grid_u < 2e-6
    True
    """
    config = config or PlannerConfig()
    place = None if tracker_place is None else np.asarray(tracker_place, dtype=float)
    if place is not None and (place.shape != (3,) or not np.all(np.isfinite(place))):
        raise ConfigError(f'tracker_place: expected x, y, z in m, got {tracker_place!r}')
    request = PlanRequest(
        given=None if path is None else _plan_along(path, machine, config),
        time_budget=time_budget,
        wanted_uncertainty=wanted_uncertainty,
        tracker_place=None if place is None else (*place.tolist(),),
        noise=None if noise is None else noise_from_file(noise),
    )
    return make_plan(machine, request, config, forecast or ForecastConfig())


def simulate(
    machine: Machine,
    plan: Plan | PlanReport | None = None,
    *,
    seed: int | None = None,
    tables: ErrorTables | str | Path | None = None,
    effects: Effects | None = None,
    tracker_place: ArrayLike | None = None,
    config: SimulationConfig | None = None,
) -> Simulation:
    """Simulate a run: exact kinematics, a drive, a tracker with noise and a clock of its own.

    Parameters
    ----------
    machine : Machine
    plan : Plan or PlanReport, optional
        What is driven; of a report also the place of the tracker. The default path if not given.
    seed : int, optional
        Seed of all random draws; that of ``config`` if not given.
    tables : ErrorTables, str or Path, optional
        Errors of the machine, or an error_tables.json; drawn if not given.
    effects : mapping, str or Path, optional
        What else is wrong: names of effects to their parameters in SI units, or an effects.yaml.
    tracker_place : array_like, shape (3,), m, optional
        Beam origin in the machine frame; drawn if no report says where.
    config : SimulationConfig, optional

    Returns
    -------
    Simulation

    Raises
    ------
    ConfigError
        If an effect or a file is wrong, the tables are of another chain, or the run is too long
        to be simulated.
    InputError
        If the plan leaves the axis ranges.

    Examples
    --------
    >>> slow = otf_core.SimulationConfig(rate=100.0)
    >>> lost = {'backlash': {'B_X': 5e-6}}  # 5 um
    >>> run = otf_core.simulate(machine, report, seed=3, effects=lost, config=slow)
    >>> len(run.recording.samples) > 10_000
    True
    >>> bool(abs(run.T_machine_tracker.translation - report.setup.place).max() < 1e-12)
    True
    """
    config = config or SimulationConfig()
    if seed is not None:
        config = replace(config, seed=seed)
    place = None if tracker_place is None else np.asarray(tracker_place, dtype=float)
    if isinstance(plan, PlanReport):
        place = plan.setup.place if place is None else place
        plan = plan.plan
    driven = plan_path(machine, PlannerConfig()) if plan is None else plan
    check_inside(driven.path, machine)
    truth = tables if isinstance(tables, ErrorTables) or tables is None else None
    if isinstance(tables, (str, Path)):
        truth = load_tables(tables).tables
    if truth is not None:
        truth = truth.on(machine)
    run = cell.simulate(machine, driven, config, truth, _effects(effects, machine), place)
    name = f'simulation of seed {config.seed}'
    return Simulation(
        Recording(run.samples, driven.path, machine, name),
        run.truth,
        RigidTransform(run.rotation.T, run.place),
    )


def _plan_along(
    path: Plan | NominalPath | ArrayLike, machine: Machine, config: PlannerConfig
) -> Plan:
    if not isinstance(path, Plan):
        nominal = path if isinstance(path, NominalPath) else NominalPath(np.asarray(path, float))
        path = plan_for_path(nominal, config)
    check_inside(path.path, machine)
    return path


def _effects(effects: Effects | None, machine: Machine) -> Sequence[AppliedEffect]:
    if effects is None:
        return ()
    if isinstance(effects, (str, Path)):
        return read_effects(effects, machine)
    data = [{'effect': name, 'parameters': dict(values)} for name, values in effects.items()]
    return effects_from_data(data, 'effects', machine)
