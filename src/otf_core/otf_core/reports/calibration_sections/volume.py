# SPDX-License-Identifier: Apache-2.0
"""The volumetric error in numbers, by direction, and what each motion adds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

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
    volume, k = facts.volume, facts.k_volume
    now, u = volume.sizes(), volume.u_sizes()
    rows = [
        ('as the machine stands, predicted by the tables', *map(micro, now.values())),
        ('expected after compensation: u, k = 1', *map(micro, u.values())),
        ('expected after compensation: U, 95 %', *(micro(k * v) for v in u.values())),
        ('measured after compensation', 'not measured', '', ''),
    ]
    largest = float(volume.u_length[int(np.argmax(volume.length))])
    words = (
        f'Length of the error vector on {len(volume.grid)} points of a regular grid over the '
        f'whole volume. After compensation with these tables their uncertainty remains, and '
        f'beyond what was driven that of what they cannot know; a validation run after loading '
        f'them would measure it.',
        f'The largest error, {micro(now["max"])} um, has U = {micro(k * largest)} um.',
    )
    data = {
        'points': len(volume.grid), 'before': now, 'u_after': u, 'k': k,
        'contributions': dict(contributions(facts)), 'U_of_largest': k * largest,
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
