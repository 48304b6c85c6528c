# SPDX-License-Identifier: Apache-2.0
"""Residual against time, one dot a leg, without and with the causes."""

from __future__ import annotations

from typing import Any

import numpy as np

from otf_core.diagnosis.place.views import RunView
from otf_core.model.machine import AXES
from otf_core.reports.plots.figure import AFTER, BEFORE, NOISE, new_figure, quiet

ACROSS, OBLIQUE = 0.9, 0.3
"""Share of an axis that lies across the path: legs that see it purely, legs that see it at all."""
ENOUGH = 0.2
"""Share of legs that see an axis purely from which the others are not drawn."""


def _leg_means(view: RunView, residual: Any, axis: int) -> tuple[Any, Any]:
    """Time, and mean displacement along an axis of every leg that sees it."""
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


def draw_time(view: RunView, causes: bool) -> Any:
    """Figure of one run.

    Parameters
    ----------
    view : RunView
    causes : bool
        Show the residual with the causes too.
    """
    figure = new_figure(10, 6.2)
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(1.3, 1, 1, 1))
    middle = [view.time[a:b].mean() for a, b in view.bounds]

    def sizes(rows: Any) -> list[float]:
        return [1e6 * np.sqrt((rows[:, a:b] ** 2).sum(axis=0).mean()) for a, b in view.bounds]

    states = [(view.residual_before, BEFORE, 'without the causes' if causes else 'residual')]
    if causes:
        states.append((view.residual_after, AFTER, 'with the causes'))
    axes[0].plot(middle, sizes(view.expected), '-', color=NOISE, lw=1.2, label='noise expected')
    for residual, colour, label in states:
        axes[0].plot(middle, sizes(residual), 'o', ms=3, color=colour, label=label)
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel('rms (µm)')
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc='outside upper center', ncols=3, frameon=False)
    for k, name in enumerate(AXES):
        axes[k + 1].axhline(0.0, color=NOISE, lw=0.8)
        for residual, colour, _ in states:
            axes[k + 1].plot(*_leg_means(view, residual, k), 'o', ms=2.5, color=colour)
        axes[k + 1].set_ylabel(f'along {name} (µm)')
    axes[-1].set_xlabel('time since the start of the run (s)')
    figure.align_ylabels(axes)
    for one in axes:
        quiet(one)
    return figure
