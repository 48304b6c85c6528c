# SPDX-License-Identifier: Apache-2.0
"""Page and text of a comparison.json.

Figures are one for each motion (paper Figures 6 to 8) and one of the volume (Figure 9).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.comparison.compare import COVERAGE_FACTOR, agreement
from otf_core.model.expanded import micro_unit
from otf_core.model.frames import XYZ
from otf_core.reports.calibration_errors import arrow_items
from otf_core.reports.charts import Bar, Panel, Scale, bars, heat_key, heat_step, scale_around
from otf_core.reports.rendering import State, columns_to_text, micro, render
from otf_core.reports.scene import box, box_around, magnification, scene

HISTOGRAM_BINS = 31
ARROW_SHARE = 0.12
"""Length of the longest arrow, share of the longest edge."""
MOST_ARROWS = 343
"""About; of more points only some are drawn."""
AGREEING_SHARE = 0.95
"""Share of normalised errors up to 1 from which two sources agree: that of their coverage."""
ROW_WORDS = (
    'a and b: span of an error motion, value of any other error, both in the same gauge; U: '
    'largest, k = 2; E_n: difference over the root of the sum of both U squared'
)
HEAD = ('Error', 'Unit', 'Largest |b - a|', 'at', 'a', 'b', 'U of a', 'U of b', 'Largest E_n',
        'E_n up to 1')  # fmt: skip


def _errors(doc: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Entries of all errors, motions first."""
    return {**doc['motions'], **doc['squareness'], **doc['location']}


def _known(entry: Mapping[str, Any]) -> list[float]:
    """Normalised errors of an entry, those without an uncertainty left out."""
    every = entry['normalised_error']
    return [v for v in (every if isinstance(every, list) else [every]) if v is not None]


def _along(entry: Mapping[str, Any]) -> tuple[Array, str]:
    """Positions of a motion as they are shown, and their unit."""
    turns = entry['position_unit'] == 'rad'
    return np.array(entry['position']) * (np.degrees(1.0) if turns else 1e3), (
        'deg' if turns else 'mm'
    )


def motion_chart(name: str, entry: Mapping[str, Any], *, difference: bool = False) -> str:
    """One motion of both sides, or their difference, with U as bands."""
    a, b = (1e6 * np.array(entry[k]) for k in 'ab')
    u_a, u_b = (1e6 * COVERAGE_FACTOR * np.array(entry[f'u_{k}']) for k in 'ab')
    sides = [(a, u_a, 'after'), (b, u_b, 'before')]
    if difference:
        sides = [(0.0 * a, np.hypot(u_a, u_b), 'noise'), (b - a, 0.0 * a, 'ink')]
    reach = [end for value, wide, _ in sides for end in (value - wide, value + wide)]
    (x, unit), label = _along(entry), f'{name}, b - a' if difference else name
    micro_name = micro_unit(entry['unit']).replace('u', '\N{MICRO SIGN}', 1)
    scale = scale_around(np.concatenate(reach), f'{label} ({micro_name})')
    panel = Panel(Scale(float(x[0]), float(x[-1]), f'{name[-1]} ({unit})'), scale)
    marks = [panel.band(x, v - w, v + w, f'{kind} band') for v, w, kind in sides if kind != 'ink']
    marks += [panel.line(x, v, kind) for v, _, kind in sides if kind != 'noise']
    if difference:
        marks += [panel.level(0.0, 'soft'), panel.dots(x, b - a, 'ink')]
    return panel.draw(marks, f'{label} of both', label)


def histogram_charts(doc: Mapping[str, Any]) -> list[str]:
    """Share of points by the difference along X, Y and Z."""
    difference = 1e6 * np.array(doc['volume']['difference'])
    reach = 1.02 * (float(np.abs(difference).max()) or 1.0)
    edges, charts = np.linspace(-reach, reach, HISTOGRAM_BINS + 1), []
    for values, axis in zip(difference.T, XYZ, strict=True):
        share = 100.0 * np.histogram(values, edges)[0] / len(values)
        panel = Panel(Scale(-reach, reach, f'b - a along {axis} (µm)'),
                      scale_around(share, 'share of points (%)', zero=True))  # fmt: skip
        heading = f'along {axis}: standard deviation {values.std():.2f} µm'
        marks = [panel.columns(edges, share, 'noise')]
        charts.append(panel.draw(marks, f'difference along {axis}', heading))
    return charts


