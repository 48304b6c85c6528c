# SPDX-License-Identifier: Apache-2.0
"""Residual by frequency in time and by length of waves along each axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.bands import Bands, band_groups
from otf_core.diagnosis.place.groups import Group
from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.result import Diagnosis
from otf_core.reports.drawing.panel import Panel, words
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.gap_pictures import key, states
from otf_core.reports.section import Picture, Section

Array = NDArray[np.float64]

BANDS_PER_OCTAVE = 2
SLOWEST, SHORTEST = 0.2, 80.0
"""Hz; waves per m."""
LONG = 0.05
"""m; shorter axes show no waves."""
CAPTION = (
    'Within legs: along time, and along the position of each axis on the legs that move it. The '
    'point at the slow end holds all that is slower, means of legs included; means over path '
    'pieces hide what is shorter than two pieces.'
)


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    return Section('frequency', 'By frequency', draw=lambda: _pictures(diagnosis))


def _pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    steps = np.concatenate([np.diff(v.time[a:b]) for v in views for a, b in v.bounds if b - a > 1])
    bands = [_bands(None, SLOWEST, 0.5 / float(np.median(steps)))]
    for k in range(3):
        length = max(float(np.ptp(v.q[:, k])) for v in views)
        if length > LONG:
            bands.append(_bands(k, 1.0 / length, SHORTEST))
    shown = states(diagnosis)
    groups = zip(*band_groups(views, [s.residuals for s in shown], bands), strict=True)
    kinds = [state.kind for state in shown]
    parts = (
        _panel(views[0], own, dict(zip(kinds, found, strict=True)))
        for own, found in zip(bands, groups, strict=True)
    )
    return [Picture(tuple(parts), CAPTION, columns=2, key=key(diagnosis))]


def _bands(axis: int | None, low: float, high: float) -> Bands:
    count = max(3, round(BANDS_PER_OCTAVE * np.log2(high / low)))
    return Bands(axis, np.geomspace(low, high, count), [str(k) for k in range(count + 1)])


def _panel(view: RunView, bands: Bands, found: Mapping[str, Sequence[Group]]) -> str:
    """Root mean square by band, per half octave, of every kind of state."""
    own = '' if bands.axis is None else view.axis_names[bands.axis]
    name = f'length of waves along {own} (mm)' if own else 'frequency (Hz)'
    heading = f'along {own}' if own else 'in time'
    edges = bands.edges
    ratio = float(np.sqrt(edges[1] / edges[0]))
    lines: list[tuple[Array, Array, str]] = []
    for kind, groups in found.items():
        inner = [g for g in groups if int(g.label) < len(edges)]
        middle = np.array([float(edges[int(g.label)]) / ratio for g in inner])
        middle = 1e3 / middle if own else middle
        if not lines:
            lines.append((middle, np.array([1e6 * g.expected for g in inner]), 'noise'))
        lines.append((middle, np.array([1e6 * g.rms for g in inner]), kind))
    reach = np.concatenate([line[0] for line in lines])
    if not reach.size:
        return Panel(Scale(0.0, 1.0, name, marks=1), Scale(0.0, 1.0, '', marks=1)).draw(
            [words(190.0, 100.0, 'no leg is long enough', 'middle soft')], heading, heading
        )
    x = Scale(float(reach.min()) / 1.1, float(reach.max()) * 1.1, name, logarithmic=True)
    y = around(np.concatenate([line[1] for line in lines]), 'rms per half octave (µm)', zero=True)
    panel = Panel(x, y)
    marks = [panel.line(*line) for line in lines]
    marks += [panel.dots(a, b, f'{kind} node') for a, b, kind in lines[1:]]
    return panel.draw(marks, f'residual by {name}', heading)
