# SPDX-License-Identifier: Apache-2.0
"""From options to a judged plan: which path, forecast, what it cannot show, where the tracker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from otf_core.aside import Aside
from otf_core.config import ForecastConfig, PlannerConfig
from otf_core.diagnosis.engine.residual_rows import rows_of
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress, silent
from otf_core.model.machine import Machine
from otf_core.model.plan import Plan
from otf_core.model.provenance import provenance
from otf_core.noise.noise_model import NoiseModel
from otf_core.planning.chains import HAND_MOVE
from otf_core.planning.clearance import near_misses
from otf_core.planning.findings import UnseenError, findings, forecast_effects
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
    PlannedSystematic,
    Setup,
    forecast,
    planned_systematic,
)
from otf_core.planning.line_of_sight import (
    HAND_TURN,
    SightShare,
    check_side,
    facings_needed,
    sights,
)
from otf_core.planning.nc.programs import on_increments
from otf_core.planning.part_choice import planned, work_by_hand
from otf_core.planning.path_optimiser import options_of, plan_for_time, plan_for_uncertainty
from otf_core.threads import one_thread

if TYPE_CHECKING:
    from otf_core.planning.document import PlanDocument


@dataclass(frozen=True)
class PlanReport:
    """A plan with all that is known of it before anything moves.

    Attributes
    ----------
    how : str
        How the path came about, one line.
    places : tuple of TrackerPlace
        Ranked places of the tracker.
    effects : sequence of mapping
        How well the plan would show effects beyond the rigid body, see ``forecast_effects``.
    systematic : PlannedSystematic
        The grid with systematic contributions; everything else is noise only.
    after : tuple of Answer
        What the plan would say to the questions that a diagnosis left open.
    sight : mapping of target to SightShare
        Of targets that rotary axes turn before the tracker.
    near : sequence of str
        What comes near to what.
    provenance : mapping
        From what it was made.
    """

    plan: Plan
    how: str
    setup: Setup
    forecast: Forecast
    findings: tuple[UnseenError, ...]
    places: tuple[TrackerPlace, ...]
    advice: tuple[str, ...]
    effects: Sequence[Mapping[str, Any]]
    systematic: PlannedSystematic
    after: tuple[Answer, ...]
    sight: Mapping[str, SightShare]
    near: Sequence[str]
    provenance: Mapping[str, Any]

    @cached_property
    def document(self) -> PlanDocument:
        """What plan.json states."""
        from otf_core.planning.document import document_of

        return document_of(self)

    @property
    def turns(self) -> int:
        """How often a reflector is turned by hand to its next facing."""
        machine = self.setup.machine
        turning = [machine.column(a) for a in machine.rotary_names]
        driven = {
            part.target
            for part in self.plan.parts
            if np.ptp(part.path.positions[:, turning], axis=0).any()
        }
        return work_by_hand(machine, self.plan.parts)[1] + sum(
            facings_needed(s) - 1
            for name, s in self.sight.items()
            if name in driven and not machine.targets[name].nest
        )

    @property
    def moves(self) -> int:
        """How often a reflector is taken to another place by hand."""
        return work_by_hand(self.setup.machine, self.plan.parts)[0]

    @property
    def by_hand(self) -> float:
        """Time for moves and turns of the reflector by hand, s."""
        return HAND_MOVE * self.moves + HAND_TURN * self.turns


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
    files : mapping of str to path
        What was read, for the provenance.
    """

    given: Plan | None = None
    time_budget: float | None = None
    wanted_uncertainty: float | None = None
    tracker_place: tuple[float, float, float] | None = None
    noise: NoiseModel | None = None
    questions: tuple[OpenQuestion, ...] = ()
    before: tuple[MeasuredRun, ...] = ()
    files: Mapping[str, str | Path | None] = field(default_factory=dict)

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


def _choose(
    request: PlanRequest, setup: Setup, config: PlannerConfig
) -> tuple[Plan, str, list[Answer], Setup]:
    """Plan as requested, how it came about, answers to questions, and where the tracker stands."""
    if request.questions:
        return _after(request, setup, config)
    if request.given is not None:
        return request.given, 'the path given', [], setup
    budget, wanted = request.time_budget, request.wanted_uncertainty
    if budget is None and wanted is None:
        plan, count = planned(setup, config), config.passes
        passes = 'one pass' if count == 1 else f'{count} passes'
        parts = f', {len(plan.parts)} parts' if len(plan.parts) > 1 else ''
        return plan, f'path creator, {passes}{parts}', [], setup
    options = options_of(setup, config)
    if budget is not None:
        best = plan_for_time(options.attempt, budget)
        aim = f'least uncertainty in {budget:g} s'
    else:
        assert wanted is not None
        best = plan_for_uncertainty(options.attempt, wanted, options.guess(wanted))
        aim = f'mean grid uncertainty of {1e6 * wanted:g} um in a short time'
    return best.plan, f'{aim}; {best.how}', [], setup


def _after(
    request: PlanRequest, setup: Setup, config: PlannerConfig
) -> tuple[Plan, str, list[Answer], Setup]:
    """Plan after a diagnosis, with what it would say to its questions."""
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
    plan: Plan, setup: Setup, forecast: Forecast
) -> tuple[list[TrackerPlace], float, PlannedSystematic]:
    """Places of the tracker compared, what is left at the one chosen, what is systematic."""
    judge = judge_places(plan, setup, forecast.accepted)
    return compare_places(plan, setup, judge), judge(setup.place), planned_systematic(forecast)


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
    check_side(machine, setup.place)
    progress('choosing lines', 0.0)
    with one_thread():
        plan, how, answers, setup = _choose(request, setup, config)
        plan = on_increments(machine, plan.parts)
        check_place(plan, setup)
        progress('forecasting', 0.0)
        outlook = forecast(plan, setup)
        judge = partial(_judge_places, plan, setup, outlook)
        with Aside(judge, (plan, setup, outlook), later=True) as aside:
            progress('looking for effects', 0.0)
            effects = forecast_effects(rows_of(outlook.runs, outlook.joint, setup.limit))
            places, own, systematic = aside.result()
    return PlanReport(
        plan, how, setup, outlook, findings(plan, outlook, setup.limit), tuple(places),
        tuple(advice(places, own)), effects, systematic, tuple(answers),
        sights(machine, setup.place), near_misses(machine, plan.parts, setup.place),
        provenance('plan', machines=[machine], files=request.files),
    )  # fmt: skip