def vector_chart(doc: Mapping[str, Any]) -> tuple[str, str]:
    """Differences in the volume, coloured by length in classes, and the key of the colours."""
    points, field = (np.array(doc['volume'][k]) for k in ('position', 'difference'))
    step = max(1, len(points) // MOST_ARROWS)
    points, field = points[::step], field[::step]
    low, high = box_around(points)
    length = np.linalg.norm(field, axis=1)
    shown = magnification(float(length.max()), ARROW_SHARE * float((high - low).max()))
    size = heat_step(1e6 * length)
    items = [*box(low, high), *arrow_items(points, field, size, shown, 'heat thin')]
    drawn = scene(items, low, high, 'error vectors in the volume', turns=False, shown=shown)
    return drawn, heat_key(size, 1e6 * float(length.max()), 'µm')


def agreement_chart(doc: Mapping[str, Any]) -> str:
    """Largest E_n of each error; empty where no uncertainty is stated."""
    worst = {name: max(_known(entry), default=None) for name, entry in _errors(doc).items()}
    if not any(v is not None for v in worst.values()):
        return ''
    rows = [
        Bar(name, (), 'no uncertainty')
        if v is None
        else Bar(name, ((v, 'good' if v <= 1.0 else 'bad'),), f'{v:.2f}', 1.0)
        for name, v in worst.items()
    ]
    return bars(rows, 'largest E_n', width=480.0)


def error_row(name: str, entry: Mapping[str, Any]) -> tuple[str | State, ...]:
    """Row of an error under ``HEAD``."""
    a, b, u_a, u_b = (np.atleast_1d(entry[k]) for k in ('a', 'b', 'u_a', 'u_b'))
    known, difference, at = _known(entry), np.abs(b - a), ''
    worst, motion = int(difference.argmax()), 'position' in entry
    if motion:
        x, unit = _along(entry)
        at = f'{x[worst]:.{2 if unit == "deg" else 1}f} {unit}'
    state = State('no uncertainty')
    if known:
        share = agreement(np.array(known))
        state = State(f'{100 * share:.0f} %', 'good' if share >= AGREEING_SHARE else 'bad')
    return (
        name, micro_unit(entry['unit']), micro(float(difference[worst])), at,
        *(micro(float(np.ptp(v) if motion else v[0])) for v in (a, b)),
        *(micro(COVERAGE_FACTOR * float(u.max())) if u.max() > 0 else '-' for u in (u_a, u_b)),
        f'{max(known):.2f}' if known else '-', state,
    )  # fmt: skip


def comparison_pages(doc: Mapping[str, Any]) -> dict[str, str]:
    """Return the page of a comparison.json."""
    known = np.array([v for entry in _errors(doc).values() for v in _known(entry)])
    share, (arrows, key) = agreement(known) if known.size else None, vector_chart(doc)
    badge = State('no uncertainty stated', 'open')
    if share is not None:
        good = share >= AGREEING_SHARE
        badge = State('agree within U', 'good') if good else State('differ beyond U', 'bad')
    page = render(
        'comparison.html.j2', d=doc, badges=[badge], share=share, values=known,
        arrows=arrows, key=key, agreement_chart=agreement_chart(doc), head=HEAD,
        rows=[error_row(n, e) for n, e in _errors(doc).items()], row_words=ROW_WORDS,
        motion_charts=[motion_chart(n, e) for n, e in doc['motions'].items()],
        difference_charts=[motion_chart(n, e, difference=True) for n, e in doc['motions'].items()],
        histograms=histogram_charts(doc),
    )  # fmt: skip
    return {'report.html': page}


def format_comparison(doc: Mapping[str, Any]) -> str:
    """Return the text for a terminal."""
    volume = doc['volume']
    within = '-' if volume['within'] is None else f'{100 * volume["within"]:.0f} %'
    a, b, change = (f'{1e6 * volume[f"mae_{k}"]:.2f} um' for k in ('a', 'b', 'difference'))
    lines = [
        f'a: {doc["a"]}',
        f'b: {doc["b"]}',
        f'{doc["convention"]}; {ROW_WORDS}.',
        '',
        *columns_to_text(HEAD, [error_row(n, e) for n, e in _errors(doc).items()]),
        *doc['remarks'],
        '',
        f'volume, {volume["points"]} points, without rigid motion: mean error a {a}, b {b}, '
        f'b - a {change}; E_n <= 1 for {within} of the components'
        + (', since neither source states an uncertainty' if within == '-' else ''),
    ]
    return '\n'.join(lines)
