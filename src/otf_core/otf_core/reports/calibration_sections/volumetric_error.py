# SPDX-License-Identifier: Apache-2.0
"""Error in the volume: its size and direction, diagonals, and how far the axes were driven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from otf_core.arrays import Array
from otf_core.model.expanded import figure, micro_figure, micro_significant, significant
from otf_core.model.frames import XYZ
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.volumetric import table_rows, table_values
from otf_core.reports.calibration_facts import CalibrationFacts
from otf_core.reports.calibration_sections.first_screen import contributions
from otf_core.reports.drawing.panel import Bar, Panel, Scale, bars, scale_around
from otf_core.reports.page import Picture, Section, Table, micro, micro_unit, millimetres

COMPONENT_BINS = 24
DIAGONAL_POINTS = 21
TRAVEL_BINS = 20
MOVING_SHARE = 0.1
"""Share of the direction of travel from which an axis counts as moving."""


def volume_section(facts: CalibrationFacts) -> Section:
    """The volumetric error in numbers, by direction, and what each motion adds."""
    first = facts.result.headline
    wide = first.expanded
    rows = [
        (
            'as found, predicted by the tables',
            *(figure(1e6 * v, 1e6 * wide[n]) for n, v in first.error.items()),
        ),
        (
            f'expected after compensation: U, k = {first.k:.3g}, {first.label}',
            *(significant(1e6 * v) for v in wide.values()),
        ),
        (
            'of which noise and misfit of this run: U',
            *(significant(1e6 * v) for v in first.observed.values()),
        ),
        ('measured after compensation', 'not measured', '', ''),
    ]
    words = (
        f'Length of the error vector on {first.points} points of a regular grid over the '
        f'driven volume. After compensation with these tables their uncertainty remains; a '
        f'validation run after loading them would measure it.',
        f'The largest error, {micro_figure(first.error["max"], first.of_largest)}, has U = '
        f'{micro_significant(first.of_largest)}.',
    )
    data = {
        **first.to_dict(), 'contributions': dict(contributions(facts)),
    }  # fmt: skip
    head = ('Volumetric error (um)', 'Mean', '95 % below', 'Largest')
    table = Table(head, tuple(rows), numbers=(1, 2, 3))
    return Section('volume', 'Volumetric error', words, data, (table,),
                   draw=lambda: _volume_pictures(facts))  # fmt: skip


def _volume_pictures(facts: CalibrationFacts) -> Sequence[Picture]:
    spread = Picture(
        (
            *(_component_histogram(facts, k) for k in range(3)),
            *(_expected_distribution(facts, k) for k in range(3)),
        ),
        'Share of the grid points by the component of the error along X, Y and Z. Above: as found;'
        ' below: distribution expected after compensation, from u.',
        columns=3,
        title='By direction',
    )
    largest = contributions(facts)[:12]
    rows = [Bar(n, ((1e6 * v, 'before'),), f'{micro(v)} µm') for n, v in largest]
    adds = Picture(
        (bars(rows, 'contribution of each motion'),),
        'Root mean square over the volume of the error vector caused by one motion or '
        'squareness error alone; the largest ones. They partly cancel, so they do not add up.',
        title='By motion',
    )
    return [adds, spread]


def _component_histogram(facts: CalibrationFacts, axis: int) -> str:
    values = 1e6 * facts.volume.error[:, axis]
    reach = scale_around(np.append(values, 0.0), f'd{XYZ[axis]} (µm)')
    edges = np.linspace(reach.low, reach.high, COMPONENT_BINS + 1)
    return _component_panel(
        reach, edges, np.histogram(values, edges)[0] / len(values), 'before', axis
    )


def _expected_distribution(facts: CalibrationFacts, axis: int) -> str:
    u = np.maximum(1e6 * facts.volume.u[:, axis], 1e-6)
    reach = scale_around(3.0 * float(u.max()) * np.array([-1.0, 1.0]), f'd{XYZ[axis]} (µm)')
    edges = np.linspace(reach.low, reach.high, COMPONENT_BINS + 1)
    return _component_panel(
        reach, edges, np.diff(ndtr(edges[:, None] / u).mean(axis=1)), 'after', axis
    )


def _component_panel(reach: Scale, edges: Array, share: Array, kind: str, axis: int) -> str:
    panel = Panel(reach, scale_around(100.0 * share, 'share of points (%)', zero=True))
    when = 'as it stands' if kind == 'before' else 'expected after'
    heading = f'along {XYZ[axis]}, {when}'
    return panel.draw([panel.columns(edges, 100.0 * share, kind)], f'errors {heading}', heading)


@dataclass(frozen=True)
class Diagonal:
    """A diagonal from a to b, shape (3,), m."""

    kind: str
    name: str
    a: Array
    b: Array


def diagonals(low: Array, high: Array) -> list[Diagonal]:
    """Four body diagonals and six face diagonals, two in the middle plane of each pair of axes."""
    courses = []
    for y, z in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        sign = np.array([1, y, z])
        ends = np.where(sign > 0, low, high), np.where(sign > 0, high, low)
        courses.append(Diagonal('body', _direction_name(sign), *ends))
    for one, two in combinations(range(3), 2):
        for turn in (1, -1):
            sign = np.zeros(3, dtype=int)
            sign[one], sign[two] = 1, turn
            middle = 0.5 * (low + high)
            a = np.where(sign > 0, low, np.where(sign < 0, high, middle))
            b = np.where(sign > 0, high, np.where(sign < 0, low, middle))
            courses.append(Diagonal('face', _direction_name(sign), a, b))
    return courses


def _direction_name(sign: NDArray[np.int64]) -> str:
    marks = {1: '+', -1: '\N{MINUS SIGN}'}
    return ' '.join(f'{marks[int(s)]}{axis}' for s, axis in zip(sign, XYZ, strict=True) if s)


def deviations(facts: CalibrationFacts, one: Diagonal) -> tuple[Array, Array]:
    """Deviation along a diagonal and its standard uncertainty, shape (DIAGONAL_POINTS,), m.

    Deviation at a point: the part of the error vector along the diagonal, less that at its start.
    No rigid motion changes it.
    """
    q = one.a + np.linspace(0.0, 1.0, DIAGONAL_POINTS)[:, None] * (one.b - one.a)
    unit = (one.b - one.a) / np.linalg.norm(one.b - one.a)
    rows = np.einsum('k,nkm->nm', unit, table_rows(facts.tables, q))
    rows = rows - rows[:1]
    variance = np.einsum('nm,nm->n', rows @ facts.result.covariance, rows)
    return rows @ table_values(facts.tables), np.sqrt(np.maximum(variance, 0.0))


def diagonals_section(facts: CalibrationFacts) -> Section:
    """Body and face diagonals as the tables predict them, in the manner of ISO 230-6."""
    rows, data, k = [], [], facts.k_volume
    for one in diagonals(facts.machine.lower, facts.machine.upper):
        value, u = deviations(facts, one)
        span, wide = float(np.ptp(value)), k * float(u[-1])
        length = float(np.linalg.norm(one.b - one.a))
        end, u_end = 1e6 * float(value[-1]), 1e6 * wide
        rows.append((one.kind, one.name, f'{1e3 * length:.0f}', figure(1e6 * span, u_end),
                     figure(end, u_end), significant(u_end)))  # fmt: skip
        data.append({'kind': one.kind, 'direction': one.name, 'length': length, 'span': span,
                     'end': float(value[-1]), 'U_end': wide})  # fmt: skip
    words = (
        'Predicted from the error tables, not measured along the diagonals: deviation along each '
        'diagonal from its start. Face diagonals lie in the middle planes of the volume.',
    )
    head = (
        'Predicted',
        'Direction',
        'Length (mm)',
        'Span (um)',
        'At the end (um)',
        'U, 95 % (um)',
    )
    table = Table(head, tuple(rows), numbers=(2, 3, 4, 5))
    return Section('diagonals', 'Diagonals, predicted', words, {'predicted': data}, (table,))


def coverage_section(facts: CalibrationFacts) -> Section:
    """Coverage of the axes: how many samples lie where."""
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
        'Outside the driven range the tables are constant; predictions there are extrapolated.',
        f'Nodes of the tables: {node_spacing(facts)}.',
    )
    head = ('Axis', 'Travel (mm)', 'Covered by tables (mm)', 'Share (%)')
    table = Table(head, tuple(rows), numbers=(3,))
    return Section('coverage', 'Coverage of the axes', words, data, (table,),
                   draw=lambda: _coverage_pictures(facts))  # fmt: skip


def node_spacing(facts: CalibrationFacts) -> str:
    """What lies between the nodes, in words."""
    result = facts.result
    part = '' if result.fraction == 1 else f' over {result.fraction}'
    cost = result.table_costs[result.fraction]
    return (
        f'table_pitch{part} apart; straight lines between them cost {1e6 * cost.grid:.2f} '
        f'{micro_unit("m")} on the grid'
    )


def _coverage_pictures(facts: CalibrationFacts) -> Sequence[Picture]:
    caption = (
        'Samples used over the travel of each axis: all of them (grey), and those taken while the '
        'axis moved (blue).'
    )
    return [Picture(tuple(_coverage_panel(facts, k) for k in range(3)), caption, columns=3)]


def _coverage_panel(facts: CalibrationFacts, k: int) -> str:
    runs, axis = facts.result.runs, facts.machine.axis_names[k]
    own = facts.machine.axes[axis]
    edges = 1e3 * np.linspace(own.min, own.max, TRAVEL_BINS + 1)
    q = 1e3 * np.concatenate([run.q[:, k] for run in runs])
    count = np.concatenate([run.pieces.count for run in runs])
    moves = np.concatenate([np.abs(run.pieces.direction[:, k]) > MOVING_SHARE for run in runs])
    total = np.histogram(q, edges, weights=count)[0] / 1e3
    moving = np.histogram(q[moves], edges, weights=count[moves])[0] / 1e3
    panel = Panel(
        Scale(edges[0], edges[-1], f'{axis} (mm)'),
        scale_around(total, 'samples (thousands)', zero=True),
    )
    marks = [panel.columns(edges, total, 'noise'), panel.columns(edges, moving, 'after')]
    return panel.draw(marks, f'samples along {axis}', axis)
