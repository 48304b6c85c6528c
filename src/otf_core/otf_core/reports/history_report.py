# SPDX-License-Identifier: Apache-2.0
"""The history of a machine as data, text and page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from otf_core.prediction.absorbed import OffsetBound
from otf_core.reports.charts import Panel, dates, scale_around
from otf_core.reports.page import (
    Cell,
    Heading,
    Picture,
    Section,
    State,
    Table,
    micro,
    page_html,
    table_to_text,
)

SCHEMA = 'otf-history/1'
FILE, PAGE = 'history.json', 'history.html'
NOTABLE_RATIO = 1.5
"""Factor by which a pace departs from another from which it is reported."""
NAMED_MOTIONS = 6
"""Motions named in a line."""
MONTH, YEAR = 30.0, 365.25
"""days; rates are stated per year where the runs span one, else per month."""
BADGE = {MachineStatus.STEADY: 'good'}
"""Classes of badges; all other states are open questions."""


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


def history_to_dict(history: History) -> dict[str, Any]:
    """Return one machine as plain data, SI units."""
    runs = history.series.runs
    drift, due = history.drift, history.due
    return {
        'machine': history.machine,
        'state': history.standing.value,
        'sentence': state_words(history),
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
            }
            for step in history.steps
        ],
        'events': [
            {'at': e.at.isoformat(), 'words': e.words, 'followed': e not in history.open_events}
            for e in history.events
        ],
        'reference': runs[history.reference].name,
        'warnings': history.series.warnings,
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
        'next_calibration': None
        if due is None
        else {
            'limit': due.limit,
            'at': None if due.days is None else _after(history, due.days),
            'not_before': _after(history, due.earliest),
            'not_after': None if due.latest is None else _after(history, due.latest),
            'confidence': 0.95,
            'withheld': due.withheld or None,
        },
    }


def _after(history: History, days: float) -> str | None:
    """Moment so many days after the last run; None if that is beyond a century."""
    if days > 36500:
        return None
    return (history.series.runs[-1].at + timedelta(days=days)).isoformat(timespec='minutes')


def _date(history: History, days: float) -> str:
    """Day so many days after the last run, for a sentence."""
    moment = _after(history, days)
    return 'a day beyond 100 years' if moment is None else moment[:10]


def store_to_dict(reports: Sequence[MachineReport]) -> dict[str, Any]:
    """Return all machines as plain data: history.json."""
    return {'schema': SCHEMA, 'machines': [report.data for report in reports]}


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


def format_history(history: History) -> str:
    """Return the text for a terminal."""
    series = history.series
    lines = [
        f'{history.machine}: {len(series.runs)} runs, {_moment(series.runs[0].at)} to '
        f'{_moment(series.runs[-1].at)}; reference {series.runs[history.reference].name}',
        state_words(history),
        *(f'WARNING {words}' for words in series.warnings),
        *(table_to_text(_steps_table(history)) if history.steps else ()),
        *_assessment(history),
    ]
    return '\n'.join(lines)


def _chart(
    history: History, name: str, size: Array, band: tuple[Array, Array], changes: Sequence[Change]
) -> str:
    """Something over the dates of the runs: events as lines, a line is not drawn across them."""
    days, runs = history.series.days, history.series.runs
    unit = 'um' if 'volum' in name or unit_of(name) == 'm' else 'urad'
    panel = Panel(
        dates(runs[0].at, max([runs[-1].at, *(e.at for e in history.events)])),
        scale_around(
            np.concatenate([size, *band]), unit.replace('u', '\N{MICRO SIGN}', 1), zero=True
        ),
    )
    flagged = np.array([c.significant for c in changes])
    ends = [0, *(s.after for s in history.steps if s.events), len(runs)]
    marks = [
        panel.upright((e.at - runs[0].at) / timedelta(days=1), str(k), 'open dash')
        for k, e in enumerate(history.events, start=1)
    ]
    for a, b in pairwise(ends):
        marks += [
            panel.band(days[a:b], band[0][a:b], band[1][a:b], 'noise band')
            if b - a > 1
            else panel.ranges(days[a:b], band[0][a:b], band[1][a:b], 'noise'),
            panel.line(days[a:b], size[a:b], 'after'),
        ]
    marks += [
        panel.dots(days, size, 'after node'),
        panel.boxes(days[history.reference], size[history.reference]),
    ]
    if flagged.any():
        marks.append(panel.rings(days[flagged], size[flagged]))
    return panel.draw(marks, f'{name} over the dates of the runs', name)


def _change_chart(history: History, name: str, changes: Sequence[Change]) -> str:
    """Control chart: change since the first run, and what is expected without one."""
    size = np.array([1e6 * c.size for c in changes])
    expected = np.array([2e6 * c.expected for c in changes])
    return _chart(history, name, size, (0.0 * size, expected), changes)


def _error_chart(history: History) -> str:
    """Size of the errors themselves."""
    size, spread = 1e6 * history.error, 1e6 * COVERAGE_FACTOR * history.u_error
    return _chart(history, 'volumetric error', size, (size - spread, size + spread), ())


def _marks_words(history: History) -> str:
    """What the marks of the charts are."""
    events = '; '.join(
        f'{k}: {e.words}, {_day(e.at)}' for k, e in enumerate(history.events, start=1)
    )
    reference = history.series.runs[history.reference]
    return f'Square: {_moment(reference.at)}, the run from which drift is assessed. ' + (
        f'Dashed lines are events ({events}); no line leads across them. ' if events else ''
    )


def _pictures(history: History) -> list[Picture]:
    """Control charts of the volume and of every motion."""
    error = (
        'Mean length of the error vectors in the volume by every run, best rigid motion '
        'removed, with its uncertainty by what is declared (area, 95 %). '
    )
    change = (
        'Change since the first run, root mean square over the axis (line), and twice the '
        'value expected from the uncertainties of both runs without a change (area)'
        '. Rings: significant ('
        '0.27 % for all motions of a run together). A change that is undone returns to '
        'zero; this says nothing about the size of the errors. '
    )
    marks = _marks_words(history)
    volume = (
        _error_chart(history),
        _change_chart(history, 'change in the volume', history.volume),
    )
    motions = tuple(
        _change_chart(history, n, [c[n] for c in history.chart]) for n in history.chart[0]
    )
    return [
        Picture(volume, error + marks, columns=2, title='Volume: error, and change'),
        Picture(motions, change + marks, columns=3, title='Change of every motion'),
    ]


def _steps_table(history: History) -> Table:
    """A row of each run: what changed since the one before."""
    head = ('measured', 'volume (um)', 'expected (um)', 'what happened', 'changed')
    runs = history.series.runs
    rows: list[tuple[Cell, ...]] = [
        ((_moment(runs[0].at), f'run {runs[0].name}'), '', '', '', 'first run')
    ]
    for step in history.steps:
        run, volume, words = runs[step.after], step.volume, _unnamed(step)
        if step.changed:
            words = _most([_sized(n, step.motions[n]) for n in step.changed])
        rows.append((
            (_moment(run.at), f'run {run.name}'), micro(volume.size), micro(volume.expected),
            _events(step.events), State(words, 'open') if step.significant else words,
        ))  # fmt: skip
    return Table(head, tuple(rows), (1, 2))


def _sections(history: History, *, alone: bool) -> list[Section]:
    state = () if alone else (state_words(history),)  # the headline says it of one machine
    words = (*state, *history.series.warnings, *_assessment(history))
    pictures = _pictures(history)
    anchor = ''.join(c if c.isalnum() else '-' for c in history.machine)
    return [
        Section(f'{anchor}-drift', history.machine, words),
        Section(f'{anchor}-runs', 'From run to run', tables=(_steps_table(history),)),
        Section(f'{anchor}-chart', 'Control charts', draw=lambda: pictures),
    ]


def _stated_uncertainty(history: History) -> tuple[float, str] | None:
    """Mean expanded uncertainty that the latest tables state first, m, and of what kind it is."""
    head = history.series.runs[-1].content.extra.get('headline')
    if not isinstance(head, dict):
        return None
    expected = head['expected_after_compensation']
    return float(expected['U']['mean']), str(expected['systematic'])


def _assessment(history: History) -> list[str]:
    """Drift, what the uncertainties leave out, and values that hold at one target offset only."""
    lines, stated = drift_words(history), _stated_uncertainty(history)
    if stated is not None and stated[1] != 'declared':
        lines.append(
            f'Changes are assessed by the contributions that the runs declare, and they do not '
            f'declare all systematic ones (tracker scale, air, temperature ...): of typical size '
            f'these alone make two runs differ by up to about '
            f'{micro_significant(math.sqrt(2.0) * stated[0])} in the volume if tracker, place or '
            f'weather differ'
        )
    bound = history.series.runs[-1].content.extra.get('target_offset_bound')
    if isinstance(bound, dict) and bound['contains']:
        lines.append(OffsetBound(np.array(bound['offset']), bound['contains']).sentence)
    return lines


def _tiles(history: History) -> tuple[tuple[str, str, str], ...]:
    """Numbers of one machine: error, last change, next calibration."""
    stated = _stated_uncertainty(history)
    error, remark = float(history.error[-1]), 'mean in the volume'
    shown = f'{1e6 * error:.1f} um'
    if stated is not None:
        wide, systematic = stated
        shown = micro_figure(error, wide)
        remark += f', U = {micro_significant(wide)} (systematic contributions {systematic})'
    tiles = [('volumetric error, latest run', shown, remark)]
    if history.steps:
        step = history.steps[-1].volume
        expected = f'{1e6 * step.expected:.2f} um expected without change'
        tiles.append(('last change in the volume', f'{1e6 * step.size:.2f} um', expected))
    if history.due is not None:
        limit = f'{1e6 * history.due.limit:.2f} um mean drift'
        tiles.append(('calibrate again: not before', _date(history, history.due.earliest), limit))
    return tuple(tiles)


def _badge(state: MachineStatus) -> tuple[State]:
    return (State(state.value, BADGE.get(state, 'open')),)


@dataclass(frozen=True)
class MachineReport:
    """What is stated of one machine, without the tables and covariances that it rests on.

    Attributes
    ----------
    words : str
        For a terminal.
    data : mapping
        Plain data, SI units.
    heading : Heading
        Of the page, if there is no other machine on it.
    sections : sequence of Section
        Of the page, drawn; empty if no page is wanted.
    """

    machine: str
    standing: MachineStatus
    words: str
    data: Mapping[str, Any]
    heading: Heading
    sections: Sequence[Section]


def report_machine(history: History, *, alone: bool = True, drawn: bool = True) -> MachineReport:
    """Describe and draw one machine.

    Parameters
    ----------
    alone : bool
        Whether it is the only one of its page.
    drawn : bool
        Whether a page is wanted.
    """
    return MachineReport(
        history.machine,
        history.standing,
        format_history(history),
        history_to_dict(history),
        Heading(
            f'History of {history.machine}',
            state_words(history),
            _badge(history.standing),
            _tiles(history),
        ),
        _sections(history, alone=alone) if drawn else (),
    )


def _heading(reports: Sequence[MachineReport]) -> Heading:
    """The state of one machine in its words; of several how many are in which."""
    if len(reports) == 1:
        return reports[0].heading
    named = {s: [r.machine for r in reports if r.standing is s] for s in MachineStatus}
    state = max((s for s in MachineStatus if named[s]), key=list(MachineStatus).index)
    sentence = '; '.join(f'{s.value}: {", ".join(m)}' for s, m in named.items() if m) + '.'
    return Heading(f'History of {len(reports)} machines', sentence, _badge(state))


def history_page(reports: Sequence[MachineReport]) -> str:
    """Return the page: self-contained HTML."""
    sections = [Section('top', ''), *(s for r in reports for s in r.sections)]
    return page_html(_heading(reports), sections)


def write_history(reports: Sequence[MachineReport], folder: Path) -> list[Path]:
    """Write history.json and history.html; the folder exists."""
    write_text(folder / FILE, json.dumps(store_to_dict(reports), indent=1) + '\n')
    write_text(folder / PAGE, history_page(reports))
    return [folder / FILE, folder / PAGE]
