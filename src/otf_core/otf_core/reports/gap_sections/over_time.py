# SPDX-License-Identifier: Apache-2.0
"""Residual against time, one dot a leg."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.result import Diagnosis
from otf_core.model.frames import XYZ
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.gap_pictures import key, states
from otf_core.reports.section import Picture, Section

Array = NDArray[np.float64]

MOST_RUNS = 3
"""Runs that are drawn."""
ACROSS, OBLIQUE = 0.9, 0.3
"""Share of an axis that lies across the path: legs that see it purely, legs that see it at all."""
ENOUGH = 0.2
"""Share of legs that see an axis purely from which the others are not drawn."""
LABEL = 'time since the start of the run (s)'


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    left = len(diagnosis.shown.views) - MOST_RUNS
    words = (f'{left} further runs are not drawn.',) if left > 0 else ()
    return Section('time', 'Against time', words, draw=lambda: _pictures(diagnosis))


def _pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views, causes = diagnosis.shown.views[:MOST_RUNS], bool(diagnosis.causes)
    found = []
    top = max(float(_sizes(v, getattr(v, n)).max()) for v in views for n, _ in _states(causes))
    for view in views:
        run = f' Run {view.name}.' if len(views) > 1 else ''
        caption = (
            'One dot a leg: root mean square of the residual, and its mean along the machine '
            f'axes, of legs across that axis.{run}'
        )
        parts = (_rms(view, causes, top), *(_along(view, causes, k) for k in range(3)))
        found.append(Picture(parts, caption, columns=2, key=key(diagnosis)))
    return found


def size_pictures(diagnosis: Diagnosis) -> Picture:
    """Size of the residual against time, without and with the causes side by side."""
    views, causes = diagnosis.shown.views[:MOST_RUNS], bool(diagnosis.causes)
    labels = dict(zip(('before', 'after'), (s.label for s in states(diagnosis)), strict=False))
    shown = _states(causes)
    top = max(float(_sizes(v, getattr(v, n)).max()) for v in views for n, _ in shown)
    parts = []
    for view in views:
        middle = np.array([view.time[a:b].mean() for a, b in view.bounds])
        run = f'{view.name}: ' if len(views) > 1 else ''
        for name, kind in shown:
            panel = Panel(_time(view), around([0.0, top], 'rms (µm)', zero=True))
            marks = [
                panel.line(middle, _sizes(view, view.expected), 'noise'),
                panel.dots(middle, _sizes(view, getattr(view, name)), f'{kind} node'),
            ]
            title = f'where it lies: residual of run {view.name} against time, {labels[kind]}'
            parts.append(panel.draw(marks, title, f'{run}{labels[kind]}'))
    caption = 'One dot a leg: root mean square of its residual; line: what noise leaves.'
    return Picture(tuple(parts), caption, columns=2, key=key(diagnosis))


def _states(causes: bool) -> list[tuple[str, str]]:
    names = [('residual_before', 'before')]
    return [*names, ('residual_after', 'after')] if causes else names


def _sizes(view: RunView, rows: Array) -> Array:
    square = np.sum(rows**2, axis=0)
    return np.asarray(1e6 * np.sqrt([square[a:b].mean() for a, b in view.bounds]))


def _time(view: RunView) -> Scale:
    return Scale(0.0, max(float(view.time.max()), 1e-3), LABEL)


def _rms(view: RunView, causes: bool, top: float) -> str:
    middle = np.array([view.time[a:b].mean() for a, b in view.bounds])
    panel = Panel(_time(view), around([0.0, top], 'rms (µm)', zero=True))
    marks = [panel.line(middle, _sizes(view, view.expected), 'noise')]
    for name, kind in _states(causes):
        marks.append(panel.dots(middle, _sizes(view, getattr(view, name)), f'{kind} node'))
    return panel.draw(marks, 'size of the residual against time', 'size')


def _along(view: RunView, causes: bool, axis: int) -> str:
    found = [(_leg_means(view, getattr(view, n), axis), kind) for n, kind in _states(causes)]
    values = np.concatenate([[0.0], *(part[1] for part, _ in found)])
    panel = Panel(_time(view), around(values, 'mean (µm)'))
    marks = [panel.level(0.0, 'soft')]
    marks += [panel.dots(*part, f'{kind} node') for part, kind in found]
    return panel.draw(marks, f'residual along {XYZ[axis]} against time', f'along {XYZ[axis]}')


def _leg_means(view: RunView, residual: Array, axis: int) -> tuple[Array, Array]:
    """Time, and mean displacement along an axis, um, of every leg that sees it."""
    rows = []
    for low, high in view.bounds:
        across = view.axes[:, low:high, axis]
        seen = float((across**2).sum()) / (high - low)
        value = float((across * residual[:, low:high]).sum()) / (high - low)
        rows.append((view.time[low:high].mean(), 1e6 * value, seen))
    table = np.array(rows)
    pure = table[:, 2] > ACROSS
    chosen = table[pure if pure.mean() > ENOUGH else table[:, 2] > OBLIQUE]
    return chosen[:, 0], chosen[:, 1]
