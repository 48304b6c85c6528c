# SPDX-License-Identifier: Apache-2.0
"""Page and text of a history.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.history.control_chart import MachineStatus
from otf_core.model.expanded import COVERAGE_FACTOR, micro_figure, micro_significant
from otf_core.model.motions import unit_of
from otf_core.reports.charts import Panel, dates, scale_around
from otf_core.reports.rendering import State, columns_to_text, micro, render

PAGE = 'history.html'
DAY = timedelta(days=1)
STEP_HEAD = ('measured', 'volume (um)', 'expected (um)', 'what happened', 'changed')


def _moment(at: datetime) -> str:
    return at.strftime('%Y-%m-%d %H:%M' if (at.hour, at.minute) != (0, 0) else '%Y-%m-%d')


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


def _machine_text(doc: Mapping[str, Any]) -> str:
    """One machine for a terminal."""
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


def format_history(doc: Mapping[str, Any]) -> str:
    """Return the text for a terminal."""
    return '\n\n'.join(map(_machine_text, doc['machines']))


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
