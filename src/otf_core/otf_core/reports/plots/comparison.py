# SPDX-License-Identifier: Apache-2.0
"""Figures of a comparison: one a motion (paper Figures 6 to 8), one of the volume (Figure 9)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from otf_core.comparison.compare import COVERAGE_FACTOR, Comparison
from otf_core.model.direct_measurement import MotionReadings
from otf_core.model.evaluation import mean_length
from otf_core.model.machine import AXES
from otf_core.model.motions import ErrorMotion, unit_of
from otf_core.reports.plots.figure import COLOURS, new_figure, save_figure


def _draw_motion(
    axes: Any, comparison: Comparison, motion: ErrorMotion, readings: MotionReadings | None
) -> None:
    pair = comparison.motions[motion]
    x = 1e3 * pair.position
    sides = ((pair.a, pair.u_a, COLOURS[0]), (pair.b, pair.u_b, COLOURS[1]))
    for name, (value, u, colour) in zip(comparison.names, sides, strict=True):
        axes.plot(x, 1e6 * value, '-', color=colour, lw=1.2, label=name)
        band = COVERAGE_FACTOR * 1e6 * u
        axes.fill_between(x, 1e6 * value - band, 1e6 * value + band, color=colour, alpha=0.2, lw=0)
    folded = unit_of(motion) == 'm' and any(
        f.axis == motion.axis for f in comparison.common.folded
    )
    if readings is not None and not folded:
        _draw_readings(axes, readings, motion)
    axes.set_title(motion)
    axes.set_xlabel(f'{motion.axis} (mm)')
    axes.set_ylabel('um' if unit_of(motion) == 'm' else 'urad')


def _draw_readings(axes: Any, readings: MotionReadings, motion: ErrorMotion) -> None:
    """Forward and backward means with the scatter of the runs as error bars."""
    position, base = readings.position, readings.mean
    offset = np.full(len(position), np.interp(max(0.0, position[0]), position, base))
    if motion.is_straightness:
        offset = np.interp(position, position[[0, -1]], base[[0, -1]])
    for rows, colour in ((readings.forward, COLOURS[5]), (readings.backward, COLOURS[2])):
        middle, spread = rows.mean(axis=0) - offset, rows.std(axis=0, ddof=1)
        style = {'fmt': '.', 'color': colour, 'ms': 3, 'elinewidth': 0.7}
        axes.errorbar(1e3 * position, 1e6 * middle, 1e6 * spread, **style)


def draw_motion(
    comparison: Comparison,
    motion: str,
    folder: str | Path,
    name: str,
    readings: MotionReadings | None = None,
) -> Path:
    """Write one motion of both sides with bands of k = 2, and readings if given."""
    figure = new_figure(6, 4)
    axes = figure.subplots()
    _draw_motion(axes, comparison, ErrorMotion.of(motion), readings)
    axes.legend(fontsize=8)
    return save_figure(figure, folder, name)


def draw_motions(comparison: Comparison, folder: str | Path) -> Path:
    """Write motions.svg: all motions both sides know."""
    names = list(comparison.motions)
    rows = -(-len(names) // 3)
    figure = new_figure(11, 2.6 * rows)
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes, motion in zip(grid, names, strict=False):
        _draw_motion(axes, comparison, ErrorMotion.of(motion), None)
    for axes in grid[len(names) :]:
        axes.remove()
    grid[0].legend(fontsize=7)
    return save_figure(figure, folder, 'motions')


def draw_volume(comparison: Comparison, folder: str | Path, name: str = 'volume') -> Path:
    """Write mean errors, histograms of the differences per direction, and their vectors."""
    volume = comparison.volume
    figure = new_figure(11, 7)
    grid = figure.add_gridspec(2, 4)
    bars = figure.add_subplot(grid[0, :2])
    heights = [1e6 * mean_length(f) for f in (volume.a, volume.b, volume.difference)]
    shown = bars.bar([*comparison.names, 'difference'], heights, color=COLOURS[:3])
    bars.bar_label(shown, fmt='%.2f')
    bars.set_ylabel('mean error on the grid (um)')
    difference = 1e6 * volume.difference
    reach = float(np.abs(difference).max()) or 1.0
    histograms = figure.add_subplot(grid[1, :2])
    for k, axis in enumerate(AXES):
        histograms.hist(
            difference[:, k], bins=41, range=(-reach, reach), density=True, histtype='step',
            color=COLOURS[k], label=f'{axis}: std {difference[:, k].std():.2f} um',
        )  # fmt: skip
    histograms.set_xlabel('difference (um)')
    histograms.legend(fontsize=8)
    vectors = figure.add_subplot(grid[:, 2:], projection='3d')
    draw_vectors(vectors, volume.q, volume.difference)
    return save_figure(figure, folder, name)


def draw_vectors(axes: Any, q: Any, vectors: Any) -> None:
    """Draw error vectors in the volume, the longest a tenth of its size, coloured by length."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    size = np.linalg.norm(vectors, axis=1)
    factor = 0.1 * float(np.ptp(q, axis=0).max()) / (float(size.max()) or 1.0)
    lines = Line3DCollection(np.stack([q, q + factor * vectors], axis=1), lw=1, cmap='viridis')
    lines.set_array(size)
    axes.add_collection3d(lines)
    axes.auto_scale_xyz(*q.T)
    axes.set_title(f'mean {1e6 * size.mean():.2f} um, largest {1e6 * size.max():.2f} um')
    for k, axis in enumerate('xyz'):
        getattr(axes, f'set_{axis}label')(f'{AXES[k]} (m)')
