# SPDX-License-Identifier: Apache-2.0
"""The history of a machine as data, text and page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from otf_core.files.writing import write_text
from otf_core.history.change import Change
from otf_core.history.judged import History, Step
from otf_core.history.series import DAY
from otf_core.model.motions import unit_of
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.page import Heading, page_html
from otf_core.reports.section import Picture, Section, State, Table

SCHEMA = 'otf-history/1'
FILE, PAGE = 'history.json', 'history.html'
NAMED = 6
"""Motions named in a line."""
MONTH = 30.0
"""days; rates are stated per month."""


def _day(at: datetime) -> str:
    return at.strftime('%Y-%m-%d %H:%M')


def _change(change: Change) -> dict[str, Any]:
    return {
        'size': change.size,
        'expected': change.expected,
        'p': change.p,
        'significant': change.significant,
    }


def history_to_dict(history: History) -> dict[str, Any]:
    """Return one machine as plain data, SI units."""
    runs = history.series.runs
    drift, due = history.drift, history.due
    return {
        'machine': history.machine,
        'runs': [
            {
                'name': run.name,
                'at': run.at.isoformat(),
                'since_reference': _change(history.volume[k]),
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
        'reference': runs[history.reference].name,
        'warnings': history.series.warnings,
        'drift': None
        if drift is None
        else {
            'volume_per_day': drift.volume,
            'u_volume_per_day': drift.u_volume,
            'significant': drift.significant,
            'p': drift.p,
            'birge': drift.birge,
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


def store_to_dict(histories: Sequence[History]) -> dict[str, Any]:
    """Return all machines as plain data: history.json."""
    return {'schema': SCHEMA, 'machines': [history_to_dict(h) for h in histories]}


def _sized(name: str, change: Change, times: float = 1.0) -> str:
    unit, scale = 'um' if unit_of(name) == 'm' else 'urad', 1e6 * times
    return f'{name} {scale * change.size:.2f} {unit} (expected {scale * change.expected:.2f})'


def _step_words(history: History, step: Step) -> str:
    run = history.series.runs[step.after]
    events = f' after {"; ".join(e.words for e in step.events)}' if step.events else ''
    names = step.changed
    what = ', '.join(_sized(n, step.motions[n]) for n in names[:NAMED])
    more = f' and {len(names) - NAMED} more' if len(names) > NAMED else ''
    return (
        f'{_day(run.at)} {run.name}{events}: volume {1e6 * step.volume.size:.2f} um '
        f'(expected {1e6 * step.volume.expected:.2f}); '
        + (f'changed: {what}{more}' if names else 'no motion changed significantly')
    )


def drift_words(history: History) -> list[str]:
    """Say drift and next calibration in sentences."""
    drift, due = history.drift, history.due
    if drift is None or due is None:
        return ['drift: at least two runs since the last event are needed']
    lines = [
        f'drift since {_day(history.series.runs[history.reference].at)}: '
        f'{1e6 * MONTH * drift.volume:.2f} +/- {1.96e6 * MONTH * drift.u_volume:.2f} um in 30 '
        f'days in the volume '
        f'({"significant" if drift.significant else "not significant"}, p = {drift.p:.2g})'
    ]
    moving = sorted(
        (n for n, c in drift.motions.items() if c.significant),
        key=lambda n: -drift.motions[n].size / drift.motions[n].expected,
    )
    if moving:
        lines.append(
            'drifting (in 30 days): '
            + ', '.join(_sized(n, drift.motions[n], MONTH) for n in moving[:NAMED])
        )
    earliest = _date(history, due.earliest)
    limit = f'{1e6 * due.limit:.2f} um mean drift'
    if due.days is None:
        lines.append(f'calibrate again: no drift is seen; {limit} not before {earliest} (95 %)')
    else:
        latest = None if due.latest is None else _date(history, due.latest)
        lines.append(
            f'calibrate again: {limit} on {_date(history, due.days)}; 95 %: not before '
            f'{earliest}, {f"not after {latest}" if latest else "no latest date"}'
        )
    return lines


def format_history(history: History) -> str:
    """Return the text for a terminal."""
    series = history.series
    lines = [
        f'{history.machine}: {len(series.runs)} runs, {_day(series.runs[0].at)} to '
        f'{_day(series.runs[-1].at)}; reference {series.runs[history.reference].name}',
        *(f'WARNING {words}' for words in history.series.warnings),
        *(_step_words(history, step) for step in history.steps),
        *drift_words(history),
    ]
    return '\n'.join(lines)


def _chart(history: History, name: str, changes: Sequence[Change]) -> str:
    """Control chart: change since the reference, and what is expected without one."""
    days = history.series.days
    unit = 'um' if name == 'volume' or unit_of(name) == 'm' else 'urad'
    size = np.array([1e6 * c.size for c in changes])
    expected = np.array([1e6 * c.expected for c in changes])
    panel = Panel(
        Scale(0.0, max(float(days[-1]), 1.0 / DAY), 'days'),
        around(np.concatenate([size, 2 * expected]), unit.replace('u', '\N{MICRO SIGN}', 1),
               zero=True),
    )  # fmt: skip
    flagged = np.array([c.significant for c in changes])
    marks = [
        panel.band(days, 0.0 * size, 2 * expected, 'noise band'),
        panel.line(days, size, 'after'),
        panel.dots(days, size, 'after node'),
    ]
    if flagged.any():
        marks.append(panel.rings(days[flagged], size[flagged]))
    return panel.draw(marks, f'change of {name} since the reference', name)


def _sections(history: History) -> list[Section]:
    names = list(history.series.parts)
    words = (*history.series.warnings, *drift_words(history))
    head = ('run', 'measured', 'volume (um)', 'expected (um)', 'what happened', 'changed')
    rows = tuple(
        (
            history.series.runs[s.after].name,
            _day(history.series.runs[s.after].at),
            f'{1e6 * s.volume.size:.2f}',
            f'{1e6 * s.volume.expected:.2f}',
            '; '.join(e.words for e in s.events),
            ', '.join(s.changed),
        )
        for s in history.steps
    )

    def pictures() -> Sequence[Picture]:
        caption = (
            'Change since the reference (line), what the uncertainties of both runs let expect '
            'without change, twice (area), and changes beyond chance (rings, 0.27 %).'
        )
        parts = [_chart(history, 'volume', history.volume)]
        parts += [_chart(history, n, [c[n] for c in history.chart]) for n in names]
        return [Picture(tuple(parts), caption, columns=3)]

    anchor = ''.join(c if c.isalnum() else '-' for c in history.machine)
    return [
        Section(f'{anchor}-drift', history.machine, words),
        Section(f'{anchor}-runs', 'From run to run', tables=(Table(head, rows, (2, 3)),)),
        Section(f'{anchor}-chart', 'Control chart', draw=pictures),
    ]


def history_page(histories: Sequence[History]) -> str:
    """Return the page: self-contained HTML."""
    moving = [h.machine for h in histories if h.drift is not None and h.drift.significant]
    sentence = f'{", ".join(moving)} drift' if moving else 'No machine drifts beyond chance.'
    heading = Heading(
        f'History of {len(histories)} machine{"s" if len(histories) > 1 else ""}',
        sentence if not moving else f'Beyond chance: {sentence}.',
        (State('drift', 'open') if moving else State('steady', 'good'),),
    )
    sections = [Section('top', ''), *(s for h in histories for s in _sections(h))]
    return page_html(heading, sections)


def write_history(histories: Sequence[History], folder: Path) -> list[Path]:
    """Write history.json and history.html; the folder exists.

    Returns
    -------
    list of Path
    """
    data: Mapping[str, Any] = store_to_dict(histories)
    write_text(folder / FILE, json.dumps(data, indent=1) + '\n')
    write_text(folder / PAGE, history_page(histories))
    return [folder / FILE, folder / PAGE]
