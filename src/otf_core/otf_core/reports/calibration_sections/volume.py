# SPDX-License-Identifier: Apache-2.0
"""The volumetric error in numbers, by direction, and what each motion adds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from otf_core.model.expanded import figure, micro_figure, micro_significant, significant
from otf_core.model.frames import XYZ
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.calibration_sections.overview import contributions
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.quantities import micro
from otf_core.reports.section import Picture, Section, Table

Array = NDArray[np.float64]

BINS = 24


def section(facts: Facts) -> Section:
    """Return the section."""
    first = facts.result.headline
    wide = first.expanded
    rows = [
        (
            'as the machine stands, predicted by the tables',
            *(figure(1e6 * v, 1e6 * wide[n]) for n, v in first.error.items()),
        ),
        (
            f'expected after compensation: U, k = {first.k:.3g}, {first.label}',
            *(significant(1e6 * v) for v in wide.values()),
        ),
        (
            'of it noise and misfit of this run alone: U',
            *(significant(1e6 * v) for v in first.observed.values()),
        ),
        ('measured after compensation', 'not measured', '', ''),
    ]
    words = (
        f'Length of the error vector on {first.points} points of a regular grid over the '
        f'whole volume. After compensation with these tables their uncertainty remains, and '
        f'beyond what was driven that of what they cannot know; a validation run after loading '
        f'them would measure it.',
        f'The largest error, {micro_figure(first.error["max"], first.of_largest)}, has U = '
        f'{micro_significant(first.of_largest)}.',
    )
    data = {
        **first.to_dict(), 'contributions': dict(contributions(facts)),
    }  # fmt: skip
    head = ('Volumetric error (um)', 'Mean', '95 % below', 'Largest')
    table = Table(head, tuple(rows), numbers=(1, 2, 3))
    return Section('volume', 'Volumetric error', words, data, (table,),
                   draw=lambda: _pictures(facts))  # fmt: skip


def _pictures(facts: Facts) -> Sequence[Picture]:
    spread = Picture(
        (*(_histogram(facts, k) for k in range(3)), *(_expected(facts, k) for k in range(3))),
        'Share of the grid points by the component of the error along X, Y and Z. Above: as the '
        'machine stands; below: distribution expected after compensation, from u.',
        columns=3,
        title='By direction',
    )
    found = contributions(facts)[:12]
    rows = [Bar(n, ((1e6 * v, 'before'),), f'{micro(v)} µm') for n, v in found]
    adds = Picture(
        (bars(rows, 'contribution of each motion'),),
        'Root mean square over the volume of the error vector that one motion or squareness error '
        'makes alone; the largest ones. They partly cancel, so they do not add up.',
        title='By motion',
    )
    return [adds, spread]


def _histogram(facts: Facts, axis: int) -> str:
    values = 1e6 * facts.volume.error[:, axis]
    reach = around(np.append(values, 0.0), f'd{XYZ[axis]} (µm)')
    edges = np.linspace(reach.low, reach.high, BINS + 1)
    return _columns(reach, edges, np.histogram(values, edges)[0] / len(values), 'before', axis)


def _expected(facts: Facts, axis: int) -> str:
    u = np.maximum(1e6 * facts.volume.u[:, axis], 1e-6)
    reach = around(3.0 * float(u.max()) * np.array([-1.0, 1.0]), f'd{XYZ[axis]} (µm)')
    edges = np.linspace(reach.low, reach.high, BINS + 1)
    return _columns(reach, edges, np.diff(ndtr(edges[:, None] / u).mean(axis=1)), 'after', axis)


def _columns(reach: Scale, edges: Array, share: Array, kind: str, axis: int) -> str:
    panel = Panel(reach, around(100.0 * share, 'share of points (%)', zero=True))
    when = 'as it stands' if kind == 'before' else 'expected after'
    heading = f'along {XYZ[axis]}, {when}'
    return panel.draw([panel.columns(edges, 100.0 * share, kind)], f'errors {heading}', heading)
