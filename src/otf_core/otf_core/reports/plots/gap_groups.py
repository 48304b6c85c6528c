# SPDX-License-Identifier: Apache-2.0
"""Residual by groups of path pieces, as bars, and by frequency, as steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from otf_core.diagnosis.place import groupings as by
from otf_core.diagnosis.place.bands import band_groups
from otf_core.diagnosis.place.groups import Group, partition
from otf_core.diagnosis.place.views import RunView
from otf_core.model.machine import AXES
from otf_core.reports.plots.figure import AFTER, BEFORE, NOISE, new_figure, quiet

BANDS_PER_OCTAVE = 2
TICKS = [m * 10.0**k for k in range(-2, 4) for m in (1, 2, 5)]


def _states(views: Sequence[RunView], causes: bool) -> list[tuple[str, str, list[Any]]]:
    """Label, colour and residuals without and, if there are causes, with them."""
    label = 'without the causes' if causes else 'residual'
    states = [(label, BEFORE, [v.residual_before for v in views])]
    if causes:
        states.append(('with the causes', AFTER, [v.residual_after for v in views]))
    return states


def _bars(axes: Any, groups: Sequence[Sequence[Group]], colours: Sequence[str]) -> None:
    place = np.arange(len(groups[0]))
    height = 0.8 / len(groups)
    for k, (part, colour) in enumerate(zip(groups, colours, strict=True)):
        shift = (k - 0.5 * (len(groups) - 1)) * height
        size = [1e6 * g.rms for g in part]
        axes.barh(place + shift, size, height=0.9 * height, color=colour)
    expected = [1e6 * g.expected for g in groups[0]]
    axes.plot(expected, place, '|', ms=14, mew=1.6, color='black')
    axes.set_yticks(place, [g.label for g in groups[0]])
    axes.invert_yaxis()
    axes.set_xlabel('rms (µm)')
    quiet(axes)
    axes.tick_params(axis='y', length=0)


def _legend(figure: Any, views: Sequence[RunView], causes: bool, line: bool = False) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(color=c, label=name) for name, c, _ in _states(views, causes)]
    if line:
        handles.append(Line2D([], [], color=NOISE, label='noise expected'))
    else:
        tick: dict[str, Any] = {'marker': '|', 'ms': 12, 'mew': 1.6, 'color': 'black'}
        handles.append(Line2D([], [], ls='', label='noise expected', **tick))
    figure.legend(handles=handles, loc='outside upper center', ncols=3, frameon=False)


def _draw(views: Sequence[RunView], causes: bool, columns: Sequence[Sequence[by.Grouping]]) -> Any:
    states = _states(views, causes)
    drawn = [
        [
            [g for p in parts for g in partition(views, p.indices, p.labels, p.kind, residuals)]
            for _, _, residuals in states
        ]
        for parts in columns
    ]
    rows = max(len(groups[0]) for groups in drawn)
    figure = new_figure(10, 1.0 + 0.3 * rows)
    columns_drawn = figure.subplots(1, len(columns), squeeze=False)[0]
    for one, groups in zip(columns_drawn, drawn, strict=True):
        _bars(one, groups, [colour for _, colour, _ in states])
    right = max(one.get_xlim()[1] for one in columns_drawn)
    for one in columns_drawn:
        one.set_xlim(0.0, right)
    _legend(figure, views, causes)
    return figure


def draw_travel(views: Sequence[RunView], causes: bool) -> Any:
    """Figure by line, sense of travel and feed."""
    lines = [by.by_line(views), by.by_feed(views)]
    return _draw(views, causes, [lines, [by.by_sense(views, k) for k in range(3)]])


def draw_beam(views: Sequence[RunView], causes: bool) -> Any:
    """Figure by length, azimuth and elevation of the beam."""
    angles = [by.by_azimuth(views, 4), by.by_elevation(views, 4)]
    return _draw(views, causes, [[by.by_distance(views, 8)], angles])


def _edges(low: float, high: float) -> Any:
    count = max(3, round(BANDS_PER_OCTAVE * np.log2(high / low)))
    return np.geomspace(low, high, count)


def _steps(
    axes: Any, views: Sequence[RunView], causes: bool, axis: int | None, edges: Any
) -> None:
    """Root mean square by band, per half octave."""
    labels = [str(k) for k in range(len(edges) + 1)]
    for number, (_, colour, residuals) in enumerate(_states(views, causes)):
        found = band_groups(views, residuals, axis, edges, labels)
        inner = [g for g in found if int(g.label) < len(edges)]
        ratio = np.sqrt(edges[1] / edges[0])
        middle = [float(edges[int(g.label)] / ratio) for g in inner]
        if axis is not None:
            middle = [1e3 / m for m in middle]
        axes.plot(middle, [1e6 * g.rms for g in inner], 'o-', ms=3.5, lw=1.5, color=colour)
        if number == 0:
            axes.plot(middle, [1e6 * g.expected for g in inner], '-', lw=1.5, color=NOISE)
    axes.set_xscale('log')
    low, high = axes.get_xlim()
    ticks = [t for t in TICKS if low <= t <= high]
    axes.set_xticks(ticks, [f'{t:g}' for t in ticks])
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0)
    quiet(axes)


def draw_frequency(views: Sequence[RunView], causes: bool) -> Any:
    """Figure by frequency in time and by length of waves along each axis."""
    figure = new_figure(10, 5.4)
    axes = figure.subplots(2, 2)
    steps = np.concatenate([np.diff(v.time[a:b]) for v in views for a, b in v.bounds if b - a > 1])
    _steps(axes[0, 0], views, causes, None, _edges(0.2, 0.5 / float(np.median(steps))))
    axes[0, 0].set_xlabel('frequency (Hz)')
    for k, (name, one) in enumerate(zip(AXES, axes.flat[1:], strict=True)):
        length = max(float(np.ptp(v.q[:, k])) for v in views)
        if length > 0.05:
            _steps(one, views, causes, k, _edges(1.0 / length, 80.0))
        one.set_xlabel(f'length of waves along {name} (mm)')
    for one in axes[:, 0]:
        one.set_ylabel('rms per half octave (µm)')
    _legend(figure, views, causes, line=True)
    return figure
