# SPDX-License-Identifier: Apache-2.0
"""The path with what the tables leave: in space and over time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.result import RunResult
from otf_core.model.path import leg_bounds
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_pictures import trackers
from otf_core.reports.drawing.heat import LEVELS, heat_classes, heat_key, heat_step
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.drawing.scene import TURNED, Dots, Item, Strokes, box, scene
from otf_core.reports.quantities import micro
from otf_core.reports.section import Picture, Section

Array = NDArray[np.float64]

MOST_RUNS = 3
"""Runs that are drawn."""
STRETCHES = 900
"""Parts of a path that are drawn in space."""


def section(facts: Facts) -> Section:
    """Return the section."""
    fit = facts.result.fit
    words = (
        f'Mean distance of the measured track from the path: {micro(fit.path_mae_before)} um '
        f'after aligning it, {micro(fit.path_mae_after)} um after compensation; root mean square '
        f'of what is left {micro(fit.residual_rms)} um. These are the data the tables were '
        f'fitted to.',
    )
    data = {'mae_before': fit.path_mae_before, 'mae_after': fit.path_mae_after,
            'residual_rms': fit.residual_rms}  # fmt: skip
    return Section('path', 'Path and residuals', words, data,
                   draw=lambda: _pictures(facts))  # fmt: skip


def _pictures(facts: Facts) -> Sequence[Picture]:
    runs = facts.result.runs
    found = []
    for number, run in enumerate(runs[:MOST_RUNS], start=1):
        name = f'Run {number}. ' if len(runs) > 1 else ''
        space = Picture(
            (_space(facts, run),),
            f'{name}Path coloured by the length of the residual across it, after compensation.',
            hint=TURNED,
            title='In space' if number == 1 else '',
        )
        time = Picture(
            _time(run),
            f'{name}One dot a leg of the path: root mean square distance from the path, aligned '
            f'(left) and compensated (right).',
            columns=2,
            title='Over time' if number == 1 else '',
        )
        found += [space, time]
    if len(runs) > MOST_RUNS:
        found.append(Picture((), f'{len(runs) - MOST_RUNS} further runs are not drawn.'))
    return found


def _space(facts: Facts, run: RunResult) -> str:
    low, high = facts.machine.lower, facts.machine.upper
    length = 1e6 * np.linalg.norm(run.residual, axis=0)
    items: list[Item] = [*box(low, high), *trackers(facts)]
    if run.pieces.standstill:
        size, points, ends = length, run.q, None
    else:
        size, ends = _stretches(run, length)
        points = ends[:, 0]
    step = heat_step(size)
    classes = heat_classes(size, step)
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            kind = f'heat h{level}'
            items.append(Dots(kind, points[own]) if ends is None else Strokes(kind, ends[own]))
    key = heat_key(step, float(size.max()), 'µm')
    return scene(items, low, high, 'path in space, coloured by the residual') + key


def _stretches(run: RunResult, length: Array) -> tuple[Array, Array]:
    """Root mean square residual and ends, (n, 2, 3), of parts of legs."""
    bounds = leg_bounds(run.pieces.leg)
    share = max(1, round(len(length) / STRETCHES))
    sizes, ends = [], []
    for a, b in bounds:
        cuts = np.linspace(a, b, max(1, (b - a) // share) + 1).astype(int)
        for c, d in pairwise(cuts):
            sizes.append(np.sqrt(np.mean(length[c:d] ** 2)))
            ends.append((run.q[c], run.q[min(d, b - 1)]))
    return np.array(sizes), np.array(ends)


def _time(run: RunResult) -> tuple[str, ...]:
    bounds = leg_bounds(run.pieces.leg)
    middle = np.array([run.pieces.time[a:b].mean() for a, b in bounds])
    along = Scale(0.0, max(float(run.pieces.time.max()), 1e-3), 'time since the first sample (s)')
    panels = []
    for values, kind, what in (
        (run.aligned, 'before', 'before compensation'),
        (run.residual, 'after', 'after compensation'),
    ):
        square = np.sum(values**2, axis=0)
        rms = 1e6 * np.sqrt([square[a:b].mean() for a, b in bounds])
        panel = Panel(along, around(rms, 'rms of a leg (µm)', zero=True))
        panels.append(panel.draw([panel.dots(middle, rms, kind)], f'residual {what}', what))
    return tuple(panels)
