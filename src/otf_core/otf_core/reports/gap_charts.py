# SPDX-License-Identifier: Apache-2.0
"""Residuals of a gap.json in charts: by time, place, travel, beam and frequency, and functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from otf_core.diagnosis.cause_parameters import SCALES, at_words
from otf_core.diagnosis.place.placement import TIME, VOLUME
from otf_core.diagnosis.place.views import separating_plane
from otf_core.effects.inputs import label_of
from otf_core.files.message_text import join_names
from otf_core.model.frames import XYZ
from otf_core.reports.charts import (
    LETTER,
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
    words,
)

KINDS = ('before', 'after')
DRAWN_RUNS = 3
"""Runs that are drawn."""
ARROW_CELLS = 0.9
"""Length of the longest arrow, cells."""
VIEW_WIDTH, VIEW_HEIGHT = 274.0, 228.0
"""px; room for the cells."""
NAMES = 158.0
"""px; room for names of groups."""


def state_labels(doc: Mapping[str, Any]) -> list[str]:
    """What the residuals are called: without and, if there are causes, with them."""
    causes = doc['causes']
    named = 'cause' if len(causes) == 1 else 'causes'
    return [f'without the {named}', f'with the {named}'] if causes else ['residual']


def _bar(label: str, kind: str, row: Mapping[str, Any]) -> Bar:
    size = row['rms'][KINDS.index(kind)]
    return Bar(label, ((size, kind),), f'{size:.2f} µm', row['expected'])


def group_chart(doc: Mapping[str, Any], name: str, title: str) -> str:
    """Bars of groups: without the causes, below it with them; strokes for the noise expected."""
    rows, kinds = doc['views']['groups'][name], KINDS[: len(state_labels(doc))]
    drawn = [_bar(row['label'] if kind == 'before' else '', kind, row)
             for row in rows for kind in kinds]  # fmt: skip
    return bars(drawn, title, names=NAMES)


def separating_charts(doc: Mapping[str, Any]) -> dict[str, Any]:
    """The view that separates the gap most, without and with the causes side by side."""
    view = doc['where']['view']
    rotary = [a for a, own in doc['machine']['axes'].items() if own.get('kind') == 'rotary']
    if view == TIME and len(doc['views']['legs']) == 1:
        return {'charts': size_charts(doc), 'key': 'noise', 'caption':
                'One dot per leg: root mean square of its residual; line: contribution of '
                'noise.'}  # fmt: skip
    if view == VOLUME and not rotary:
        return volume_charts(doc, [separating_plane(doc['where'], XYZ)])
    kind = doc['views']['kind']
    rows, labels = doc['views']['groups']['separating'], state_labels(doc)

    def named(label: str) -> str:
        if kind != 'lines':
            return label
        return f'line along {label}' if len(label) == 1 else f'diagonal {label}'

    drawn = [[_bar(named(row['label']), own, row) for row in rows]
             for own in KINDS[: len(labels)]]  # fmt: skip
    every = [bar for own in drawn for bar in own]
    names = 12.0 + LETTER * max(len(bar.name) for bar in every)
    charts = [bars(own, f'where it lies: {kind}, {label}', names=names, beside=every,
                   heading=label) for own, label in zip(drawn, labels, strict=True)]  # fmt: skip
    by = 'the axes that move' if kind == 'lines' else kind
    return {'charts': charts, 'key': 'stroke', 'caption':
            f'Root mean square of the residual by {by}; mark: contribution of noise.'}  # fmt: skip


def _time_panel(leg: Mapping[str, Any], scale: Scale) -> Panel:
    return Panel(Scale(0.0, max(leg['duration'], 1e-3), 'time since the start of the run (s)'),
                 scale)  # fmt: skip


def _top(doc: Mapping[str, Any]) -> Scale:
    legs = doc['views']['legs'][:DRAWN_RUNS]
    return scale_around([0.0, max(max(own) for leg in legs for own in leg['rms'])], 'rms (µm)',
                        zero=True)  # fmt: skip


def size_charts(doc: Mapping[str, Any]) -> list[str]:
    """Size of the residual against time, without and with the causes side by side."""
    charts, legs = [], doc['views']['legs'][:DRAWN_RUNS]
    for leg in legs:
        panel, run = _time_panel(leg, _top(doc)), f'{leg["run"]}: ' if len(legs) > 1 else ''
        for rms, kind, label in zip(leg['rms'], KINDS, state_labels(doc), strict=False):
            marks = [panel.line(leg['time'], leg['expected'], 'noise'),
                     panel.dots(leg['time'], rms, f'{kind} node')]  # fmt: skip
            title = f'where it lies: residual of run {leg["run"]} against time, {label}'
            charts.append(panel.draw(marks, title, f'{run}{label}'))
    return charts


def time_charts(doc: Mapping[str, Any], leg: Mapping[str, Any]) -> list[str]:
    """Size and means of the residual of a run against time, one dot a leg."""
    panel = _time_panel(leg, _top(doc))
    marks = [panel.line(leg['time'], leg['expected'], 'noise')]
    marks += [panel.dots(leg['time'], rms, f'{kind} node')
              for rms, kind in zip(leg['rms'], KINDS, strict=False)]  # fmt: skip
    charts = [panel.draw(marks, 'size of the residual against time', 'size')]
    for axis, own in leg['means'].items():
        time = np.array(leg['time'])[own['leg']]
        panel = _time_panel(leg, scale_around(np.append(np.ravel(own['mean']), 0.0), 'mean (µm)'))
        marks = [panel.level(0.0, 'soft')]
        marks += [panel.dots(time, mean, f'{kind} node')
                  for mean, kind in zip(own['mean'], KINDS, strict=False)]  # fmt: skip
        charts.append(panel.draw(marks, f'residual along {axis} against time', f'along {axis}'))
    return charts


def volume_charts(doc: Mapping[str, Any], planes: Sequence[Sequence[str]] = ()) -> dict[str, Any]:
    """Views of the volume in some planes or all, without and with the causes at one scale."""
    shown = [v for v in doc['views']['cells'] if not planes or v['plane'] in list(planes)]
    every = [cells for view in shown for cells in view['states']]
    top = max(max(own['rms'], default=0.0) for own in every)
    longest = max(float(np.linalg.norm(np.reshape(own['mean'], (-1, 2)), axis=1).max(initial=0.0))
                  for own in every)  # fmt: skip
    step = heat_step(np.array([top]))
    charts = [
        _plane_chart(view, view['states'][k], step, longest, label)
        for k, label in enumerate(state_labels(doc))
        for view in shown
    ]
    across = join_names(next(a for a in XYZ if a not in view['plane']) for view in shown)
    return {
        'charts': charts,
        'key': heat_key(step, top, 'µm'),
        'columns': 3 if len(shown) > 1 else 2,
        'caption': f'The volume seen along {across}: colour is the root mean square of the '
        f'residual in cells of the view, arrows its mean; the longest arrow of all is '
        f'{longest:.2g} um.',
    }


def _plane_chart(
    view: Mapping[str, Any], cells: Mapping[str, Any], step: float, longest: float, label: str
) -> str:
    least, most = np.array(view['range'])
    middle, span = 0.5 * (least + most), most - least
    metre = max(float(span[0]) / VIEW_WIDTH, float(span[1]) / VIEW_HEIGHT, 1e-9) * 1.08
    half = 0.5 * metre * np.array([VIEW_WIDTH, VIEW_HEIGHT])
    low, high = 1e3 * (middle - half), 1e3 * (middle + half)
    across, up = (
        Scale(float(low[k]), float(high[k]), f'{view["plane"][k]} (mm)') for k in range(2)
    )
    panel = Panel(across, up, height=VIEW_HEIGHT + 62.0)
    corner, size = np.reshape(cells['low'], (-1, 2)), np.array(cells['size'])
    places = panel.points(1e3 * corner[:, 0], 1e3 * (corner[:, 1] + size[1]))
    wide, tall = size / metre
    marks = [
        f'<rect class="area heat h{level}" x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" '
        f'height="{tall:.1f}"/>'
        for (x, y), level in zip(places, heat_classes(np.array(cells['rms']), step), strict=True)
    ]
    reach = (
        0.5 * ARROW_CELLS * size.min() / max(longest, 1e-9) * np.reshape(cells['mean'], (-1, 2))
    )
    centre = corner + 0.5 * size
    marks.append(panel.arrows(1e3 * (centre - reach), 1e3 * (centre + reach), 'dark thin'))
    return panel.draw(marks, f'residual over {" and ".join(view["plane"])}, {label}', label)


def spectrum_chart(band: Mapping[str, Any]) -> str:
    """Root mean square by band, per half octave, without and with the causes."""
    axis = band['axis']
    name = f'wavelength along {axis} ({band["unit"]})' if axis else 'frequency (Hz)'
    heading = f'along {axis}' if axis else 'in time'
    at = np.array(band['at'])
    if not at.size:
        empty = Panel(Scale(0.0, 1.0, name, marks=1), Scale(0.0, 1.0, '', marks=1))
        marks = [words(190.0, 100.0, 'no leg is long enough', 'middle soft')]
        return empty.draw(marks, heading, heading)
    x = Scale(float(at.min()) / 1.1, float(at.max()) * 1.1, name, logarithmic=True)
    reach = np.concatenate([band['expected'], *band['rms']])
    panel = Panel(x, scale_around(reach, 'rms per half octave (µm)', zero=True))
    marks = [panel.line(at, band['expected'], 'noise')]
    for rms, kind in zip(band['rms'], KINDS, strict=False):
        marks += [panel.line(at, rms, kind), panel.dots(at, rms, f'{kind} node')]
    return panel.draw(marks, f'residual by {name}', heading)


def gap_chart(doc: Mapping[str, Any]) -> str:
    """Sizes of residuals and gap as bars."""
    gap = doc['gap']
    rows = [
        Bar(name, ((gap[key], kind),), f'{gap[key]:.2f} µm')
        for name, key, kind in (
            ('Residual of the run', 'measured_um', 'noise'),
            ('Residual of its simulation', 'simulated_um', 'noise'),
            ('Gap before', 'before_um', 'before'),
        )
    ]
    if doc['causes']:
        ends = [max(gap['before_um'] * (1.0 - s / 100.0), 0.0)
                for s in gap['shrink_interval_percent'][::-1]]  # fmt: skip
        rows.append(Bar('Gap after', ((gap['after_um'], 'after'),), f'{gap["after_um"]:.2f} µm',
                        ends=(ends[0], ends[1])))  # fmt: skip
    return bars(rows, 'sizes of residuals and gap', names=NAMES, width=440.0)


def curve_chart(curve: Mapping[str, Any]) -> str:
    """A function that the data determine, with its band."""
    factor, unit = SCALES.get(curve['unit'], (1.0, curve['unit']))
    metres = curve['input_unit'] == 'm'
    across, of_input = (1e3, 'mm') if metres else (1.0, curve['input_unit'])
    at, value = across * np.array(curve['at']), factor * np.array(curve['value'])
    wide, name = 2.0 * factor * np.array(curve['u']), label_of(curve['input'])
    ends = float(at[0]), max(float(at[-1]), float(at[0]) + 1e-9)
    panel = Panel(
        Scale(*ends, name + (f' ({of_input})' if of_input else '')),
        scale_around(np.concatenate([[0.0], value - wide, value + wide]),
                     unit.replace('u', 'µ', 1)),
    )  # fmt: skip
    marks = [
        panel.level(0.0, 'soft'),
        panel.band(at, value - wide, value + wide, 'after band'),
        panel.line(at, value, 'after'),
    ]
    held = ', '.join(at_words(n, v) for n, v in curve['held'].items())
    heading = f'{curve["term"]}, {held}' if held else curve['term']
    return panel.draw(marks, f'{curve["term"]} against {name}', heading)
