# SPDX-License-Identifier: Apache-2.0
"""Page and text of a noise.json."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from otf_core.model.expanded import COVERAGE_FACTOR, micro_with_expanded
from otf_core.noise.noise_model import QUANTITIES
from otf_core.reports.charts import Panel, decades
from otf_core.reports.rendering import State, render

UNITS = ('m', 'rad', 'rad')
"""Of range, horizontal and vertical angle."""


def _levels(doc: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of range and angles: name, unit, total and white level with u, tails, correlation time."""
    own, times = doc['uncertainty'], np.broadcast_to(doc['correlation_time'], 3)
    for k, (name, unit) in enumerate(zip(QUANTITIES, UNITS, strict=True)):
        tail = doc['tails'][name]

        def of(block: Mapping[str, Any], kind: str, k: int = k) -> Any:
            return block[f'{kind}_angle'][k - 1] if k else block[f'{kind}_range']

        yield {
            'name': name, 'unit': unit, 'time': float(times[k]),
            'total': of(doc, 'u'), 'u_total': of(own, 'u'),
            'white': of(doc, 'white'), 'u_white': of(own, 'white'),
            'kurtosis': tail['excess_kurtosis'], 'dof': tail['student_freedom'],
        }  # fmt: skip


def _shown(level: float, u: float | None, unit: str) -> str:
    return micro_with_expanded(level, COVERAGE_FACTOR * (u or 0.0), unit)


def draw_variogram(doc: Mapping[str, Any], k: int) -> str:
    """Scatter against the time between samples, as seen and as fitted."""
    level, micro = list(_levels(doc))[k], 'µrad' if k else 'µm'
    lag = np.array(doc['variogram']['lag'])
    value = 1e6 * np.sqrt(doc['variogram']['value'][k])
    time = np.geomspace(lag[0], lag[-1], 100)
    slow = max(level['total'] ** 2 - level['white'] ** 2, 0.0)
    rise = 1.0 - np.exp(-time / level['time']) if level['time'] else 0.0 * time
    model = 1e6 * np.sqrt(level['white'] ** 2 + slow * rise)
    wide = 2.0 * (level['u_total'] or 0.0) / level['total'] if level['total'] > 0 else 0.0
    low, high = model * max(1.0 - wide, 0.1), model * (1.0 + wide)
    panel = Panel(decades(lag, 'time between samples (s)'),
                  decades(np.concatenate([value, low, high]), f'scatter ({micro})'))  # fmt: skip
    marks = [panel.band(time, low, high, 'before band'), panel.line(time, model, 'before'),
             panel.dots(lag, value, 'after node')]  # fmt: skip
    return panel.draw(marks, f'variogram of the {QUANTITIES[k]}', QUANTITIES[k])


def draw_spectrum(doc: Mapping[str, Any], k: int) -> str:
    """Amplitude spectrum with its peaks."""
    frequency = np.array(doc['spectrum']['frequency'][1:])
    density = 1e6 * np.sqrt(doc['spectrum']['density'][k][1:])
    panel = Panel(decades(frequency, 'frequency (Hz)'),
                  decades(density, f'{"µrad" if k else "µm"} per root Hz'))  # fmt: skip
    marks = [panel.line(frequency, density, 'after thin')]
    for peak in doc['peaks']:
        if peak['of'] == QUANTITIES[k]:
            marks.append(panel.ranges([peak['frequency']], [panel.y.low], [panel.y.high],
                                      'before thin'))  # fmt: skip
    return panel.draw(marks, f'spectrum of the {QUANTITIES[k]}')


def _content(doc: Mapping[str, Any]) -> dict[str, Any]:
    levels = list(_levels(doc))
    u = doc['uncertainty']['correlation_time']
    time = levels[0]['time']
    colour = 'the noise is white' if not time else (
        f'correlation time of the slow part {time:.2f} s (+/- {math.nan if u is None else u:.2f})'
    )  # fmt: skip
    return {
        'd': doc, 'levels': levels, 'colour': colour,
        'totals': [_shown(v['total'], v['u_total'], v['unit']) for v in levels],
        'whites': [_shown(v['white'], v['u_white'], v['unit']) for v in levels],
    }  # fmt: skip


def noise_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of a noise.json."""
    charts = [draw(doc, k) for draw in (draw_variogram, draw_spectrum) for k in range(3)]
    runs, count = doc['provenance'].get('runs') or [{}], len(doc['warnings'])
    badge = State('no warnings', 'good')
    if count:
        badge = State(f'{count} warning{"s" if count > 1 else ""}', 'open')
    name = str(runs[0].get('name') or '')
    page = render('noise.html.j2', charts=charts, name=name, badges=[badge], **_content(doc))
    return {'report.html': page}


def format_noise(doc: Mapping[str, Any]) -> str:
    """Return the text for a terminal: warnings first."""
    return render('noise.txt.j2', **_content(doc)).rstrip()
