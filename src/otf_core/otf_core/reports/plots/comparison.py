# SPDX-License-Identifier: Apache-2.0
"""Figures of a comparison: one a motion (paper Figures 6 to 8), one of the volume (Figure 9)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison
from otf_core.model.direct_measurement import MotionReadings
from otf_core.model.evaluation import mean_length
from otf_core.model.frames import XYZ
from otf_core.model.motions import DIRECTIONS, ErrorMotion
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.heat import LEVELS, heat_classes, heat_step, heat_words
from otf_core.reports.drawing.panel import Panel, words
from otf_core.reports.drawing.scale import Scale, around
from otf_core.reports.drawing.scene import Item, Strokes, box, magnification, scene
from otf_core.reports.drawing.sheet import Key, write_sheet

Array = NDArray[np.float64]

BINS = 31
LONGEST = 0.12
"""Length of the longest arrow, share of the longest edge."""
BANDS = f'Bands: U (k = {COVERAGE_FACTOR:g}), pointwise.'


def _key(comparison: Comparison) -> Key:
    a, b = comparison.names
    return (('after', f'a: {a}'), ('before', f'b: {b}'))


def motion_panel(
    comparison: Comparison, motion: ErrorMotion, readings: MotionReadings | None = None
) -> str:
    """One motion of both sides with bands, and readings of a direct instrument if given."""
    unit = 'µm' if motion.is_translation else 'µrad'
    pair = comparison.motions.get(motion)
    if pair is None:
        return _missing(motion, unit)
    x, k = 1e3 * pair.position, 1e6 * COVERAGE_FACTOR
    sides = ((1e6 * pair.a, k * pair.u_a, 'after'), (1e6 * pair.b, k * pair.u_b, 'before'))
    rows = _reading_rows(comparison, motion, readings)
    reach = [e for value, wide, _ in sides for e in (value - wide, value + wide)]
    reach += [e for _, middle, spread, _ in rows for e in (middle - spread, middle + spread)]
    panel = Panel(_along(x, motion), around(np.concatenate(reach), f'{motion} ({unit})'))
    marks = [panel.band(x, v - w, v + w, f'{kind} band') for v, w, kind in sides]
    marks += [panel.line(x, v, kind) for v, _, kind in sides]
    for at, middle, spread, kind in rows:
        marks += [panel.ranges(at, middle - spread, middle + spread, f'{kind} thin'),
                  panel.dots(at, middle, f'{kind} node')]  # fmt: skip
    return panel.draw(marks, f'{motion} of both', motion)


def difference_panel(comparison: Comparison, motion: ErrorMotion) -> str:
    """Difference of one motion with U of the difference."""
    unit = 'µm' if motion.is_translation else 'µrad'
    pair = comparison.motions.get(motion)
    if pair is None:
        return _missing(motion, unit)
    value = 1e6 * pair.difference
    wide = 1e6 * COVERAGE_FACTOR * np.hypot(pair.u_a, pair.u_b)
    scale = around(np.concatenate([value, wide, -wide]), f'b - a ({unit})')
    x = 1e3 * pair.position
    panel = Panel(_along(x, motion), scale)
    marks = [panel.band(x, -wide, wide, 'noise band'), panel.level(0.0, 'soft'),
             panel.line(x, value, 'ink'), panel.dots(x, value, 'ink')]  # fmt: skip
    return panel.draw(marks, f'difference of {motion}', f'{motion}, b - a')


def _missing(motion: ErrorMotion, unit: str) -> str:
    panel = Panel(Scale(0.1, 0.9, '', marks=1), Scale(-1.0, 1.0, f'{motion} ({unit})', marks=1))
    said = words(190.0, 100.0, 'not known to both', 'middle soft')
    return panel.draw([said], f'{motion}: not known to both', motion)


def _along(x: Array, motion: ErrorMotion) -> Scale:
    low, high = float(x[0]), float(x[-1])
    return Scale(low, high if high > low else low + 1.0, f'{motion.axis} (mm)')


def _reading_rows(
    comparison: Comparison, motion: ErrorMotion, readings: MotionReadings | None
) -> list[tuple[Array, Array, Array, str]]:
    """Position, mean and scatter of the runs, um or urad, forward and backward."""
    folded = motion.is_translation and any(f.axis == motion.axis for f in comparison.common.folded)
    if readings is None or folded:
        return []
    position, base = readings.position, readings.mean
    offset = np.full(len(position), np.interp(max(0.0, position[0]), position, base))
    if motion.is_straightness:
        offset = np.interp(position, position[[0, -1]], base[[0, -1]])
    return [
        (1e3 * position, 1e6 * (rows.mean(axis=0) - offset), 1e6 * rows.std(axis=0, ddof=1), kind)
        for rows, kind in ((readings.forward, 'z'), (readings.backward, 'ink'))
    ]


def draw_motion(
    comparison: Comparison,
    motion: str,
    folder: str | Path,
    name: str,
    readings: MotionReadings | None = None,
) -> Path:
    """Write one motion of both sides with bands of k = 2, and readings if given."""
    one, key, caption = ErrorMotion.of(motion), _key(comparison), BANDS
    if readings is not None:
        key = (*key, ('z', 'readings forward'), ('ink', 'backward'))
        caption += ' Readings of the direct instrument: mean and standard deviation of the runs.'
    pictures = [motion_panel(comparison, one, readings), difference_panel(comparison, one)]
    return write_sheet(folder, name, pictures, 2, f'{motion} of two sources', caption, key)


def draw_motions(comparison: Comparison, folder: str | Path) -> Path:
    """Write motions.svg: all motions both sides know, and below their differences."""
    axes = comparison.common.machine.axis_names
    motions = [ErrorMotion(d, axis) for d in DIRECTIONS for axis in axes]
    pictures = [motion_panel(comparison, m) for m in motions]
    pictures += [difference_panel(comparison, m) for m in motions]
    caption = (
        f'Above: both sources in one convention. Below: b less a; grey: U of the difference. '
        f'{BANDS}'
    )
    title = 'Error motions of two sources'
    return write_sheet(folder, 'motions', pictures, 3, title, caption, _key(comparison))


def draw_volume(comparison: Comparison, folder: str | Path, name: str = 'volume') -> Path:
    """Write mean errors, histograms of the differences per direction, and their vectors."""
    volume = comparison.volume
    fields = (volume.a, volume.b, volume.difference)
    names = zip(('a', 'b', 'b - a'), ('after', 'before', 'noise'), fields, strict=True)
    sizes = [(n, kind, 1e6 * mean_length(field)) for n, kind, field in names]
    rows = [Bar(n, ((size, kind),), f'{size:.2f} µm') for n, kind, size in sizes]
    difference = 1e6 * volume.difference
    reach = float(np.abs(difference).max()) or 1.0
    pictures = [difference_histogram(difference[:, k], reach, XYZ[k]) for k in range(3)]
    pictures.append(bars(rows, 'mean error on the grid', width=340.0))
    length = np.linalg.norm(volume.difference, axis=1)
    step = heat_step(1e6 * length)
    pictures.append(vectors(volume.q, volume.difference, step))
    key = (*_key(comparison), *((f'heat h{k}', said) for k, said in heat_words(step, length)))
    caption = (
        f'Mean length of the error vectors of both sources and of their difference on '
        f'{len(volume.q)} points; difference by direction; vectors of the difference, mean '
        f'{1e6 * length.mean():.2f} um, longest {1e6 * length.max():.2f} um, colour by length.'
    )
    return write_sheet(folder, name, pictures, 3, 'Two sources in the volume', caption, key)


def difference_histogram(values: Array, reach: float, axis: str) -> str:
    """Differences (n,), um, along an axis, on a scale up to ``reach``."""
    edges = np.linspace(-1.02 * reach, 1.02 * reach, BINS + 1)
    share = 100.0 * np.histogram(values, edges)[0] / len(values)
    panel = Panel(
        Scale(-1.02 * reach, 1.02 * reach, f'b - a along {axis} (µm)'),
        around(share, 'share of points (%)', zero=True),
    )
    heading = f'along {axis}: standard deviation {values.std():.2f} µm'
    marks = [panel.columns(edges, share, 'noise')]
    return panel.draw(marks, f'difference along {axis}', heading)


def vectors(q: Array, field: Array, step: float) -> str:
    """Vectors (n, 3) in the volume of points q, coloured by length in classes of ``step``."""
    low, high = q.min(axis=0), q.max(axis=0)
    length = np.linalg.norm(field, axis=1)
    shown = magnification(float(length.max()), LONGEST * float((high - low).max()))
    classes = heat_classes(1e6 * length, step)
    items: list[Item] = box(low, high)
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            ends = np.stack([q[own], q[own] + shown.factor * field[own]], axis=1)
            items.append(Strokes(f'heat thin h{level}', ends, arrows=True))
    return scene(items, low, high, 'error vectors in the volume', turns=False, shown=shown)
