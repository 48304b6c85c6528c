# SPDX-License-Identifier: Apache-2.0
"""The history of machines: history.json with its sentences, and page and text from it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.files.writing import write_text
from otf_core.history.control_chart import Change, DueDate, History, MachineStatus, Step
from otf_core.history.store import StoredEvent
from otf_core.model.expanded import (
    COVERAGE_FACTOR,
    micro_figure,
    micro_significant,
    micro_unit,
    micro_with_expanded,
)
from otf_core.model.motions import unit_of
from otf_core.prediction.calibration_document import Headline
from otf_core.reports.charts import Panel, dates, scale_around
from otf_core.reports.rendering import State, columns_to_text, micro, render

SCHEMA = 'otf-history/1'
FILE, PAGE = 'history.json', 'history.html'
NOTABLE_RATIO = 1.5
"""Factor by which a pace departs from another from which it is reported."""
NAMED_MOTIONS = 6
"""Motions named in a line."""
MONTH, YEAR = 30.0, 365.25
"""days; rates are stated per year where the runs span one, else per month."""
DAY = timedelta(days=1)
STEP_HEAD = ('measured', 'volume (um)', 'expected (um)', 'what happened', 'changed')


def _day(at: datetime) -> str:
    return at.strftime('%Y-%m-%d')


def _moment(at: datetime) -> str:
    return at.strftime('%Y-%m-%d %H:%M' if (at.hour, at.minute) != (0, 0) else '%Y-%m-%d')


def _period(history: History) -> tuple[float, str]:
    """Days of which rates are stated, and their name."""
    return (YEAR, 'a year') if history.series.days[-1] >= YEAR else (MONTH, 'in 30 days')


def _probability(p: float) -> str:
    return 'p < 0.001' if p < 0.001 else f'p = {p:.2g}'


def _pair(value: float, u: float, times: float = 1.0) -> str:
    """Value and expanded uncertainty (95 %) with two digits of it, um."""
    return micro_with_expanded(times * value, times * COVERAGE_FACTOR * u)


def _change(change: Change) -> dict[str, Any]:
    numbers = {'size': change.size, 'expected': change.expected, 'p': change.p}
    return {**numbers, 'significant': change.significant}


def _stated(history: History) -> dict[str, Any] | None:
    first = _stated_uncertainty(history)
    if first is None:
        return None
    return {'u': first.u['mean'], 'k': first.k, 'systematic': first.systematic}


def history_to_dict(history: History) -> dict[str, Any]:
    """Return one machine as plain data, SI units."""
    runs = history.series.runs
    drift, due = history.drift, history.due
    return {
        'machine': history.machine,
        'state': history.standing.value,
        'sentence': state_words(history),
        'assessment': _assessment(history),
        'runs': [
            {
                'name': run.name,
                'at': run.at.isoformat(),
                'volumetric_error': float(history.error[k]),
                'u_volumetric_error': float(history.u_error[k]),
                'since_first': _change(history.volume[k]),
                'motions': {n: _change(c) for n, c in history.chart[k].items()},
            }
            for k, run in enumerate(runs)
        ],
        'steps': [
            {
                'run': runs[step.after].name,
                'events': [e.words for e in step.events],
                'volume': _change(step.volume),
                'changed': step.changed,
                'sentence': _step_words(step),
                'significant': bool(step.significant),
            }
            for step in history.steps
        ],
        'events': [
            {'at': e.at.isoformat(), 'words': e.words, 'followed': e not in history.open_events}
            for e in history.events
        ],
        'reference': runs[history.reference].name,
        'warnings': history.series.warnings,
        'stated': _stated(history),
        'drift': None
        if drift is None
        else {
            'volume_per_day': drift.volume,
            'u_volume_per_day': drift.u_volume,
            'significant': drift.significant,
            'p': drift.p,
            'runs': drift.runs,
            'birge': drift.birge,
            'p_line': drift.p_line,
            'not_linear': drift.bent,
            'motions_per_day': {n: _change(c) for n, c in drift.motions.items()},
        },
        'next_calibration': due and _due_to_dict(history, due),
    }


def _due_to_dict(history: History, due: DueDate) -> dict[str, Any]:
    return {
        'limit': due.limit,
        'at': None if due.days is None else _after(history, due.days),
        'not_before': _after(history, due.earliest),
        'not_after': None if due.latest is None else _after(history, due.latest),
        'confidence': 0.95,
        'withheld': due.withheld or None,
    }


def _step_words(step: Step) -> str:
    """What changed in a step, with sizes."""
    if step.changed:
        return _most([_sized(n, step.motions[n]) for n in step.changed])
    return _unnamed(step)


def store_to_dict(machines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return all machines as plain data: history.json."""
    return {'schema': SCHEMA, 'machines': list(machines)}


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


