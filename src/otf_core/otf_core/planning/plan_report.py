# SPDX-License-Identifier: Apache-2.0
"""From options to a judged plan: which path, forecast, what it cannot show, where the tracker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from otf_core.aside import Aside
from otf_core.config import ForecastConfig, PlannerConfig
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.plan import Plan
from otf_core.noise.noise_model import NoiseModel
from otf_core.planning.findings import UnseenError, findings, forecast_effects, forecast_rows
from otf_core.planning.follow_up import (
    Answer,
    OpenQuestion,
    TrackerPlace,
    advice,
    check_place,
    compare_places,
    judge_places,
    plan_after,
)
from otf_core.planning.forecast import (
    Forecast,
    MeasuredRun,
    Planned,
    PlannedSystematic,
    Setup,
    forecast,
    planned_solution,
    planned_systematic,
)
from otf_core.planning.nc.programs import round_to_increment
from otf_core.planning.path_creation import plan_path
from otf_core.planning.path_optimiser import PathOptimiser
from otf_core.threads import one_thread

# A plan with all that is known of it before anything moves.


@dataclass(frozen=True)
class EffectForecast:
    """How well a plan would show one effect beyond the rigid body.

    Attributes
    ----------
    effect : str
        Name in gap.json.
    words : str
        One line.
    data : mapping
        Entry for plan.json.
    """

    effect: str
    words: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class PlanReport:
    """A plan with all that is known of it before anything moves.

    Attributes
    ----------
    how : str
        How the path came about, one line.
    places : tuple of TrackerPlace
        Ranked places of the tracker.
    systematic : PlannedSystematic, optional
        The grid with systematic contributions; everything else is noise only.
    after : tuple of Answer
        What the plan would say to the questions that a diagnosis left open.
    """

    plan: Plan
    how: str
    setup: Setup
    forecast: Forecast
    findings: tuple[UnseenError, ...]
    places: tuple[TrackerPlace, ...]
    advice: tuple[str, ...]
    effects: tuple[EffectForecast, ...] = field(default=())
    systematic: PlannedSystematic | None = None
    after: tuple[Answer, ...] = ()


@dataclass(frozen=True)
class PlanRequest:
    """What is wanted.

    Attributes
    ----------
    given : Plan, optional
        Judge this plan instead of making one.
    time_budget : float, optional
        s; make the grid best known in this time.
    wanted_uncertainty : float, optional
        m; make the mean grid uncertainty no larger, in the least time.
    tracker_place : tuple of 3 floats, optional
        m, machine frame.
    noise : NoiseModel, optional
        As specified in machine.yaml if not given.
    questions : tuple of OpenQuestion
        What a diagnosis left open; the shortest path that answers is chosen then, within
        ``time_budget``.
    before : tuple of MeasuredRun
        What that diagnosis was of.
    """

    given: Plan | None = None
    time_budget: float | None = None
    wanted_uncertainty: float | None = None
    tracker_place: tuple[float, float, float] | None = None
    noise: NoiseModel | None = None
    questions: tuple[OpenQuestion, ...] = ()
    before: tuple[MeasuredRun, ...] = ()

    def __post_init__(self) -> None:
        """Check that the wishes go together; ConfigError names those that do not."""
        wishes = [
            name
            for name, value in (
                ('path', self.given),
                ('time_budget', self.time_budget),
                ('wanted_uncertainty', self.wanted_uncertainty),
            )
            if value is not None
        ]
        if len(wishes) > 1:
            raise ConfigError(f'{" and ".join(wishes)}: give only one of them')
        for name in ('time_budget', 'wanted_uncertainty'):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ConfigError(f'{name}: {value:g} is not above 0')


def read_place(text: str) -> tuple[float, float, float]:
    """Read 'x,y,z' in m; ConfigError if it is none."""
    try:
        x, y, z = (float(part) for part in text.split(','))
    except ValueError:
        raise ConfigError(f"tracker_place: '{text}' is not x,y,z in m") from None
    if not np.all(np.isfinite([x, y, z])) or max(abs(x), abs(y), abs(z)) > 200:
        raise ConfigError(f"tracker_place: '{text}' is not near a machine; the unit is m")
    return x, y, z


def _choose(request: PlanRequest, setup: Setup, config: PlannerConfig) -> tuple[Plan, str]:
    """Plan as requested, and a line that says how it came about."""
    if request.given is not None:
        return request.given, 'the path given'
    if request.time_budget is None and request.wanted_uncertainty is None:
        passes = 'one pass' if config.passes == 1 else f'{config.passes} passes'
        return plan_path(setup.machine, config), f'path creator, {passes}'
    optimiser = PathOptimiser(setup, config)
    if request.time_budget is not None:
        best = optimiser.for_time(request.time_budget)
        aim = f'least mean grid uncertainty in {request.time_budget:g} s'
    else:
        assert request.wanted_uncertainty is not None
        best = optimiser.for_uncertainty(request.wanted_uncertainty)
        aim = f'mean grid uncertainty of {1e6 * request.wanted_uncertainty:g} um in a short time'
    passes = (
        'driven once' if best.passes == 1 else f'{best.passes} passes, every second one reversed'
    )
    return best.plan, f'{aim}; {passes}; {_worth(best.efficiency)}'


def _chosen(
    request: PlanRequest, setup: Setup, config: PlannerConfig
) -> tuple[Plan, str, list[Answer], Setup]:
    """Plan as requested, after a diagnosis with what it would say to its questions."""
    if not request.questions:
        return *_choose(request, setup, config), [], setup
    before = request.before
    plan, answers, there = plan_after(
        request.questions, setup, config, request.time_budget, before
    )
    sure = sum(a.sure for a in answers)
    how = f'after a diagnosis: the shortest path that answers {sure} of {len(answers)} questions'
    if before:
        stays = np.allclose(there.place, before[-1].place)
        place = ', '.join(f'{1e3 * v:.0f}' for v in there.place)
        where = 'stays' if stays else f'moves to ({place}) mm'
        how += f', evaluated together with the earlier runs; the tracker {where}'
    return plan, how, answers, there


def _judge_places(
    plan: Plan, setup: Setup, forecast: Forecast, planned: Planned
) -> tuple[list[TrackerPlace], float, PlannedSystematic]:
    """Places of the tracker compared, what is left at the one chosen, what is systematic."""
    judge = judge_places(plan, setup, forecast.solution.accepted)
    systematic = planned_systematic(planned, forecast)
    return compare_places(plan, setup, judge), judge(setup.place), systematic


def _worth(efficiency: float) -> str:
    return f'{100 * efficiency:.0f} % of the information of an ideal allocation of time to lines'


def make_plan(
    machine: Machine,
    request: PlanRequest,
    config: PlannerConfig,
    judged: ForecastConfig,
    progress: Progress = silent,
) -> PlanReport:
    """Make or take a plan and judge it.

    Parameters
    ----------
    progress : callable(stage, fraction)
        Stages are those of ``live.stages.PLAN``.
    """
    place = None if request.tracker_place is None else np.array(request.tracker_place)
    setup = Setup.of(machine, place, request.noise, judged)
    progress('choosing lines', 0.0)
    with one_thread():
        plan, how, answers, setup = _chosen(request, setup, config)
        plan = round_to_increment(plan, machine.lower, machine.upper)
        check_place(plan, setup)
        progress('forecasting', 0.0)
        outlook: Forecast = forecast(plan, setup)
        limit = setup.calibration.unidentifiable_above
        planned = planned_solution(plan, setup, outlook)
        judge = partial(_judge_places, plan, setup, outlook, planned)
        with Aside(judge, (plan, setup, outlook, planned), later=True) as aside:
            progress('looking for effects', 0.0)
            effects = forecast_effects(forecast_rows(planned, limit))
            places, own, systematic = aside.result()
    return PlanReport(
        plan,
        how,
        setup,
        outlook,
        findings(outlook, machine, limit),
        tuple(places),
        tuple(advice(places, own)),
        tuple(EffectForecast(e['effect'], e['words'], e) for e in effects),
        systematic,
        tuple(answers),
    )
