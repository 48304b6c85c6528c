# SPDX-License-Identifier: Apache-2.0
"""Figures of ``./otf validate`` that correspond to Figures 1 to 9 of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from otf_core.config import CalibrationConfig
from otf_core.model.direct_measurement import DirectMeasurement, motion_readings
from otf_core.model.evaluation import lattice, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.noise.model import path_frame
from otf_core.reports.plots.comparison import draw_motion, draw_vectors, draw_volume
from otf_core.reports.plots.figure import COLOURS, new_figure, save_figure
from otf_core.tracking.alignment import align
from otf_core.validation.run import Validation
from otf_core.validation.simulative import across_path

MOTIONS_SHOWN = ('EXX', 'EYX', 'ECX')
"""Figures 6, 7 and 8."""


def _space(figure: Any, place: Any = 111) -> Any:
    axes = figure.add_subplot(place, projection='3d')
    for axis in 'xyz':
        getattr(axes, f'set_{axis}label')(f'{axis.upper()} (m)')
    return axes


def _line(axes: Any, points: Any, *style: Any, **options: Any) -> None:
    axes.plot(*np.asarray(points).T, *style, **options)


def draw_path(found: Validation, folder: str | Path) -> Path:
    """Figure 1: path, measured points, points after rough alignment."""
    run = found.example
    points = run.samples.xyz[:: max(1, len(run.samples) // 4000)]
    pose = align(run.samples, run.plan.path, CalibrationConfig()).T_machine_tracker
    figure = new_figure(7, 6)
    axes = _space(figure)
    _line(axes, run.plan.path.points, '-', color=COLOURS[0], lw=0.6, label='path')
    _line(axes, points, '.', color=COLOURS[2], ms=1, label='measured, frame of the tracker')
    _line(axes, pose.apply(points), '.', color=COLOURS[1], ms=1, label='aligned')
    axes.legend(fontsize=8)
    return save_figure(figure, folder, 'figure1-path')


def draw_reference(found: Validation, folder: str | Path) -> Path:
    """Figure 2: trajectory of the reference points."""
    figure = new_figure(6, 5)
    points = found.cells[0].reference.reference.path.points
    _line(_space(figure), points, '.-', color=COLOURS[0], lw=0.4, ms=4)
    return save_figure(figure, folder, 'figure2-reference-points')


def draw_frame(found: Validation, folder: str | Path) -> Path:
    """Figure 3: path coordinate systems at some points of the path."""
    run = found.example
    solved = run.result.runs[0]
    pieces, pose = solved.pieces, run.result.T_machine_tracker
    shown = np.linspace(0, len(pieces) - 1, 12).astype(int)
    station, q = pose.translation, solved.q[shown]
    beam = (q - station) / np.linalg.norm(q - station, axis=1, keepdims=True)
    frame = (pieces.direction[shown], *path_frame(pieces.direction[shown], beam))
    figure = new_figure(7, 6)
    axes = _space(figure)
    _line(axes, run.plan.path.points, '-', color='0.8', lw=0.4)
    for k, start in enumerate(q):
        _line(axes, [station, start], ':', color='0.5', lw=0.6)
        for vectors, colour in zip(frame, COLOURS[:3], strict=False):
            _line(axes, [start, start + 0.06 * vectors[k]], '-', color=colour, lw=1.5)
    for name, colour in zip(('a1, path', 'a2, towards the beam', 'a3'), COLOURS, strict=False):
        axes.plot([], [], '-', color=colour, label=name)
    axes.legend(fontsize=8)
    return save_figure(figure, folder, 'figure3-path-frame')


def draw_residuals(found: Validation, folder: str | Path) -> Path:
    """Figure 4: what compensation leaves on the path and on a grid, against the truth."""
    run = found.example
    solved, tables = run.result.runs[0], run.result.tables
    left = displacement(run.truth, solved.q) - displacement(tables, solved.q)
    every = slice(None, None, max(1, len(solved.q) // 1500))
    grid = lattice(run.machine)
    left_grid = displacement(run.truth, grid) - displacement(tables, grid)
    figure = new_figure(12, 5.5)
    path = across_path(left, solved.q, solved.axes)
    draw_vectors(_space(figure, 121), solved.q[every], path[every])
    draw_vectors(_space(figure, 122), grid, without_rigid_motion(left_grid, grid))
    return save_figure(figure, folder, 'figure4-residuals')


def draw_prediction(found: Validation, folder: str | Path) -> Path:
    """Figure 5: prediction of the reference points by each calibration, mean over the cells."""
    tests = [c.reference for c in found.cells]
    values = {'uncompensated': [t.uncompensated for t in tests]}
    for method in tests[0].residual:
        label = method if not method.isdigit() else f'{method} mm/min'
        values[label] = [t.residual[method] for t in tests]
    heights = [1e6 * float(np.mean(v)) for v in values.values()]
    spread = [1e6 * np.ptp(v) / 2 for v in values.values()]
    figure = new_figure(8, 4)
    axes = figure.subplots()
    shown = axes.bar(list(values), heights, yerr=spread, capsize=3, color=COLOURS[0])
    axes.bar_label(shown, fmt='%.2f')
    axes.set_ylabel('mean error at the reference points (um)')
    return save_figure(figure, folder, 'figure5-prediction')


def draw_validation(
    found: Validation, measurement: DirectMeasurement, folder: str | Path
) -> list[Path]:
    """Write all figures; ``measurement`` is the direct one of the first cell."""
    drawn = (draw_path, draw_reference, draw_frame, draw_residuals, draw_prediction)
    files = [draw(found, folder) for draw in drawn]
    comparison = found.cells[0].direct
    readings = motion_readings(measurement, found.cells[0].reference.truth.machine)
    for number, motion in enumerate(MOTIONS_SHOWN, start=6):
        name = f'figure{number}-{motion}'
        files.append(draw_motion(comparison, motion, folder, name, readings[motion]))
    files.append(draw_volume(comparison, folder, 'figure9-volume'))
    return files