# The page and the text of a history.json.


def _times(doc: Mapping[str, Any], kind: str) -> list[datetime]:
    return [datetime.fromisoformat(one['at']) for one in doc[kind]]


def step_rows(doc: Mapping[str, Any]) -> list[tuple[Any, ...]]:
    """A row of each run under ``STEP_HEAD``: what changed since the one before."""
    days = [_moment(at) for at in _times(doc, 'runs')]
    happened = {e['words']: e['at'][:10] for e in doc['events']}
    first, *others = doc['runs']
    rows: list[tuple[Any, ...]] = [((days[0], f'run {first["name"]}'), '', '', '', 'first run')]
    for run, day, step in zip(others, days[1:], doc['steps'], strict=True):
        events = '; '.join(f'{words} ({happened[words]})' for words in step['events'])
        said = step['sentence']
        rows.append((
            (day, f'run {run["name"]}'), micro(step['volume']['size']),
            micro(step['volume']['expected']), events,
            State(said, 'open') if step['significant'] else said,
        ))  # fmt: skip
    return rows


def _chart(
    doc: Mapping[str, Any],
    name: str,
    size: Array,
    band: tuple[Array, Array],
    flagged: Sequence[bool] = (),
) -> str:
    """Something over the dates of the runs: events as lines, a line is not drawn across them."""
    runs, events = _times(doc, 'runs'), _times(doc, 'events')
    days = np.array([(at - runs[0]) / DAY for at in runs])
    unit = 'µm' if 'volum' in name or unit_of(name) == 'm' else 'µrad'
    panel = Panel(dates(runs[0], max([runs[-1], *events])),
                  scale_around(np.concatenate([size, *band]), unit, zero=True))  # fmt: skip
    cuts = [k for k, step in enumerate(doc['steps'], start=1) if step['events']]
    marks = [panel.upright((at - runs[0]) / DAY, str(k), 'open dash')
             for k, at in enumerate(events, start=1)]  # fmt: skip
    for a, b in pairwise([0, *cuts, len(runs)]):
        low, high = band[0][a:b], band[1][a:b]
        marks.append(panel.band(days[a:b], low, high, 'noise band') if b - a > 1
                     else panel.ranges(days[a:b], low, high, 'noise'))  # fmt: skip
        marks.append(panel.line(days[a:b], size[a:b], 'after'))
    reference = [run['name'] for run in doc['runs']].index(doc['reference'])
    marks += [panel.dots(days, size, 'after node'), panel.boxes(days[reference], size[reference])]
    rings = np.array(flagged, dtype=bool)
    if rings.any():
        marks.append(panel.rings(days[rings], size[rings]))
    return panel.draw(marks, f'{name} over the dates of the runs', name)


def _change_chart(doc: Mapping[str, Any], name: str, changes: Sequence[Mapping[str, Any]]) -> str:
    """Control chart: change since the first run, and what is expected without one."""
    size, expected = (1e6 * np.array([c[key] for c in changes]) for key in ('size', 'expected'))
    flagged = [c['significant'] for c in changes]
    return _chart(doc, name, size, (0.0 * size, 2.0 * expected), flagged)


