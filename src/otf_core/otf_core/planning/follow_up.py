# SPDX-License-Identifier: Apache-2.0
"""The shortest further path that answers what a diagnosis left open, and places of the tracker."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.config import PlannerConfig
from otf_core.diagnosis.engine.effect_products import tried_shapes
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import best_sight, shapes_of, sight_of
from otf_core.documents import Document, stated
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import read_effects
from otf_core.effects.free_form import free_forms
from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import read_json
from otf_core.model.axis_path import nominal_track
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.model.plan import Plan
from otf_core.planning.forecast import (
    Judge,
    MeasuredRun,
    Setup,
    forecast,
    joint_rows,
    planned_runs,
    tracker_pose,
)
from otf_core.planning.line_of_sight import (
    LEAST_OPEN,
    PLACE_DISTANCE,
    least_open,
    linear_ends,
)
from otf_core.planning.part_choice import planned
from otf_core.solving.normal import normal_equations
from otf_core.solving.solution import solve
from otf_core.solving.system import build_system
from otf_core.solving.whitener import Whitener

# Where to put the tracker: places around and above the volume, compared by forecast.
#
# Rows are perpendicular to the path wherever the tracker stands: a place changes how well errors
# are seen, not which. So the errors judged are those that are seen from the place assumed.

INTERVALS, SHARE, GRID = 10, 0.5, 5
"""Intervals of the splines, part of one that a piece may span, and points per axis of the grid,
that places are compared with."""


@dataclass(frozen=True)
class TrackerPlace(Document):
    """One place and what the plan would show from there."""

    place: Array = stated('origin of the beam in the machine frame', 'm', shape=(3,))
    words: str = stated('where that is')
    mean_grid_u: float = stated('of the volume, a forecast with few splines', 'm')
    shortest: float = stated('beam over the path', 'm')
    longest: float = stated('beam over the path', 'm')


def beam_lengths(plan: Plan, setup: Setup) -> tuple[float, float]:
    """Shortest and longest beam over the path, m."""
    track = nominal_track(setup.machine, [part.path for part in plan.parts]).points
    beams = np.linalg.norm(track - setup.place, axis=1)
    return float(beams.min()), float(beams.max())


def advice(places: list[TrackerPlace], own: float) -> list[str]:
    """State in words where the tracker stands best.

    Parameters
    ----------
    places : list of TrackerPlace
        Ranked.
    own : float
        m; mean grid uncertainty from the place that the plan is made for, judged likewise.
    """
    if not places:
        return ['no place around the volume keeps all beams within the range limits']
    best, worst = places[0], places[-1]
    x, y, z = (f'{1e3 * v:.0f}' for v in best.place)
    return [
        f'best of {len(places)} places: {best.words} ({x}, {y}, {z}) mm: '
        f'{best.mean_grid_u / own:.2f} times the mean grid uncertainty of the place assumed here',
        f'worst: {worst.words}: {worst.mean_grid_u / own:.2f} times',
        'nearer is better, within the range limits and with a free beam; whether the beam is '
        'free and the target faces the tracker is not checked',
    ]


def judge_places(plan: Plan, setup: Setup, accepted: tuple[str, ...]) -> Callable[[Array], float]:
    """Set up the comparison of places for one plan.

    Parameters
    ----------
    accepted : tuple of str
        Blocks of unknowns that the plan shows, see ``Forecast.accepted``.

    Returns
    -------
    callable(place) -> float
        Mean grid uncertainty, m, with the tracker at a place (3,), m.
    """
    judge = Judge(setup, plan.parts, INTERVALS)
    rows = judge.field(min(setup.config.grid, GRID))
    kept = judge.unknowns.kept
    runs = planned_runs(plan.parts, setup, judge.nodes, INTERVALS, SHARE)

    def mean_grid_u(place: Array) -> float:
        normal = judge.known
        for run in runs:
            pieces = replace(run.pieces, xyz=run.pieces.xyz + (setup.place - place))
            seen = replace(run, pieces=pieces, pose=tracker_pose(setup.at(place)))
            system = build_system(seen, judge.unknowns)
            whitener = Whitener.of(system, pieces, setup.noise)
            normal = normal + normal_equations(system, judge.unknowns, whitener)
        solution = solve(normal, judge.unknowns, setup.limit, accepted, judge.prior)
        cover = solution.covariance[np.ix_(kept, kept)]
        variance = np.einsum('ij,ij->i', rows @ cover, rows).reshape(-1, 3).sum(axis=1)
        return float(np.sqrt(np.maximum(variance, 0.0)).mean())

    return mean_grid_u


def check_place(plan: Plan, setup: Setup) -> None:
    """Refuse a place whose beams leave the range limits; ConfigError says by how much."""
    near, far = beam_lengths(plan, setup)
    low, high = setup.config.min_range, setup.config.max_range
    if near < low or far > high:
        raise ConfigError(
            f'tracker_place: beams from {setup.place.tolist()} m to the path are {near:.3f} m to '
            f'{far:.3f} m long; the tracker measures {low:g} m to {high:g} m'
        )


def _words(side: tuple[int, ...], distance: float) -> str:
    signs = ''.join(
        f'{"+" if s > 0 else "-"}{a}' for a, s in zip(XYZ[:2], side[:2], strict=True) if s
    )
    if not signs:
        return f'above the middle, {distance:.2f} m away'
    height = 'at half height' if side[2] == 0 else 'and above'
    where = 'beyond the edge' if len(signs) > 2 else 'on the side'
    return f'{where} {signs} {height}, {distance:.2f} m away'


def candidate_places(machine: Machine, near: float) -> list[tuple[Array, str]]:
    """Places on every side, beyond every edge and above; with words.

    Parameters
    ----------
    near : float
        m, from the working volume; on the sides also twice as far.
    """
    low, high = linear_ends(machine)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    places = []
    for distance, x, y, z in product((near, 2 * near), (-1, 0, 1), (-1, 0, 1), (0, 1)):
        side = np.array([x, y, z])
        if side.any() and (distance == near or np.abs(side).sum() == 1):
            away = distance * side / np.linalg.norm(side)
            places.append((centre + side * half + away, _words((x, y, z), distance)))
    return places


def compare_places(
    plan: Plan, setup: Setup, judge: Callable[[Array], float]
) -> list[TrackerPlace]:
    """Rank places of the tracker for one plan.

    Parameters
    ----------
    setup : Setup
        Its own place is left out.
    judge : callable
        See ``judge_places``.

    Returns
    -------
    list of TrackerPlace
        Best first; places whose beams leave the range limits are not listed. That the beam is
        free and the target looks at the tracker is not checked.
    """
    limits, ranking = setup.config, []
    for place, words in candidate_places(setup.machine, max(PLACE_DISTANCE, limits.min_range)):
        shortest, longest = beam_lengths(plan, setup.at(place))
        free = least_open(setup.machine, place) >= LEAST_OPEN
        if free and shortest >= limits.min_range and longest <= limits.max_range:
            ranking.append(TrackerPlace(place, words, judge(place), shortest, longest))
    return sorted(ranking, key=lambda p: p.mean_grid_u)


# The shortest further path that answers what a diagnosis left open.
#
# For every cause with effects that are indistinguishable from it: the trace of the cause, with the
# parameters that were found, in the pieces of a candidate path, less what a rival could make of
# it. Half the square of what is left, in units of the noise, is the logarithm of the odds that a
# further diagnosis would find for the cause; the odds say how sure the answer will be. For every
# effect that was not visible: whether the path shows it, and from which size on.

PASSES, LEVELS, RATIOS = (1, 2, 3), (2, 3), (0.67, 0.4)
"""Laps, planes of diagonals and ratios of feeds of the paths that are compared."""
NAMED_LOG_ODDS = 9.0
"""Logarithm of the odds from which an effect is named (``diagnosis.engine.search``)."""
ANSWERED_SHARE = 0.95
"""Share of the most that any path answers, from which a shorter one is taken."""
COMPARED_PATHS = 12
"""Paths that are compared, the shortest first."""


@dataclass(frozen=True)
class OpenQuestion:
    """What a diagnosis left open.

    Attributes
    ----------
    effect : str
        A cause, or an effect that was not visible.
    rival : str
        Effect that the cause was indistinguishable from; empty for an effect that was not visible.
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
    log_odds : float
        Logarithm of the odds for the cause against its rival; of an effect that was not visible,
        ``NAMED_LOG_ODDS`` times 5 um over the smallest size found, at most twice that.
    """

    question: OpenQuestion
    log_odds: float
    words: str

    @property
    def sure(self) -> bool:
        """True if the path answers the question."""
        return self.log_odds >= NAMED_LOG_ODDS

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


def open_questions(folder: str | Path, machine: Machine) -> list[OpenQuestion]:
    """Questions that a diagnosis left open.

    Parameters
    ----------
    folder : str or Path
        That ``otf diagnose`` wrote.

    Raises
    ------
    ConfigError
        If the folder holds no diagnosis, or nothing is open.
    """
    folder = Path(folder)
    gap: Mapping[str, Any] = read_json(folder / 'gap.json')
    if not isinstance(gap, Mapping) or 'causes' not in gap:
        raise ConfigError(
            f'{folder}/gap.json: not a diagnosis; give a folder written by otf diagnose'
        )
    rivals = {c['effect']: c['indistinguishable_from'] for c in gap['causes']}
    questions = []
    if any(rivals.values()):
        applied = {a.effect.name: a for a in read_effects(folder / 'effects.yaml', machine)}
        questions = [
            OpenQuestion(effect, rival, applied[effect])
            for effect, others in rivals.items()
            for rival in others
            if effect in applied and rival in REGISTRY
        ]
    hidden = [e['effect'] for e in gap.get('not_visible', ()) if e['effect'] in REGISTRY]
    questions += [OpenQuestion(name) for name in hidden]
    if not questions:
        raise ConfigError(f'{folder}: this diagnosis left nothing open; plan without --after')
    return questions


def measured_runs(folder: str | Path) -> list[MeasuredRun]:
    """Runs that a diagnosis is of; none where it is older than this."""
    gap: Mapping[str, Any] = read_json(Path(folder) / 'gap.json')
    return [MeasuredRun.of(entry, f'{folder}/gap.json') for entry in gap.get('measured', ())]


def answer_of_pieces(rows: Rows, question: OpenQuestion) -> Answer:
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
    remainder = min(
        (_squares_left(own, trace) for own in _rival_columns(rows, question)), default=0.0
    )
    log_odds = 0.5 * remainder
    words = (
        f'distinguishes {question.effect} from {question.rival}: '
        f'{"yes" if log_odds >= NAMED_LOG_ODDS else "not surely"} (odds of exp({log_odds:.1f}))'
    )
    return Answer(question, log_odds, words)


def _rival_columns(rows: Rows, question: OpenQuestion) -> Iterator[Array]:
    """What every form of the rival adds beyond tables and poses."""
    effect = REGISTRY[question.rival]
    chosen, stand_in = shapes_of(rows, effect, {})
    shapes = tried_shapes(rows, effect, chosen or stand_in)
    for form in free_forms(effect, rows.states):
        shapes += tried_shapes(rows, form, ({},) if not form.form.shaped else chosen or stand_in)
    for tried in shapes:
        if tried.takes:
            yield tried.source.option(tried.takes[0]).own


def _squares_left(columns: Array, trace: Array) -> float:
    """Square of what is left of a trace by columns, (r, k)."""
    normal = columns.T @ columns
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(scale[:, None] * normal * scale)
    pull = vectors.T @ (scale * (columns.T @ trace))
    positive = values > 1e-9 * values[-1]
    return float(trace @ trace - np.sum(pull[positive] ** 2 / values[positive]))


def _seen(rows: Rows, question: OpenQuestion) -> Answer:
    effect = REGISTRY[question.effect]
    chosen, stand_in = shapes_of(rows, effect, {})
    sight = best_sight([sight_of(t) for t in tried_shapes(rows, effect, chosen or stand_in)])
    if not sight.visible:
        words = f'{question.effect} remains invisible; it needs {effect.words.shown_by}'
        return Answer(question, 0.0, words)
    words = f'shows {question.effect} from {1e6 * sight.smallest:.2f} um on'
    return Answer(question, min(2.0, 5e-6 / sight.smallest) * NAMED_LOG_ODDS, words)


def _candidates(setup: Setup, config: PlannerConfig, budget: float | None) -> list[Plan]:
    """Paths within the time, the shortest first."""
    turns = bool(setup.machine.rotary_names)
    plans = [
        planned(setup, replace(config, passes=passes, levels=levels, feed_ratio=ratio))
        for passes, levels, ratio in product(PASSES[:2] if turns else PASSES, LEVELS, RATIOS)
        if ratio == RATIOS[0] or (passes > 1 and not turns)
    ]
    timed = [(sum(map(setup.seconds, p.parts)), k) for k, p in enumerate(plans)]
    affordable = [plans[k] for time, k in sorted(timed) if budget is None or time <= budget]
    if not affordable:
        raise ConfigError(
            f'time_budget: no path takes {budget:g} s or less; the shortest takes '
            f'{math.ceil(min(timed)[0])} s'
        )
    return affordable[:COMPARED_PATHS]


def _places(plan: Plan, setup: Setup, before: Sequence[MeasuredRun]) -> list[Setup]:
    """Where the tracker may stand: where it stood, or on the other side of the volume."""
    if not before:
        return [setup]
    here = setup.at(before[-1].place)
    across = sum(linear_ends(setup.machine)) - here.place
    other = setup.at(np.array([across[0], across[1], here.place[2]]))
    places = []
    for one in (here, other):
        try:
            check_place(plan, one)
        except ConfigError:
            continue
        places.append(one)
    return places or [setup]


def plan_after(
    questions: Sequence[OpenQuestion],
    setup: Setup,
    config: PlannerConfig,
    budget: float | None,
    before: Sequence[MeasuredRun] = (),
) -> tuple[Plan, list[Answer], Setup]:
    """Choose the shortest path that answers all that any of them answers.

    Parameters
    ----------
    config : PlannerConfig
        Feed, dwells and margin are taken as they are.
    budget : float, optional
        s; longest drive.
    before : sequence of MeasuredRun
        Runs that will be diagnosed together with the new one; the tracker may stay, or go to the
        other side.

    Returns
    -------
    setup : Setup
        With the place of the tracker that is proposed.

    Raises
    ------
    ConfigError
        If no path fits into the time.
    """
    known = [run.observed(setup) for run in before]
    options: list[tuple[float, Plan, list[Answer], Setup]] = []
    for plan in _candidates(setup, config, budget):
        for there in _places(plan, setup, before):
            rows = joint_rows(forecast(plan, there), known, setup.limit)
            answers = [answer_of_pieces(rows, q) for q in questions]
            worth = sum(min(a.log_odds, NAMED_LOG_ODDS) for a in answers)
            options.append((worth, plan, answers, there))
        if all(a.sure for a in answers):
            break
    most = max(worth for worth, *_ in options)
    _, plan, answers, there = next(one for one in options if one[0] >= ANSWERED_SHARE * most)
    return plan, answers, there
