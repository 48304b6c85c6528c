# SPDX-License-Identifier: Apache-2.0
"""Residual by frequency in time and by length of waves along each axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.bands import band_groups
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
    parts = [_panel(diagnosis, None, _edges(SLOWEST, 0.5 / float(np.median(steps))))]
    for k in range(3):
        length = max(float(np.ptp(v.q[:, k])) for v in views)
        if length > LONG:
            parts.append(_panel(diagnosis, k, _edges(1.0 / length, SHORTEST)))
    return [Picture(tuple(parts), CAPTION, columns=2, key=key(diagnosis))]


def _edges(low: float, high: float) -> Array:
    count = max(3, round(BANDS_PER_OCTAVE * np.log2(high / low)))
    return np.geomspace(low, high, count)


def _panel(diagnosis: Diagnosis, axis: int | None, edges: Array) -> str:
    """Root mean square by band, per half octave."""
    own = '' if axis is None else diagnosis.shown.views[0].axis_names[axis]
    name = f'length of waves along {own} (mm)' if own else 'frequency (Hz)'
    heading = f'along {own}' if own else 'in time'
    labels = [str(k) for k in range(len(edges) + 1)]
    ratio = float(np.sqrt(edges[1] / edges[0]))
    lines: list[tuple[Array, Array, str]] = []
    for state in states(diagnosis):
        found = band_groups(diagnosis.shown.views, state.residuals, axis, edges, labels)
        inner = [g for g in found if int(g.label) < len(edges)]
        middle = np.array([float(edges[int(g.label)]) / ratio for g in inner])
        middle = middle if axis is None else 1e3 / middle
        if not lines:
            lines.append((middle, np.array([1e6 * g.expected for g in inner]), 'noise'))
        lines.append((middle, np.array([1e6 * g.rms for g in inner]), state.kind))
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