def machine_charts(doc: Mapping[str, Any]) -> dict[str, list[str]]:
    """Control charts of the volume and of every motion of a machine."""
    runs = doc['runs']
    size, u = (1e6 * np.array([r[k] for r in runs])
               for k in ('volumetric_error', 'u_volumetric_error'))  # fmt: skip
    spread = COVERAGE_FACTOR * u
    return {
        'volume': [
            _chart(doc, 'volumetric error', size, (size - spread, size + spread)),
            _change_chart(doc, 'change in the volume', [r['since_first'] for r in runs]),
        ],
        'motions': [_change_chart(doc, n, [r['motions'][n] for r in runs])
                    for n in runs[0]['motions']],
    }  # fmt: skip


def machine_tiles(doc: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Numbers of one machine: error, last change, next calibration."""
    error, remark = doc['runs'][-1]['volumetric_error'], 'mean in the volume'
    shown, own = f'{1e6 * error:.1f} um', doc['stated']
    if own is not None:
        shown = micro_figure(error, own['k'] * own['u'])
        remark += (f', U = {micro_significant(own["k"] * own["u"])} (systematic contributions '
                   f'{own["systematic"]})')  # fmt: skip
    tiles = [('volumetric error, latest run', shown, remark)]
    if doc['steps']:
        step = doc['steps'][-1]['volume']
        expected = f'{1e6 * step["expected"]:.2f} um expected without change'
        tiles.append(('last change in the volume', f'{1e6 * step["size"]:.2f} um', expected))
    if due := doc['next_calibration']:
        day = due['not_before'] or 'a day beyond 100 years'
        day = day[:10] if due['not_before'] else day
        limit = f'{1e6 * due["limit"]:.2f} um mean drift'
        tiles.append(('calibrate again: not before', day, limit))
    return tiles


def format_history(doc: Mapping[str, Any]) -> str:
    """Return the text of one machine for a terminal."""
    days = [_moment(at) for at in _times(doc, 'runs')]
    rows = [(' '.join(row[0]), *row[1:]) for row in step_rows(doc)]
    lines = [
        f'{doc["machine"]}: {len(days)} runs, {days[0]} to {days[-1]}; reference '
        f'{doc["reference"]}',
        doc['sentence'],
        *(f'WARNING {words}' for words in doc['warnings']),
        *(columns_to_text(STEP_HEAD, rows) if doc['steps'] else ()),
        *doc['assessment'],
    ]
    return '\n'.join(lines)


def history_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of a history.json."""
    machines = doc['machines']
    order = [state.value for state in MachineStatus]
    named = {s: [m['machine'] for m in machines if m['state'] == s] for s in order}
    state = max((s for s in order if named[s]), key=order.index)
    badge = State(state, 'good' if state == MachineStatus.STEADY.value else 'open')
    counted = '; '.join(f'{s}: {", ".join(m)}' for s, m in named.items() if m) + '.'
    shown = [
        {'d': m, 'rows': step_rows(m), 'charts': machine_charts(m),
         'anchor': ''.join(c if c.isalnum() else '-' for c in m['machine']),
         'reference': next(_moment(datetime.fromisoformat(r['at'])) for r in m['runs']
                           if r['name'] == m['reference'])}
        for m in machines
    ]  # fmt: skip
    alone = len(machines) == 1
    page = render('history.html.j2', machines=shown, head=STEP_HEAD, badges=[badge], alone=alone,
                  counted=counted, tiles=machine_tiles(machines[0]) if alone else [])  # fmt: skip
    return {PAGE: page}


def write_history(doc: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write history.json and history.html; the folder exists."""
    write_text(folder / FILE, json.dumps(doc, indent=1) + '\n')
    write_text(folder / PAGE, history_pages(doc)[PAGE])
    return [folder / FILE, folder / PAGE]
