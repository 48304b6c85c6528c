# SPDX-License-Identifier: Apache-2.0
"""Error in the volume: its size and direction, diagonals, and how far the axes were driven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from otf_core.arrays import Array
from otf_core.calibration.calibration_result import RunResult
from otf_core.files.writing import tidy
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import evenly_spread, without_rigid_motion
from otf_core.model.expanded import figure, micro_figure, micro_significant, significant
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.model.path import leg_bounds
from otf_core.prediction.driven_volume import table_ranges
from otf_core.prediction.volumetric import table_rows, table_values
from otf_core.reports.calibration_facts import CalibrationFacts
from otf_core.reports.drawing.panel import (
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
)
from otf_core.reports.page import Picture, Section, Table, micro

COMPONENT_BINS = 24
DIAGONAL_POINTS = 21
TRAVEL_BINS = 20
MOVING_SHARE = 0.1
"""Share of the longest travel on a leg, in ranges of the axes, from which an axis is moving."""
TURNS, PER_CELL = 7, 60
"""Positions of every rotary axis at which errors are stated, and of all axes at each."""
MARKS = {1: '+', -1: '\N{MINUS SIGN}'}


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
        f'Length of the error vector at {facts.points}, the best rigid motion removed. After '
        f'compensation with these tables their uncertainty remains; a '
        f'validation run after loading them would measure it.',
        f'The largest error, {micro_figure(first.error["max"], first.of_largest)}, has U = '
        f'{micro_significant(first.of_largest)}.',
    )
    data = {
        **first.to_dict(),
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
    largest = list(facts.result.headline.contributions.items())[:12]
    rows = [Bar(n, ((1e6 * v, 'before'),), f'{micro(v)} µm') for n, v in largest]
    adds = Picture(
        (bars(rows, 'contribution of each motion'),),
        'Root mean square over the volume of the error vector caused by one error alone; the '
        'largest ones. They partly cancel, so they do not add up.',
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
    """A diagonal between axis positions a and b, shape (k,), m and rad."""

    kind: str
    name: str
    a: Array
    b: Array


def diagonals(machine: Machine) -> list[Diagonal]:
    """Body diagonals, and face diagonals in the middle planes, of the linear axes.

    All of three axes, two of each pair; rotary axes stand at zero, or as near as they come.
    """
    low, high = machine.lower, machine.upper
    linear = [k for k, own in enumerate(machine.axes.values()) if not own.rotary]
    rest = np.where([a.rotary for a in machine.axes.values()], np.clip(0.0, low, high),
                    0.5 * (low + high))  # fmt: skip
    courses = []
    for size, kind in ((3, 'body'), (2, 'face')):
        for own in combinations(linear, size):
            for turns in product((1, -1), repeat=size - 1):
                sign = np.zeros(len(low), dtype=int)
                sign[list(own)] = (1, *turns)
                a = np.where(sign > 0, low, np.where(sign < 0, high, rest))
                b = np.where(sign > 0, high, np.where(sign < 0, low, rest))
                name = ' '.join(f'{MARKS[int(sign[k])]}{machine.axis_names[k]}' for k in own)
                courses.append(Diagonal(kind, name, a, b))
    return courses


def deviations(facts: CalibrationFacts, one: Diagonal) -> tuple[Array, Array]:
    """Deviation along a diagonal and its standard uncertainty, shape (DIAGONAL_POINTS,), m.

    Deviation at a point: the part of the error vector along the diagonal, less that at its start.
    No rigid motion changes it.
    """
    q = one.a + np.linspace(0.0, 1.0, DIAGONAL_POINTS)[:, None] * (one.b - one.a)
    ends = nominal_position(facts.tables.machine, q[[0, -1]])
    unit = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    rows = np.einsum('k,nkm->nm', unit, table_rows(facts.tables, q))
    rows = rows - rows[:1]
    variance = np.einsum('nm,nm->n', rows @ facts.result.covariance, rows)
    return rows @ table_values(facts.tables), np.sqrt(np.maximum(variance, 0.0))


def diagonals_section(facts: CalibrationFacts) -> Section | None:
    """Body and face diagonals as the tables predict them, in the manner of ISO 230-6."""
    rows, data, k = [], [], facts.result.headline.k
    for one in diagonals(facts.machine):
        value, u = deviations(facts, one)
        span, wide = float(np.ptp(value)), k * float(u[-1])
        length = float(np.linalg.norm(one.b - one.a))
        end, u_end = 1e6 * float(value[-1]), 1e6 * wide
        rows.append((one.kind, one.name, f'{1e3 * length:.0f}', figure(1e6 * span, u_end),
                     figure(end, u_end), significant(u_end)))  # fmt: skip
        data.append({'kind': one.kind, 'direction': one.name, 'length': length, 'span': span,
                     'end': float(value[-1]), 'U_end': wide})  # fmt: skip
    if not rows:
        return None
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


def turns_section(facts: CalibrationFacts) -> Section | None:
    """Mean error over the positions of the rotary axes, the linear ones anywhere."""
    machine, names = facts.machine, facts.machine.rotary_names
    if not names:
        return None
    low, high = table_ranges(facts.tables)
    columns = [machine.column(a) for a in names]
    ends = [np.linspace(low[k], high[k], TURNS) for k in columns]
    cells = np.stack([g.ravel() for g in np.meshgrid(*ends, indexing='ij')], axis=1)
    q = np.tile(evenly_spread(low, high, PER_CELL), (len(cells), 1))
    q[:, columns] = np.repeat(cells, PER_CELL, axis=0)
    free = without_rigid_motion(displacement(facts.tables, q), nominal_position(machine, q))
    sizes = 1e6 * np.linalg.norm(free, axis=1).reshape(len(cells), -1).mean(axis=1)
    angles = [[f'{v:.0f}' for v in np.degrees(own)] for own in ends]
    head: tuple[str, ...] = (f'{names[0]} (deg)', 'mean error (um)')
    if len(names) > 1:
        head = (f'{names[0]} \\ {names[1]} (deg)', *angles[1])
    grid = sizes.reshape(TURNS, -1)
    rows = tuple((a, *(f'{v:.1f}' for v in row)) for a, row in zip(angles[0], grid, strict=True))
    words = (
        f'Mean length of the error vector of the target (um) over {", ".join(names)}, the linear '
        f'axes anywhere in their driven ranges; the best rigid motion of the table is taken out.',
    )
    return Section('turns', 'Volumetric error over the rotary axes', words,
                   tables=(Table(head, rows, tuple(range(len(head)))),),
                   draw=lambda: _map(names, ends, sizes))  # fmt: skip


def _map(names: Sequence[str], ends: Sequence[Array], sizes: Array) -> Sequence[Picture]:
    """Mean errors (um) at the ends of both rotary axes, by colour; none for a single axis."""
    if len(names) == 1:
        return ()
    edges = [np.degrees([v[0], *(0.5 * (v[1:] + v[:-1])), v[-1]]) for v in ends]
    up, across = (
        Scale(float(own[0]), float(own[-1]), f'{name} (deg)')
        for name, own in zip(names, edges, strict=True)
    )
    step = heat_step(sizes)
    classes = heat_classes(sizes, step).reshape(TURNS, TURNS)
    panel, (y, x) = Panel(across, up), edges
    marks = [
        panel.band(x[k : k + 2], [y[i]] * 2, [y[i + 1]] * 2, f'heat h{classes[i, k]}')
        for i, k in np.ndindex(classes.shape)
    ]
    drawn = panel.draw(marks, f'mean error over {names[0]} and {names[1]}')
    key = heat_key(step, float(sizes.max()), 'µm')
    return (Picture((drawn,), 'The same by colour.', key=key),)


def coverage_section(facts: CalibrationFacts) -> Section:
    """Coverage of the axes: how many samples lie where."""
    low, high = table_ranges(facts.tables)
    rows, data = [], {}
    for k, (axis, own) in enumerate(facts.machine.axes.items()):
        (factor, unit), ends = own.shown, (float(low[k]), float(high[k]))
        share = 100.0 * (high[k] - low[k]) / (own.max - own.min)
        ranges = (f'{tidy(round(factor * a, 1)):g} to {tidy(round(factor * b, 1)):g}'
                  for a, b in ((own.min, own.max), ends))  # fmt: skip
        rows.append((f'{axis} ({unit})', *ranges, f'{share:.0f}'))
        data[axis] = {'travel': [own.min, own.max], 'tables': list(ends)}
    words = (
        'Outside the driven range the tables are constant; predictions there are extrapolated.',
        f'Nodes of the tables: {node_spacing(facts)}.',
    )
    table = Table(('Axis', 'Travel', 'Covered by tables', 'Share (%)'), tuple(rows), numbers=(3,))
    return Section('coverage', 'Coverage of the axes', words, data, (table,),
                   draw=lambda: _coverage_pictures(facts))  # fmt: skip


def node_spacing(facts: CalibrationFacts) -> str:
    """What lies between the nodes, in words."""
    result = facts.result
    part = '' if result.fraction == 1 else f' over {result.fraction}'
    words, cost = f'table_pitch{part} apart', result.table_costs.get(result.fraction)
    if cost is None:
        return words
    return f'{words}; straight lines between them cost {1e6 * cost.grid:.2f} um on the grid'


def _coverage_pictures(facts: CalibrationFacts) -> Sequence[Picture]:
    caption = (
        'Samples used over the travel of each axis: all of them (grey), and those taken while the '
        'axis moved (blue).'
    )
    moving = np.concatenate([_moving(facts, run) for run in facts.result.runs])
    panels = [_coverage_panel(facts, a, moving[:, k])
              for k, a in enumerate(facts.machine.axis_names)]  # fmt: skip
    return [Picture(tuple(panels), caption, columns=3)]


def _moving(facts: CalibrationFacts, run: RunResult) -> NDArray[np.bool_]:
    """Which axes travelled a good part of the leg of a piece, shape (p, k)."""
    moving = np.zeros(run.q.shape, dtype=bool)
    for a, b in leg_bounds(run.pieces.leg):
        share = np.ptp(run.q[a:b], axis=0) / (facts.machine.upper - facts.machine.lower)
        moving[a:b] = (share > MOVING_SHARE * share.max()) & (share > 0.0)
    return moving


def _coverage_panel(facts: CalibrationFacts, axis: str, moves: NDArray[np.bool_]) -> str:
    runs, own = facts.result.runs, facts.machine.axes[axis]
    factor, unit = own.shown
    edges = factor * np.linspace(own.min, own.max, TRAVEL_BINS + 1)
    q = factor * own.wrapped(np.concatenate([r.q[:, facts.machine.column(axis)] for r in runs]))
    count = np.concatenate([run.pieces.count for run in runs])
    total = np.histogram(q, edges, weights=count)[0] / 1e3
    moving = np.histogram(q[moves], edges, weights=count[moves])[0] / 1e3
    panel = Panel(
        Scale(edges[0], edges[-1], f'{axis} ({unit})'),
        scale_around(total, 'samples (thousands)', zero=True),
    )
    marks = [panel.columns(edges, total, 'noise'), panel.columns(edges, moving, 'after')]
    return panel.draw(marks, f'samples along {axis}', axis)
