# SPDX-License-Identifier: Apache-2.0
"""The residual against time, in the volume, by travel, by beam and by frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place import groups as by
from otf_core.diagnosis.place.groups import Bands, Group, Grouping, RunView, band_groups, partition
from otf_core.diagnosis.result import Diagnosis
from otf_core.model.frames import XYZ
from otf_core.reports.charts import (
    LETTER,
    Bar,
    Panel,
    Scale,
    bars,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
)
from otf_core.reports.charts import words as svg_words
from otf_core.reports.page import Picture, Section, join_names

DRAWN_RUNS = 3
"""Runs that are drawn."""
PURE_SHARE, OBLIQUE_SHARE = 0.9, 0.3
"""Share of an axis that lies across the path: legs that see it purely, legs that see it at all."""
PURE_LEGS_SHARE = 0.2
"""Share of legs that see an axis purely from which the others are not drawn."""
TIME_LABEL = 'time since the start of the run (s)'
CELLS_ALONG = 8
"""Along the longest axis."""
PLANES = ((0, 1), (0, 2), (1, 2))
ARROW_CELLS = 0.9
"""Length of the longest arrow, cells."""
PIECES_PER_CELL = 5
"""Pieces in a cell from which it is drawn."""
VIEW_WIDTH, VIEW_HEIGHT = 274.0, 228.0
"""px; room for the cells."""
BANDS_PER_OCTAVE = 2
LOWEST_FREQUENCY, HIGHEST_WAVE_NUMBER = 0.2, 80.0
"""Hz; waves per m."""
SHORTEST_TURN, MOST_WAVES_PER_RAD = 0.5, 10.0
"""rad and waves per rad: the same of rotary axes."""
SHORTEST_AXIS = 0.05
"""m; shorter axes show no waves."""
FREQUENCY_CAPTION = (
    'Within legs: along time, and along the position of each axis on the legs that move it. The '
    'point at the slow end includes everything slower, also the means of legs; waves shorter '
    'than two path pieces are averaged out.'
)


@dataclass(frozen=True)
class ResidualState:
    """Residuals of all runs without or with the causes, and the class they are drawn in."""

    label: str
    kind: str
    residuals: list[Array]


def residual_states(diagnosis: Diagnosis) -> list[ResidualState]:
    """Without and, if there are causes, with them."""
    views, causes = diagnosis.shown.views, bool(diagnosis.causes)
    named = 'cause' if len(diagnosis.causes) == 1 else 'causes'
    label = f'without the {named}' if causes else 'residual'
    states = [ResidualState(label, 'before', [v.residual_before for v in views])]
    if causes:
        states.append(
            ResidualState(f'with the {named}', 'after', [v.residual_after for v in views])
        )
    return states


def state_key(diagnosis: Diagnosis, *, stroke: bool = False) -> str:
    """Key of the states and of the noise, as markup; ``stroke``: as bars show the noise."""
    noise = 'class="key stroke"' if stroke else _filled('noise')
    names = [(_filled(s.kind), s.label) for s in residual_states(diagnosis)] + [
        (noise, 'noise expected')
    ]
    spans = ''.join(f'<span><span {look}></span>{label}</span>' for look, label in names)
    return f'<p class="soft keys">{spans}</p>'


def _filled(kind: str) -> str:
    return f'class="key" style="background:var(--{kind})"'


def groups_side_by_side(diagnosis: Diagnosis, grouping: Grouping) -> Picture:
    """Bars of the groups of one grouping, without and with the causes at one scale."""
    views = diagnosis.shown.views
    rows = []
    for state in residual_states(diagnosis):
        [groups] = partition(views, [grouping], state.residuals)
        rows.append([
            Bar(_shown_label(grouping, g.label), ((1e6 * g.rms, state.kind),),
                f'{1e6 * g.rms:.2f} µm', 1e6 * g.expected)
            for g in groups
        ])  # fmt: skip
    every = [bar for own in rows for bar in own]
    names = 12.0 + LETTER * max(len(bar.name) for bar in every)
    parts = tuple(
        bars(own, f'where it lies: {grouping.kind}, {state.label}', names=names,
             beside=every, heading=state.label)
        for state, own in zip(residual_states(diagnosis), rows, strict=True)
    )  # fmt: skip
    kind = 'the axes that move' if grouping.kind == 'lines' else grouping.kind
    caption = f'Root mean square of the residual by {kind}; mark: contribution of noise.'
    return Picture(parts, caption, columns=2, key=state_key(diagnosis, stroke=True))


def _shown_label(grouping: Grouping, label: str) -> str:
    """A label with what it is of, where it does not say so."""
    if grouping.kind == 'lines':
        return f'line along {label}' if len(label) == 1 else f'diagonal {label}'
    return label


def group_bars(diagnosis: Diagnosis, parts: Sequence[Grouping], title: str) -> str:
    """Bars of groups: without the causes, below it with them; strokes for the noise expected."""
    views: Sequence[RunView] = diagnosis.shown.views
    drawn = [
        [group for own in partition(views, parts, state.residuals) for group in own]
        for state in residual_states(diagnosis)
    ]
    rows = []
    for same in zip(*drawn, strict=True):
        for state, group in zip(residual_states(diagnosis), same, strict=True):
            name = group.label if state.kind == 'before' else ''
            size = 1e6 * group.rms
            rows.append(Bar(name, ((size, state.kind),), f'{size:.2f} µm', 1e6 * group.expected))
    return bars(rows, title, names=158.0)


def time_section(diagnosis: Diagnosis) -> Section:
    """Residual against time, one dot a leg."""
    further = len(diagnosis.shown.views) - DRAWN_RUNS
    words = (f'{further} further runs are not drawn.',) if further > 0 else ()
    return Section('time', 'Against time', words, draw=lambda: _time_pictures(diagnosis))


def _time_pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views, causes = diagnosis.shown.views[:DRAWN_RUNS], bool(diagnosis.causes)
    pictures = []
    top = max(
        float(_leg_sizes(v, getattr(v, n)).max())
        for v in views
        for n, _ in _residual_names(causes)
    )
    for view in views:
        run = f' Run {view.name}.' if len(views) > 1 else ''
        caption = (
            'One dot per leg: root mean square of the residual, and its mean along the machine '
            f'axes, of legs across that axis.{run}'
        )
        parts = (_size_panel(view, causes, top), *(_mean_panel(view, causes, k) for k in range(3)))
        pictures.append(Picture(parts, caption, columns=2, key=state_key(diagnosis)))
    return pictures


def size_pictures(diagnosis: Diagnosis) -> Picture:
    """Size of the residual against time, without and with the causes side by side."""
    views, causes = diagnosis.shown.views[:DRAWN_RUNS], bool(diagnosis.causes)
    labels = dict(
        zip(('before', 'after'), (s.label for s in residual_states(diagnosis)), strict=False)
    )
    shown = _residual_names(causes)
    top = max(float(_leg_sizes(v, getattr(v, n)).max()) for v in views for n, _ in shown)
    parts = []
    for view in views:
        middle = np.array([view.time[a:b].mean() for a, b in view.bounds])
        run = f'{view.name}: ' if len(views) > 1 else ''
        for name, kind in shown:
            panel = Panel(_time_scale(view), scale_around([0.0, top], 'rms (µm)', zero=True))
            marks = [
                panel.line(middle, _leg_sizes(view, view.expected), 'noise'),
                panel.dots(middle, _leg_sizes(view, getattr(view, name)), f'{kind} node'),
            ]
            title = f'where it lies: residual of run {view.name} against time, {labels[kind]}'
            parts.append(panel.draw(marks, title, f'{run}{labels[kind]}'))
    caption = 'One dot per leg: root mean square of its residual; line: contribution of noise.'
    return Picture(tuple(parts), caption, columns=2, key=state_key(diagnosis))


def _residual_names(causes: bool) -> list[tuple[str, str]]:
    names = [('residual_before', 'before')]
    return [*names, ('residual_after', 'after')] if causes else names


def _leg_sizes(view: RunView, rows: Array) -> Array:
    square = np.sum(rows**2, axis=0)
    return np.asarray(1e6 * np.sqrt([square[a:b].mean() for a, b in view.bounds]))


def _time_scale(view: RunView) -> Scale:
    return Scale(0.0, max(float(view.time.max()), 1e-3), TIME_LABEL)


def _size_panel(view: RunView, causes: bool, top: float) -> str:
    middle = np.array([view.time[a:b].mean() for a, b in view.bounds])
    panel = Panel(_time_scale(view), scale_around([0.0, top], 'rms (µm)', zero=True))
    marks = [panel.line(middle, _leg_sizes(view, view.expected), 'noise')]
    for name, kind in _residual_names(causes):
        marks.append(panel.dots(middle, _leg_sizes(view, getattr(view, name)), f'{kind} node'))
    return panel.draw(marks, 'size of the residual against time', 'size')


def _mean_panel(view: RunView, causes: bool, axis: int) -> str:
    parts = [
        (_leg_means(view, getattr(view, n), axis), kind) for n, kind in _residual_names(causes)
    ]
    values = np.concatenate([[0.0], *(part[1] for part, _ in parts)])
    panel = Panel(_time_scale(view), scale_around(values, 'mean (µm)'))
    marks = [panel.level(0.0, 'soft')]
    marks += [panel.dots(*part, f'{kind} node') for part, kind in parts]
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
    pure = table[:, 2] > PURE_SHARE
    chosen = table[pure if pure.mean() > PURE_LEGS_SHARE else table[:, 2] > OBLIQUE_SHARE]
    return chosen[:, 0], chosen[:, 1]


@dataclass(frozen=True)
class Cells:
    """Cells of a view: nearly square, and together exactly the range.

    Attributes
    ----------
    low : ndarray, shape (n, 2), m
        Lower corners.
    size : ndarray, shape (2,), m
    rms : ndarray, shape (n,), um
    mean : ndarray, shape (n, 2), um
    """

    low: Array
    size: Array
    rms: Array
    mean: Array


def place_section(diagnosis: Diagnosis) -> Section:
    """Residual in the volume: three views, colour for its size, arrows for its mean."""
    return Section('place', 'In the volume', draw=lambda: _place_pictures(diagnosis))


def cells(views: Sequence[RunView], vectors: Array, plane: tuple[int, int]) -> Cells:
    """Cells of the views of all runs for vectors (p, 3), m; of the longest axis there are 8."""
    q = np.concatenate([v.place for v in views])
    wished = max(float(np.ptp(q, axis=0).max()) / CELLS_ALONG, 1e-6)
    q = q[:, plane]
    low, span = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-6)
    count = np.maximum(np.rint(span / wished).astype(int), 1)
    size = span / count
    index = np.minimum(np.floor((q - low) / size + 1e-9).astype(int), count - 1)
    enough = np.bincount(index @ [count[1], 1])[index @ [count[1], 1]] >= PIECES_PER_CELL
    keys, cell = np.unique(index[enough], axis=0, return_inverse=True)
    cell, vectors = cell.reshape(-1), vectors[enough]
    number = np.bincount(cell)
    rms = 1e6 * np.sqrt(np.bincount(cell, (vectors**2).sum(axis=1)) / number)
    mean = [1e6 * np.bincount(cell, vectors[:, k]) / number for k in plane]
    return Cells(low + keys * size, size, rms, np.stack(mean, axis=1))


def _place_pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    return [volume_picture(diagnosis, PLANES)]


def volume_picture(diagnosis: Diagnosis, planes: Sequence[tuple[int, int]]) -> Picture:
    """Views of the volume in some planes, without and with the causes at one scale."""
    views = diagnosis.shown.views
    drawn = [(state, [_cells_of(views, state, plane) for plane in planes])
             for state in residual_states(diagnosis)]  # fmt: skip
    every = [c for _, row in drawn for c in row]
    top = max((float(c.rms.max(initial=0.0)) for c in every), default=0.0)
    longest = max(float(np.linalg.norm(c.mean, axis=1).max(initial=0.0)) for c in every)
    step = heat_step(np.array([top]))
    parts = tuple(
        _plane_panel(views, c, plane, step, longest, state.label)
        for state, row in drawn
        for plane, c in zip(planes, row, strict=True)
    )
    across = [XYZ[3 - sum(plane)] for plane in planes]
    caption = (
        f'The volume seen along {join_names(across)}: colour is the root mean square of the '
        f'residual in cells of the view, arrows its mean; the longest arrow of all is '
        f'{longest:.2g} um.'
    )
    columns = 3 if len(planes) > 1 else 2
    return Picture(parts, caption, columns=columns, key=heat_key(step, top, 'µm'))


def _cells_of(views: Sequence[RunView], state: ResidualState, plane: tuple[int, int]) -> Cells:
    pairs = zip(views, state.residuals, strict=True)
    return cells(views, np.concatenate([v.vectors(r) for v, r in pairs]), plane)


def _plane_panel(
    views: Sequence[RunView],
    cells: Cells,
    plane: tuple[int, int],
    step: float,
    longest: float,
    label: str,
) -> str:
    q = np.concatenate([v.place[:, plane] for v in views])
    middle, span = 0.5 * (q.min(axis=0) + q.max(axis=0)), np.ptp(q, axis=0)
    metre = max(float(span[0]) / VIEW_WIDTH, float(span[1]) / VIEW_HEIGHT, 1e-9) * 1.08
    half = 0.5 * metre * np.array([VIEW_WIDTH, VIEW_HEIGHT])
    low, high = middle - half, middle + half
    panel = Panel(
        Scale(1e3 * float(low[0]), 1e3 * float(high[0]), f'{XYZ[plane[0]]} (mm)'),
        Scale(1e3 * float(low[1]), 1e3 * float(high[1]), f'{XYZ[plane[1]]} (mm)'),
        height=VIEW_HEIGHT + 62.0,
    )
    marks = []
    corners = panel.points(1e3 * cells.low[:, 0], 1e3 * (cells.low[:, 1] + cells.size[1]))
    wide, tall = cells.size / metre
    for (x, y), level in zip(corners, heat_classes(cells.rms, step), strict=True):
        marks.append(
            f'<rect class="area heat h{level}" x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" '
            f'height="{tall:.1f}"/>'
        )
    centre = cells.low + 0.5 * cells.size
    reach = 0.5 * ARROW_CELLS * cells.size.min() / max(longest, 1e-9) * cells.mean
    marks.append(panel.arrows(1e3 * (centre - reach), 1e3 * (centre + reach), 'dark thin'))
    names = ' and '.join(XYZ[k] for k in plane)
    return panel.draw(marks, f'residual over {names}, {label}', label)


def travel_section(diagnosis: Diagnosis) -> Section:
    """Residual by line, feed and sense of travel."""
    title = 'By line, feed and sense of travel'
    return Section('travel', title, draw=lambda: _travel_pictures(diagnosis))


def _travel_pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    senses = [by.by_sense(views, k) for k in range(len(views[0].axis_names))]
    parts = [
        group_bars(diagnosis, [by.by_line(views), by.by_feed(views)], 'residual by line and feed'),
        group_bars(diagnosis, senses, 'residual by sense'),
    ]
    if any(view.part_names for view in views):
        parts.append(group_bars(diagnosis, [by.by_part(views)], 'residual by part'))
    caption = (
        'Root mean square of the residual. Diagonals are named after the axes they move; forward '
        'is towards larger axis positions.'
    )
    return [Picture(tuple(parts), caption, columns=2, key=state_key(diagnosis, stroke=True))]


def beam_section(diagnosis: Diagnosis) -> Section:
    """Residual by length and direction of the beam."""
    return Section('beam', 'By beam', draw=lambda: _beam_pictures(diagnosis))


def _beam_pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    angles = [by.by_azimuth(views, 4), by.by_elevation(views, 4)]
    parts = (
        group_bars(diagnosis, [by.by_distance(views, 8)], 'residual by length of the beam'),
        group_bars(diagnosis, angles, 'residual by azimuth and elevation of the beam'),
    )
    caption = (
        'Root mean square of the residual by length of the beam, its azimuth about machine Z '
        '(from +X) and its elevation over the XY plane.'
    )
    return [Picture(parts, caption, columns=2, key=state_key(diagnosis, stroke=True))]


def frequency_section(diagnosis: Diagnosis) -> Section:
    """Residual by frequency in time and by wavelength along each axis."""
    return Section('frequency', 'By frequency', draw=lambda: _frequency_pictures(diagnosis))


def _frequency_pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    views = diagnosis.shown.views
    steps = np.concatenate([np.diff(v.time[a:b]) for v in views for a, b in v.bounds if b - a > 1])
    bands = [_wave_bands(None, LOWEST_FREQUENCY, 0.5 / float(np.median(steps)))]
    for k, name in enumerate(views[0].axis_names):
        length = max(float(np.ptp(v.q[:, k])) for v in views)
        turns = name in views[0].rotary
        if length > (SHORTEST_TURN if turns else SHORTEST_AXIS):
            highest = MOST_WAVES_PER_RAD if turns else HIGHEST_WAVE_NUMBER
            bands.append(_wave_bands(k, 1.0 / length, highest))
    shown = residual_states(diagnosis)
    groups = zip(*band_groups(views, [s.residuals for s in shown], bands), strict=True)
    kinds = [state.kind for state in shown]
    parts = (
        _spectrum_panel(views[0], own, dict(zip(kinds, group, strict=True)))
        for own, group in zip(bands, groups, strict=True)
    )
    return [Picture(tuple(parts), FREQUENCY_CAPTION, columns=2, key=state_key(diagnosis))]


def _wave_bands(axis: int | None, low: float, high: float) -> Bands:
    count = max(3, round(BANDS_PER_OCTAVE * np.log2(high / low)))
    return Bands(axis, np.geomspace(low, high, count), [str(k) for k in range(count + 1)])


def _spectrum_panel(
    view: RunView, bands: Bands, groups_by_kind: Mapping[str, Sequence[Group]]
) -> str:
    """Root mean square by band, per half octave, of every kind of state."""
    own = '' if bands.axis is None else view.axis_names[bands.axis]
    scale, unit = (1e3, 'mm') if bands.axis is None else view.scale(bands.axis)
    name = f'wavelength along {own} ({unit})' if own else 'frequency (Hz)'
    heading = f'along {own}' if own else 'in time'
    edges = bands.edges
    ratio = float(np.sqrt(edges[1] / edges[0]))
    lines: list[tuple[Array, Array, str]] = []
    for kind, groups in groups_by_kind.items():
        inner = [g for g in groups if int(g.label) < len(edges)]
        middle = np.array([float(edges[int(g.label)]) / ratio for g in inner])
        middle = scale / middle if own else middle
        if not lines:
            lines.append((middle, np.array([1e6 * g.expected for g in inner]), 'noise'))
        lines.append((middle, np.array([1e6 * g.rms for g in inner]), kind))
    reach = np.concatenate([line[0] for line in lines])
    if not reach.size:
        return Panel(Scale(0.0, 1.0, name, marks=1), Scale(0.0, 1.0, '', marks=1)).draw(
            [svg_words(190.0, 100.0, 'no leg is long enough', 'middle soft')], heading, heading
        )
    x = Scale(float(reach.min()) / 1.1, float(reach.max()) * 1.1, name, logarithmic=True)
    y = scale_around(
        np.concatenate([line[1] for line in lines]), 'rms per half octave (µm)', zero=True
    )
    panel = Panel(x, y)
    marks = [panel.line(*line) for line in lines]
    marks += [panel.dots(a, b, f'{kind} node') for a, b, kind in lines[1:]]
    return panel.draw(marks, f'residual by {name}', heading)
