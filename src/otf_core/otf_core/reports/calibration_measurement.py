# SPDX-License-Identifier: Apache-2.0
"""Uncertainty and course of a calibration in charts and tables: budget, residuals, samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import gammaincc

from otf_core.arrays import Array
from otf_core.budget.budget import (
    EFFECTS,
    MISFIT,
    NOISE,
    PLACES,
    SMOOTHNESS,
    STRAIGHT,
    SYSTEMATIC,
    TYPICAL_SOURCE,
)
from otf_core.budget.lines import GRID
from otf_core.config import CalibrationConfig
from otf_core.files.message_text import join_names
from otf_core.model.expanded import (
    micro_unit,
    quantity,
    readable_unit,
)
from otf_core.model.frames import XYZ
from otf_core.model.machine import Machine
from otf_core.model.sections import (
    DECLARABLE,
    INSTRUMENT,
    NUMBERS,
    TEXTS,
)
from otf_core.prediction.volumetric import table_places
from otf_core.reports.calibration_errors import (
    Content,
    trackers,
)
from otf_core.reports.charts import (
    LEVELS,
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
    svg,
    words,
)
from otf_core.reports.rendering import dof_words, micro
from otf_core.reports.scene import (
    Dots,
    Item,
    Strokes,
    box,
    scene,
)

CELL_SIZE, NAME_WIDTH = 17.0, 42.0
"""px; size of a cell of the correlations, room for names."""
TYPE_A = (NOISE, MISFIT, SMOOTHNESS)
"""Evaluated from the observations (GUM 2.3.2); all others are type B."""
SHARED = {NOISE: 'within 1 s', MISFIT: 'along a line', SMOOTHNESS: 'between nodes', STRAIGHT: 'no',
          EFFECTS: 'yes, whole run'}  # fmt: skip
"""Over what a contribution is common to several observations."""


# Uncertainty: the budget by source, and correlations between the tables.


def used_sources(doc: Mapping[str, Any]) -> list[str]:
    """Sources that contribute to anything."""
    lines = doc['budget']['u_rms'].values()
    names = doc['budget']['u_rms'][GRID]['sources']
    return [n for n in names if any(line['sources'][n] for line in lines)]


def source_rows(content: Content) -> Iterator[tuple[str, ...]]:
    """Sources of the error vector in the volume: type, what is stated, sensitivity, share."""
    budget = content.doc['budget']
    grid = budget['u_rms'][GRID]
    for name, part in grid['sources'].items():
        if part > 0:
            share = 100.0 * part**2 / max(grid['u'] ** 2, 1e-300)
            yield (name, 'A' if name in TYPE_A else 'B', 'normal',
                   *_stated_source(content, name, part), micro(part, 3), f'{share:.1f}',
                   dof_words(budget['dof'].get(name)),
                   SHARED.get(name, 'yes, all observations'))  # fmt: skip


def _stated_source(content: Content, name: str, part: float) -> tuple[str, str]:
    """What machine.yaml states for a source, and what the volume gets per unit of it."""
    if name == TYPICAL_SOURCE:
        presets = (content.doc['typical_systematic'] or {}).get('presets', ())
        return f'typical: presets {join_names(presets)}', '-'
    if name == PLACES:
        return 'targets: u of every place', '-'
    keys = next((s.keys for s in SYSTEMATIC if s.source == name), ())
    declared = content.machine.uncertainty
    values = {k: declared.values[k] for k in keys if declared and declared.values.get(k)}
    if not values:
        return 'from the data', '-'
    stated = ', '.join(
        f'{key.replace("_", " ")} {quantity(value, None, DECLARABLE[key][0])}'
        for key, value in values.items()
    )
    if len(values) > 1:
        return stated, '-'
    (key, value), *_ = values.items()
    factor, unit = readable_unit(DECLARABLE[key][0], value)
    return stated, f'{1e6 * part / (factor * value):.3g} per {unit}'


def budget_charts(doc: Mapping[str, Any]) -> list[str]:
    """Every quantity as a bar: the share of a colour in it is its share of the variance."""
    rows: dict[str, list[Bar]] = {'m': [], 'rad': []}
    sources = used_sources(doc)
    for name, own in doc['budget']['u_rms'].items():
        shares = tuple((1e6 * own['sources'][n] ** 2 / max(own['u'], 1e-300), f'share s{k}')
                       for k, n in enumerate(sources))  # fmt: skip
        label = f'{micro(own["u"], 3)} {"µm" if own["unit"] == "m" else "µrad"}'
        rows[own['unit']].append(Bar('volume' if name == GRID else name, shares, label))
    return [bars(own, f'uncertainty in {micro_unit(unit)}', names=52.0)
            for unit, own in rows.items() if own]  # fmt: skip


def _correlation(covariance: Array) -> Array:
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(u > 1e-6 * u.max(initial=0.0), u, np.inf)
    return np.asarray(covariance / np.outer(unit, unit))


def correlation_chart(content: Content) -> str:
    """Largest correlation in size between the nodes of every two tables."""
    starts = [p.start for p in table_places(content.tables).values()]
    r = np.maximum.reduceat(np.abs(_correlation(content.covariance)), starts, axis=0)
    r = np.maximum.reduceat(r, starts, axis=1)
    names, marks = list(table_places(content.tables)), list[str]()
    for i, name in enumerate(names):
        y = NAME_WIDTH + i * CELL_SIZE
        marks.append(words(NAME_WIDTH - 4.0, y + 12.0, name, 'end'))
        marks.append(words(y + 12.0, NAME_WIDTH - 4.0, name, '', turned=True))
        for j in range(i):
            if not {name, names[j]} & content.hidden:
                marks.append(
                    f'<rect class="area heat h{int(min(r[i, j], 0.999) * 5)}" '
                    f'x="{NAME_WIDTH + j * CELL_SIZE:.0f}" y="{y:.0f}" '
                    f'width="{CELL_SIZE - 1:.0f}" height="{CELL_SIZE - 1:.0f}"/>'
                )
    size = NAME_WIDTH + len(names) * CELL_SIZE + 6.0
    return svg(size, size, marks, 'largest correlation between tables')


# The measurement: conditions, residuals, samples, drift, fit.


def stated_tables(machine: Machine) -> dict[str, Any]:
    """Titles and rows of what machine.yaml states, and what it does not."""
    given, tracker = machine.stated, machine.tracker
    instrument = [(said, given.instrument.get(key)) for key, said in INSTRUMENT.items()]
    about = [(said, given.conditions.get(key)) for key, said in TEXTS.items()]
    for key, (said, unit, _, _) in NUMBERS.items():
        value = given.conditions.get(key)
        about.append((said, None if value is None else f'{value:g} {unit}'))
    wished = [row for row in (*about, *instrument) if row[0] != TEXTS['remark']]
    preset = f' (preset {tracker.preset})' if tracker.preset else ''
    instrument.append((
        'specified standard uncertainties (k = 1)',
        f'{1e6 * tracker.u_range:.2f} um along the beam, {1e6 * tracker.u_angle:.2f} urad of each '
        f'angle{preset}',
    ))  # fmt: skip
    tables = [(title, [(said, str(v)) for said, v in rows if v is not None])
              for title, rows in (('Conditions', about), ('Instrument', instrument))]  # fmt: skip
    return {'tables': tables, 'missing': [said for said, value in wished if value is None]}


def track_chart(content: Content, run: Mapping[str, Any]) -> tuple[str, str]:
    """Track of a run in space, coloured by the residual, and the key of its colours."""
    low, high = content.box
    point, size = np.array(run['track']['point']), 1e6 * np.array(run['track']['residual'])
    leg = np.array(run['track']['leg'])
    low, high = np.minimum(low, point.min(axis=0)), np.maximum(high, point.max(axis=0))
    within = leg[1:] == leg[:-1]
    ends, size = np.stack([point[:-1], point[1:]], axis=1)[within], size[:-1][within]
    step = heat_step(size)
    classes = heat_classes(size, step)
    items: list[Item] = [*box(low, high), *trackers(content)]
    for level in range(LEVELS):
        own, kind = classes == level, f'heat h{level}'
        if own.any():
            dots = run['standstill']
            items.append(Dots(kind, ends[own, 0]) if dots else Strokes(kind, ends[own]))
    drawn = scene(items, low, high, 'path in space, coloured by the residual')
    return drawn, heat_key(step, float(size.max()), 'µm')


def leg_charts(run: Mapping[str, Any]) -> list[str]:
    """Root mean square residual of every leg over time, before and after compensation."""
    time = np.array(run['legs']['time'])
    along = Scale(0.0, max(run['duration'], 1e-3), 'time since the first sample (s)')
    charts = []
    for kind in ('before', 'after'):
        rms = 1e6 * np.array(run['legs'][kind])
        panel = Panel(along, scale_around(rms, 'rms of a leg (µm)', zero=True))
        what = f'{kind} compensation'
        charts.append(panel.draw([panel.dots(time, rms, kind)], f'residual {what}', what))
    return charts


def coverage_chart(content: Content, axis: str) -> str:
    """Samples over the travel of an axis: all, and while it moved."""
    own, view = content.machine.axes[axis], content.doc['coverage'][axis]
    factor, unit = own.shown
    total = np.array(view['samples']) / 1e3
    edges = factor * np.linspace(own.min, own.max, len(total) + 1)
    panel = Panel(Scale(edges[0], edges[-1], f'{axis} ({unit})'),
                  scale_around(total, 'samples (thousands)', zero=True))  # fmt: skip
    moving = np.array(view['samples_moving']) / 1e3
    marks = [panel.columns(edges, total, 'noise'), panel.columns(edges, moving, 'after')]
    return panel.draw(marks, f'samples along {axis}', axis)


def _changed(run: Mapping[str, Any]) -> tuple[Array, Array, float] | None:
    """Change of the mean residual over a run and its U (3,), m, and over what time, s; or None."""
    time, value, u = (np.array(run['drift'][k]) for k in ('time', 'value', 'u'))
    if len(time) < 2:
        return None
    return value[-1] - value[0], 2.0 * np.hypot(u[-1], u[0]), float(time[-1] - time[0])


def drift_row(number: int, run: Mapping[str, Any]) -> tuple[str, ...]:
    """Drift of a run along X, Y and Z with U."""
    name, changed = f'{number} {run["name"]}'.strip(), _changed(run)
    if changed is None:
        return (name, 'too few legs', '', '', '')
    change, wide, over = changed
    parts = [f'{1e6 * c:.2f} +/- {1e6 * w:.2f}' for c, w in zip(change, wide, strict=True)]
    return (name, *parts, f'{over:.0f}')


def drifting(runs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Directions and runs in which the drift is larger than its U."""
    for number, run in enumerate(runs, start=1):
        if (changed := _changed(run)) is not None:
            for axis, c, w in zip(XYZ, *changed[:2], strict=True):
                if abs(c) > w:
                    yield f'{axis} in run {number} {run["name"]}'.strip()


