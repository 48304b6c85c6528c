# SPDX-License-Identifier: Apache-2.0
"""history.json: what is known of the machines of a store, with its sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from otf_core.documents import Document, ResultDocument, stated
from otf_core.history.control_chart import Change, DueDate, History, MachineStatus, Step
from otf_core.history.store import StoredEvent
from otf_core.model.expanded import (
    COVERAGE_FACTOR,
    micro_significant,
    micro_unit,
    micro_with_expanded,
)
from otf_core.model.motions import unit_of
from otf_core.prediction.calibration_document import Headline

NOTABLE_RATIO = 1.5
"""Factor by which a pace departs from another from which it is reported."""
NAMED_MOTIONS = 6
"""Motions named in a line."""
MONTH, YEAR = 30.0, 365.25
"""days; rates are stated per year where the runs span one, else per month."""


@dataclass(frozen=True)
class RunEntry(Document):
    """A calibration."""

    name: str = stated('first digits of its hash')
    at: str = stated('when it was measured, ISO 8601')
    volumetric_error: float = stated('mean length of the error vectors', 'm')
    u_volumetric_error: float = stated('its mean standard uncertainty', 'm')
    since_first: Change = stated('in the volume, since the first run')
    motions: Mapping[str, Change] = stated('the same of every error')


@dataclass(frozen=True)
class StepEntry(Document):
    """From one run to the next."""

    run: str = stated('the later run')
    events: tuple[str, ...] = stated('what happened between them')
    volume: Change = stated('in the volume')
    changed: tuple[str, ...] = stated('errors that changed significantly, the most first')
    sentence: str = stated('what changed')
    significant: bool = stated('anything changed beyond chance')


@dataclass(frozen=True)
class EventEntry(Document):
    """Something that happened to the machine."""

    at: str = stated('when, ISO 8601')
    words: str = stated('what')
    followed: bool = stated('by a run')


@dataclass(frozen=True)
class StatedUncertainty(Document):
    """Mean uncertainty of the error vectors by the latest run."""

    u: float = stated('standard uncertainty', 'm')
    k: float = stated('coverage factor for 95 %')
    systematic: str = stated('declared or typical')


@dataclass(frozen=True)
class DriftEntry(Document):
    """Rates since the last event."""

    volume_per_day: float = stated('in the volume', 'm/d')
    u_volume_per_day: float = stated('its standard uncertainty', 'm/d')
    significant: bool = stated('beyond chance')
    p: float = stated('probability of such rates without drift')
    runs: int = stated('runs that it is estimated from')
    birge: float = stated('scatter about the line over what the uncertainties say')
    p_line: Mapping[str, float] = stated('probability of such scatter about a straight line')
    not_linear: tuple[str, ...] = stated('errors that a straight line does not describe')
    motions_per_day: Mapping[str, Change] = stated('of every error', 'm/d or rad/d')


@dataclass(frozen=True)
class NextCalibration(Document):
    """When the drift reaches a limit."""

    limit: float = stated('mean volumetric drift that is permitted', 'm')
    at: str | None = stated('ISO 8601; null: no significant drift, or beyond 100 years')
    not_before: str | None = stated('95 %')
    not_after: str | None = stated('95 %')
    confidence: float = stated('of these')
    withheld: str | None = stated('why there is no date')


@dataclass(frozen=True)
class MachineHistory(Document):
    """One machine over its calibrations; changes are judged by u_run and what does not repeat."""

    machine: str = stated('name')
    state: str = stated('steady, drift, not linear, changed or not judged')
    sentence: str = stated('what is known of it')
    assessment: tuple[str, ...] = stated('drift, next calibration, what is left out')
    runs: tuple[RunEntry, ...] = stated('in the order of time')
    steps: tuple[StepEntry, ...] = stated('from run to run')
    events: tuple[EventEntry, ...] = stated('from the first run on')
    reference: str = stated('run from which drift is judged')
    warnings: tuple[str, ...] = stated('runs of another target offset')
    drift: DriftEntry | None = stated('null: fewer than two runs')
    next_calibration: NextCalibration | None = stated('null: no drift is known')
    stated: StatedUncertainty | None = stated('null: not stated by the latest tables')


@dataclass(frozen=True)
class HistoryDocument(ResultDocument):
    """The machines of a store."""

    file = 'history.json'

    machines: tuple[MachineHistory, ...] = stated('those with the latest run first')
    schema: str = stated('otf-history/1', default='otf-history/1')


def machine_history(history: History) -> MachineHistory:
    """Return what is known of one machine."""
    runs, drift, due = history.series.runs, history.drift, history.due
    first = _stated_uncertainty(history)
    return MachineHistory(
        machine=history.machine,
        state=history.standing.value,
        sentence=state_words(history),
        assessment=tuple(_assessment(history)),
        runs=tuple(
            RunEntry(run.name, run.at.isoformat(), float(error), float(u), volume, chart)
            for run, error, u, volume, chart in zip(
                runs, history.error, history.u_error, history.volume, history.chart, strict=True
            )
        ),
        steps=tuple(
            StepEntry(
                runs[step.after].name, tuple(e.words for e in step.events), step.volume,
                tuple(step.changed), _step_words(step), bool(step.significant),
            )
            for step in history.steps
        ),
        events=tuple(
            EventEntry(e.at.isoformat(), e.words, e not in history.open_events)
            for e in history.events
        ),
        reference=runs[history.reference].name,
        warnings=tuple(history.series.warnings),
        stated=None if first is None else StatedUncertainty(
            first.u['mean'], first.k, first.systematic
        ),
        drift=None if drift is None else DriftEntry(
            drift.volume, drift.u_volume, bool(drift.significant), drift.p, drift.runs,
            drift.birge, drift.p_line, tuple(drift.bent), drift.motions,
        ),
        next_calibration=None if due is None else NextCalibration(
            due.limit, None if due.days is None else _after(history, due.days),
            _after(history, due.earliest),
            None if due.latest is None else _after(history, due.latest), 0.95,
            due.withheld or None,
        ),
    )  # fmt: skip


def _day(at: datetime) -> str:
    return at.strftime('%Y-%m-%d')


def _period(history: History) -> tuple[float, str]:
    """Days of which rates are stated, and their name."""
    return (YEAR, 'a year') if history.series.days[-1] >= YEAR else (MONTH, 'in 30 days')


def _probability(p: float) -> str:
    return 'p < 0.001' if p < 0.001 else f'p = {p:.2g}'


def _pair(value: float, u: float, times: float = 1.0) -> str:
    """Value and expanded uncertainty (95 %) with two digits of it, um."""
    return micro_with_expanded(times * value, times * COVERAGE_FACTOR * u)


def _step_words(step: Step) -> str:
    """What changed in a step, with sizes."""
    if step.changed:
        return _most([_sized(n, step.motions[n]) for n in step.changed])
    return _unnamed(step)


def _after(history: History, days: float) -> str | None:
    """Moment so many days after the last run; None if that is beyond a century."""
    if days > 36500:
        return None
    return (history.series.runs[-1].at + timedelta(days=days)).isoformat(timespec='minutes')


def _date(history: History, days: float) -> str:
    """Day so many days after the last run, for a sentence."""
    moment = _after(history, days)
    return 'a day beyond 100 years' if moment is None else moment[:10]


def _sized(name: str, change: Change, times: float = 1.0) -> str:
    unit, scale = 'um' if unit_of(name) == 'm' else 'urad', 1e6 * times
    return f'{name} {scale * change.size:.2f} {unit} (expected {scale * change.expected:.2f})'


def _most(names: Sequence[str]) -> str:
    """Names, the first ones only."""
    more = f' and {len(names) - NAMED_MOTIONS} more' if len(names) > NAMED_MOTIONS else ''
    return ', '.join(names[:NAMED_MOTIONS]) + more


def _events(events: Sequence[StoredEvent]) -> str:
    return '; '.join(f'{e.words} ({_day(e.at)})' for e in events)


def _unnamed(step: Step) -> str:
    """What is stated where no motion changed significantly."""
    return 'no single motion, but all together' if step.significant else 'no motion significantly'


def _last_change(history: History) -> str:
    """The last step as a clause: when, how far, what."""
    step, runs = history.steps[-1], history.series.runs
    parts = [f'{1e6 * step.volume.size:.2f} um in the volume']
    for name in step.changed[:2]:
        unit = micro_unit(unit_of(name))
        parts.append(f'{name} by {1e6 * step.motions[name].size:.2f} {unit} (rms over the axis)')
    when = f'from {_day(runs[step.after - 1].at)} to {_day(runs[step.after].at)}'
    after = f', after {_events(step.events)}' if step.events else ''
    if not step.significant:
        return f'no significant change {when}{after}'
    return f'{", ".join(parts)} {when}{after}'


def _pace(history: History) -> str:
    """How the last step compares with the steps since the reference before it; or nothing."""
    first, last = history.reference, history.steps[-1]
    days = history.series.days
    before = [
        s.volume.size / (days[s.after] - days[s.after - 1])
        for s in history.steps[first:-1]
        if days[s.after] > days[s.after - 1]
    ]
    if not before or days[-1] <= days[-2]:
        return ''
    ratio = last.volume.size / (days[-1] - days[-2]) / max(float(np.mean(before)), 1e-300)
    if ratio >= NOTABLE_RATIO:
        return f', {ratio:.1f} times as fast as before'
    return f', {ratio:.2f} times as fast as before' if ratio <= 1.0 / NOTABLE_RATIO else ''


def state_words(history: History) -> str:
    """What is known of a machine, in a sentence that begins with its state."""
    runs, drift = history.series.runs, history.drift
    if history.open_events:
        return (
            f'Not assessed: {_events(history.open_events)}, and no run since; its influence is '
            f'unknown, and so is the validity of the tables.'
        )
    if len(runs) < 2:
        return 'Not assessed: there is only one run.'
    since = f'since {_day(runs[history.reference].at)}'
    change = _last_change(history)
    if drift is None:
        return (
            f'{history.standing.value.capitalize()}: {change}. Drift cannot be assessed yet: '
            f'one run since then.'
        )
    if history.standing is MachineStatus.BENT:
        return (
            f'Not linear: a straight line does not describe {_most(drift.bent)} over the '
            f'{drift.runs} runs {since}. Last change: {change}{_pace(history)}.'
        )
    days, name = _period(history)
    if history.standing is MachineStatus.DRIFT:
        return (
            f'Drifts by {_pair(drift.volume, drift.u_volume, days)} {name} in the volume (95 %) '
            f'{since}, {drift.runs} runs. Last change: {change}.'
        )
    if history.standing is MachineStatus.CHANGED:
        words = (
            'two runs cannot distinguish a drift from a jump'
            if drift.runs < 3
            else f'no significant drift over the {drift.runs} runs {since}'
        )
        return f'Changed: last change {change}; {words}.'
    return f'Steady: no significant change or drift in the {drift.runs} runs {since}.'


def drift_words(history: History) -> list[str]:
    """State drift and next calibration in sentences."""
    drift, due = history.drift, history.due
    if drift is None:
        return ['Drift: at least two runs since the last event are needed']
    days, name = _period(history)
    if drift.bent:
        seen = f'not linear: {_most(drift.bent)}; the line alone gives'
    elif drift.runs < 3:
        seen = 'from two runs, if it continues evenly:'
    else:
        seen = 'significant:' if drift.significant else 'not significant:'
    lines = [
        f'Drift since {_day(history.series.runs[history.reference].at)}, {drift.runs} runs, '
        f'{seen} {_pair(drift.volume, drift.u_volume, days)} {name} in the volume (95 %, '
        f'{_probability(drift.p)})'
    ]
    moving = sorted(
        (n for n, c in drift.motions.items() if c.significant),
        key=lambda n: -drift.motions[n].size / drift.motions[n].expected,
    )
    if moving and not drift.bent:
        lines.append(
            f'Drifting ({name}): ' + _most([_sized(n, drift.motions[n], days) for n in moving])
        )
    return [*lines, *([] if due is None else [_due_words(history, due)])]


def _due_words(history: History, due: DueDate) -> str:
    """When to calibrate again."""
    earliest, limit = _date(history, due.earliest), f'{1e6 * due.limit:.2f} um mean drift'
    if due.withheld:
        return (
            f'Calibrate again: no date, {due.withheld}; at the pace of the last step or of the '
            f'line, whichever is faster, {limit} not before {earliest} (95 %), and sooner if it '
            f'continues to accelerate'
        )
    if due.days is None:
        return f'Calibrate again: no significant drift; {limit} not before {earliest} (95 %)'
    latest = None if due.latest is None else _date(history, due.latest)
    return (
        f'Calibrate again: {limit} on {_date(history, due.days)}; 95 %: not before {earliest}, '
        + (f'not after {latest}' if latest else 'no latest date')
    )


def _stated_uncertainty(history: History) -> Headline | None:
    """What the latest tables state first."""
    return history.series.runs[-1].content.headline


def _assessment(history: History) -> list[str]:
    """Drift, what the uncertainties leave out, and values that hold at one target offset only."""
    lines, stated = drift_words(history), _stated_uncertainty(history)
    if stated is not None and stated.systematic != 'declared':
        apart = micro_significant(math.sqrt(2.0) * stated.expanded['mean'])
        lines.append(
            f'Changes are assessed by the contributions that the runs declare, and they do not '
            f'declare all systematic ones (tracker scale, air, temperature ...): of typical size '
            f'these alone make two runs differ by up to about '
            f'{apart} in the volume if tracker, place or weather differ'
        )
    bound = history.series.runs[-1].content.target_offset_bound
    if bound is not None and bound.contains:
        lines.append(bound.sentence)
    return lines
