# SPDX-License-Identifier: Apache-2.0
"""Coverage of the axes: how many samples lie where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otf_core.prediction.driven_volume import table_ranges
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.quantities import micro_unit, millimetres
from otf_core.reports.section import Picture, Section, Table

Array = NDArray[np.float64]

BINS = 20
MOVES = 0.1
"""Share of the direction of travel from which an axis counts as moving."""


def section(facts: Facts) -> Section:
    """Return the section."""
    low, high = table_ranges(facts.tables)
    rows, data = [], {}
    for k, axis in enumerate(facts.machine.axis_names):
        own = facts.machine.axes[axis]
        share = 100.0 * (high[k] - low[k]) / (own.max - own.min)
        rows.append((axis, f'{millimetres(own.min)} to {millimetres(own.max)}',
                     f'{millimetres(float(low[k]))} to {millimetres(float(high[k]))}',
                     f'{share:.0f}'))  # fmt: skip
        data[axis] = {'travel': [own.min, own.max], 'tables': [float(low[k]), float(high[k])]}
    words = (
        'Tables are constant beyond what was driven; what is predicted there is extrapolated.',
        f'Nodes of the tables: {spacing(facts)}.',
    )
    head = ('Axis', 'Travel (mm)', 'Covered by tables (mm)', 'Share (%)')
    table = Table(head, tuple(rows), numbers=(3,))
    return Section('coverage', 'Coverage of the axes', words, data, (table,),
                   draw=lambda: _pictures(facts))  # fmt: skip


def spacing(facts: Facts) -> str:
    """What lies between the nodes, in words."""
    result = facts.result
    part = '' if result.fraction == 1 else f' over {result.fraction}'
    cost = result.table_costs[result.fraction]
    return (
        f'table_pitch{part} apart; straight lines between them cost {1e6 * cost.grid:.2f} '
        f'{micro_unit("m")} on the grid'
    )


def _pictures(facts: Facts) -> Sequence[Picture]:
    caption = (
        'Samples used over the travel of each axis: all of them (grey), and those taken while the '
        'axis moved (blue).'
    )
    return [Picture(tuple(_panel(facts, k) for k in range(3)), caption, columns=3)]


def _panel(facts: Facts, k: int) -> str:
    runs, axis = facts.result.runs, facts.machine.axis_names[k]
    own = facts.machine.axes[axis]
    edges = 1e3 * np.linspace(own.min, own.max, BINS + 1)
    q = 1e3 * np.concatenate([run.q[:, k] for run in runs])
    count = np.concatenate([run.pieces.count for run in runs])
    moves = np.concatenate([np.abs(run.pieces.direction[:, k]) > MOVES for run in runs])
    total = np.histogram(q, edges, weights=count)[0] / 1e3
    moving = np.histogram(q[moves], edges, weights=count[moves])[0] / 1e3
    panel = Panel(
        Scale(edges[0], edges[-1], f'{axis} (mm)'), around(total, 'samples (thousands)', zero=True)
    )
    marks = [panel.columns(edges, total, 'noise'), panel.columns(edges, moving, 'after')]
    return panel.draw(marks, f'samples along {axis}', axis)
