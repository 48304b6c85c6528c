# SPDX-License-Identifier: Apache-2.0
"""The shortest further path that answers what a diagnosis left open.

For every cause with effects that it was not told from: the trace of the cause, with the parameters
that were found, in the pieces of a candidate path, less what a rival could make of it. Half the
square of what is left, in units of the noise, is the logarithm of the odds that a further
diagnosis would find for the cause; the odds say how sure the answer will be. For every effect that
was not visible: whether the path shows it, and from which size on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.diagnosis.engine.catalogue import best_sight, shapes_of, sight_of
from otf_core.diagnosis.engine.effect_products import tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import read_effects
from otf_core.effects.free_form import free_forms
from otf_core.errors import ConfigError
from otf_core.files.json_file import read_json
from otf_core.model.machine import Machine
from otf_core.model.plan import Plan
from otf_core.planning.creator import plan_path
from otf_core.planning.drive_time import drive_times
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.measured_runs import MeasuredRun, joint_rows
from otf_core.planning.planned_budget import planned_solution
from otf_core.planning.tracker_places import check_place

PASSES, LEVELS, RATIOS = (1, 2, 3), (2, 3), (0.67, 0.4)
"""Laps, planes of diagonals and ratios of feeds of the paths that are compared."""
SURE = 9.0
"""Logarithm of the odds from which an effect is named (``diagnosis.engine.search``)."""
ENOUGH = 0.95
"""Share of the most that any path answers, from which a shorter one is taken."""
MOST = 12
"""Paths that are compared, the shortest first."""


@dataclass(frozen=True)
class Question:
    """What a diagnosis left open.

    Attributes
    ----------
    effect : str
        A cause, or an effect that was not visible.
    rival : str
        Effect that the cause was not told from; empty for an effect that was not visible.
    cause : AppliedEffect, optional
        The cause with its parameters.
    """

    effect: str
    rival: str = ''
    cause: AppliedEffect | None = None


@dataclass(frozen=True)
class Answer:
    """What a path would say to a question.

    Attributes
    ----------
    question : Question
    log_odds : float
        Logarithm of the odds for the cause against its rival; of an effect that was not visible,
        ``SURE`` times the size of 5 um over the least size found, at most ``SURE`` twice.
    words : str
    """

    question: Question
    log_odds: float
    words: str

    @property
    def sure(self) -> bool:
        """True if the path answers the question."""
        return self.log_odds >= SURE

    def to_dict(self) -> dict[str, Any]:
        """Entry of plan.json."""
        probability = 1.0 / (1.0 + float(np.exp(-min(self.log_odds, 700.0))))
        return {
            'effect': self.question.effect,
            'not_told_from': self.question.rival,
            'log_odds': self.log_odds,
            'probability': probability if self.question.rival else None,
            'answered': self.sure,
            'words': self.words,
        }


def open_questions(folder: str | Path, machine: Machine) -> list[Question]:
    """Questions that a diagnosis left open.

    Parameters
    ----------
    folder : str or Path
        That ``otf diagnose`` wrote.
    machine : Machine

    Raises
    ------
    ConfigError
        If the folder holds no diagnosis, or nothing is open.
    """
    folder = Path(folder)
    gap: Mapping[str, Any] = read_json(folder / 'gap.json')
    if not isinstance(gap, Mapping) or 'causes' not in gap:
        raise ConfigError(f'{folder}/gap.json: no diagnosis; name a folder of otf diagnose')
    rivals = {c['effect']: c['indistinguishable_from'] for c in gap['causes']}
    found = []
    if any(rivals.values()):
        applied = {a.effect.name: a for a in read_effects(folder / 'effects.yaml', machine)}
        found = [
            Question(effect, rival, applied[effect])
            for effect, others in rivals.items()
            for rival in others
            if effect in applied and rival in REGISTRY
        ]
    hidden = [e['effect'] for e in gap.get('not_visible', ()) if e['effect'] in REGISTRY]
    found += [Question(name) for name in hidden]
    if not found:
        raise ConfigError(f'{folder}: this diagnosis left nothing open; plan without --after')
    return found


def measured_runs(folder: str | Path) -> list[MeasuredRun]:
    """Runs that a diagnosis is of; none where it is older than this."""
    gap: Mapping[str, Any] = read_json(Path(folder) / 'gap.json')
    return [MeasuredRun.of(entry, f'{folder}/gap.json') for entry in gap.get('measured', ())]


def answered(rows: Rows, question: Question) -> Answer:
    """What the pieces of a path, and of runs beside it, would say to a question."""
    if question.cause is None:
        return _seen(rows, question)
    moved = [
        question.cause.effect.displacement(state, question.cause.parameters)
        for state in rows.states
    ]
    parts = zip(rows.done.runs, moved, strict=True)
    plain = np.concatenate([
        np.einsum('cpk,pk->cp', run.system.axes, own).reshape(-1, 1) for run, own in parts
    ])  # fmt: skip
    trace = rows.project(rows.whiten(plain))[:, 0]
    left = min((_left(own, trace) for own in _rival_columns(rows, question)), default=0.0)
    log_odds = 0.5 * left
    words = (
        f'tells {question.effect} from {question.rival}: '
        f'{"yes" if log_odds >= SURE else "not surely"} (odds of exp({log_odds:.1f}))'
    )
    return Answer(question, log_odds, words)


def _rival_columns(rows: Rows, question: Question) -> Iterator[Array]:
    """What every form of the rival adds beyond tables and poses."""
    effect = REGISTRY[question.rival]
    chosen, stand_in = shapes_of(rows, effect, {})
    found = tried_shapes(rows, effect, chosen or stand_in)
    for form in free_forms(effect, rows.states):
        found += tried_shapes(rows, form, ({},) if not form.form.shaped else chosen or stand_in)
    for tried in found:
        if tried.takes:
            yield tried.source.option(tried.takes[0]).own


def _left(columns: Array, trace: Array) -> float:
    """Square of what is left of a trace by columns, (r, k)."""
    normal = columns.T @ columns
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(scale[:, None] * normal * scale)
    pull = vectors.T @ (scale * (columns.T @ trace))
    kept = values > 1e-9 * values[-1]
    return float(trace @ trace - np.sum(pull[kept] ** 2 / values[kept]))


def _seen(rows: Rows, question: Question) -> Answer:
    effect = REGISTRY[question.effect]
    chosen, stand_in = shapes_of(rows, effect, {})
    sight = best_sight([sight_of(t) for t in tried_shapes(rows, effect, chosen or stand_in)])
    if not sight.visible:
        words = f'{question.effect} stays invisible; it needs {effect.needs}'
        return Answer(question, 0.0, words)
    words = f'shows {question.effect} from {1e6 * sight.smallest:.2f} um on'
    return Answer(question, min(2.0, 5e-6 / sight.smallest) * SURE, words)


def _candidates(setup: Setup, config: PlannerConfig, budget: float | None) -> list[Plan]:
    """Paths within the time, the shortest first."""
    plans = []
    for passes, levels, ratio in product(PASSES, LEVELS, RATIOS):
        if passes == 1 and ratio != RATIOS[0]:
            continue
        plans.append(
            plan_path(
                setup.machine, replace(config, passes=passes, levels=levels, feed_ratio=ratio)
            )
        )
    timed = [(drive_times(p, setup.config.acceleration).duration, k) for k, p in enumerate(plans)]
    shortest = min(timed)[0]
    kept = [plans[k] for time, k in sorted(timed) if budget is None or time <= budget]
    if not kept:
        raise ConfigError(
            f'time_budget: no path takes {budget:g} s or less; the shortest takes '
            f'{math.ceil(shortest)} s'
        )
    return kept[:MOST]


def _places(plan: Plan, setup: Setup, before: Sequence[MeasuredRun]) -> list[Setup]:
    """Where the tracker may stand: where it stood, or on the other side of the volume."""
    if not before:
        return [setup]
    here = setup.at(before[-1].place)
    across = setup.machine.lower + setup.machine.upper - here.place
    other = setup.at(np.array([across[0], across[1], here.place[2]]))
    found = []
    for one in (here, other):
        try:
            check_place(plan, one)
        except ConfigError:
            continue
        found.append(one)
    return found or [setup]


def plan_after(
    questions: Sequence[Question],
    setup: Setup,
    config: PlannerConfig,
    budget: float | None,
    before: Sequence[MeasuredRun] = (),
) -> tuple[Plan, list[Answer], Setup]:
    """Choose the shortest path that answers all that any of them answers.

    Parameters
    ----------
    questions : sequence of Question
    setup : Setup
    config : PlannerConfig
        Feed, dwells and margin are taken as they are.
    budget : float, optional
        s; longest drive.
    before : sequence of MeasuredRun
        Runs that will be diagnosed together with the new one; the tracker may stay, or go to the
        other side.

    Returns
    -------
    plan : Plan
    answers : list of Answer
    setup : Setup
        With the place of the tracker that is proposed.

    Raises
    ------
    ConfigError
        If no path fits into the time.
    """
    limit = setup.calibration.unidentifiable_above
    known = [run.observed(setup) for run in before]
    found: list[tuple[float, Plan, list[Answer], Setup]] = []
    for plan in _candidates(setup, config, budget):
        for there in _places(plan, setup, before):
            planned = planned_solution(plan, there, forecast(plan, there))
            rows = joint_rows(planned, known, limit)
            answers = [answered(rows, q) for q in questions]
            worth = sum(min(a.log_odds, SURE) for a in answers)
            found.append((worth, plan, answers, there))
        if all(a.sure for a in answers):
            break
    most = max(worth for worth, *_ in found)
    _, plan, answers, there = next(one for one in found if one[0] >= ENOUGH * most)
    return plan, answers, there