def drift_charts(run: Mapping[str, Any]) -> list[str]:
    """Mean residual by part of a run along X, Y and Z; none of a run of too few legs."""
    time, value, u = (np.array(run['drift'][k]) for k in ('time', 'value', 'u'))
    charts = []
    along = Scale(0.0, run['duration'], 'time since the first sample (s)')
    for k, axis in enumerate(XYZ) if len(time) > 1 else ():
        y, wide, kind = 1e6 * value[:, k], 2e6 * u[:, k], axis.lower()
        scale = scale_around(np.concatenate([y - wide, y + wide, [0.0]]), 'mean residual (µm)')
        panel = Panel(along, scale)
        marks = [panel.level(0.0, 'soft'), panel.ranges(time, y - wide, y + wide, f'{kind} thin'),
                 panel.line(time, y, kind), panel.dots(time, y, kind)]  # fmt: skip
        charts.append(panel.draw(marks, f'drift along {axis}', f'along {axis}'))
    return charts


def chance_of_fit(doc: Mapping[str, Any]) -> float:
    """Probability of larger residuals from noise alone."""
    dof = doc['budget']['dof'][NOISE]
    return float(gammaincc(0.5 * dof, 0.5 * dof * doc['fit']['variance_ratio']))


def noise_times(runs: Sequence[Mapping[str, Any]]) -> str:
    """Correlation times of the noise of all runs, in words."""
    times = np.concatenate([np.atleast_1d(run['noise']['correlation_time']) for run in runs])
    low, high = (f'{value:.2f}' for value in (times.min(), times.max()))
    return f'{low} s' if low == high else f'{low} to {high} s'


def repeat_command(doc: Mapping[str, Any]) -> str:
    """The command that gives the same tables from the same recordings."""
    bags = ' '.join(run['name'] or 'BAG' for run in doc['provenance'].get('runs', [])) or 'BAG'
    usual = CalibrationConfig()
    given = ', '.join(f'{n}: {v}' for n, v in doc['config'].items() if v != getattr(usual, n))
    config = f' --config FILE with {given}' if given else ''
    method = doc['provenance']['method']
    return f'./otf calibrate {bags} --machine machine.yaml --out DIR --method {method}{config}'
