# SPDX-License-Identifier: Apache-2.0
"""What ``otf validate`` writes: figures that correspond to Figures 1 to 9 of the paper, table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.files.writing import ensure_folder, write_text
from otf_core.model.direct_measurement import DirectMeasurement, motion_readings
from otf_core.model.evaluation import lattice, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.provenance import provenance
from otf_core.noise.noise_model import path_frame
from otf_core.reports.comparison import draw_motion, draw_volume, vectors
from otf_core.reports.drawing.panel import Bar, bars, heat_step, heat_words, write_sheet
from otf_core.reports.drawing.scene import Dots, Item, Strokes, box, scene
from otf_core.tracking.alignment import align
from otf_core.validation.paper import across_path
from otf_core.validation.validate import Row, Validation, format_rows, rows_to_dict

FIGURE_MOTIONS = ('EXX', 'EYX', 'ECX')
"""Figures 6, 7 and 8."""
AXIS_LENGTH = 0.06
"""m; length of the axes of path coordinate systems."""
SCHEMA = 'otf-validation/1'
FILE = 'validation.json'
WORDS = 'agreement is assessed with expanded uncertainties, k = 2'


def _line(points: Array, kind: str) -> Strokes:
    return Strokes(kind, np.stack([points[:-1], points[1:]], axis=1))


def _space(items: list[Item], points: Array, title: str) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return scene([*box(low, high), *items], low, high, title, turns=False)


def draw_path(validation: Validation, folder: str | Path) -> Path:
    """Figure 1: path, measured points, points after rough alignment."""
    run = validation.example
    points = run.samples.xyz[:: max(1, len(run.samples) // 3000)]
    pose = align(run.samples, run.plan.path, CalibrationConfig()).T_machine_tracker
    path, aligned = run.plan.path.points, pose.apply(points)
    items: list[Item] = [
        Dots('small x', points),
        _line(path, 'noise'),
        Dots('small before', aligned),
    ]
    picture = _space(items, np.concatenate([path, points]), 'path and samples')
    key = (('noise', 'path'), ('x', 'measured, frame of the tracker'), ('before', 'aligned'))
    title = 'Path and samples before and after alignment'
    return write_sheet(folder, 'figure1-path', [picture], 1, title, key=key)


def draw_reference(validation: Validation, folder: str | Path) -> Path:
    """Figure 2: trajectory of the reference points."""
    points = validation.cells[0].reference.reference.path.points
    picture = _space(
        [_line(points, 'noise thin'), Dots('after node', points)], points, 'reference points'
    )
    title = 'Reference points in the order of driving'
    return write_sheet(folder, 'figure2-reference-points', [picture], 1, title)


def draw_frame(validation: Validation, folder: str | Path) -> Path:
    """Figure 3: path coordinate systems at some points of the path."""
    run = validation.example
    solved = run.result.runs[0]
    pieces, pose = solved.pieces, run.result.T_machine_tracker
    shown = np.linspace(0, len(pieces) - 1, 12).astype(int)
    station, q = pose.translation, solved.q[shown]
    beam = (q - station) / np.linalg.norm(q - station, axis=1, keepdims=True)
    frame = (pieces.direction[shown], *path_frame(pieces.direction[shown], beam))
    beams = np.stack([np.broadcast_to(station, q.shape), q], axis=1)
    items: list[Item] = [_line(run.plan.path.points, 'soft'), Strokes('noise dash thin', beams)]
    for axes, kind in zip(frame, 'xyz', strict=True):
        items.append(Strokes(kind, np.stack([q, q + AXIS_LENGTH * axes], axis=1), arrows=True))
    reach = np.concatenate([run.plan.path.points, station[None]])
    picture = _space(items, reach, 'path coordinate systems')
    key = (('x', 'a1, along the path'), ('y', 'a2, towards the beam'), ('z', 'a3'),
           ('noise', 'beam'))  # fmt: skip
    title = 'Path coordinate systems at some points of the path'
    return write_sheet(folder, 'figure3-path-frame', [picture], 1, title, key=key)


def draw_residuals(validation: Validation, folder: str | Path) -> Path:
    """Figure 4: what compensation leaves on the path and on a grid, against the truth."""
    run = validation.example
    solved, tables = run.result.runs[0], run.result.tables
    remainder = displacement(run.truth, solved.q) - displacement(tables, solved.q)
    every = slice(None, None, max(1, len(solved.q) // 1000))
    grid = lattice(run.machine)
    left_grid = displacement(run.truth, grid) - displacement(tables, grid)
    path = across_path(remainder, solved.q, solved.axes)[every]
    free = without_rigid_motion(left_grid, grid)
    sizes = [np.linalg.norm(field, axis=1) for field in (path, free)]
    step = heat_step(1e6 * np.concatenate(sizes))
    pictures = [vectors(solved.q[every], path, step), vectors(grid, free, step)]
    words = (f'mean {1e6 * s.mean():.2f} um, largest {1e6 * s.max():.2f} um' for s in sizes)
    on_path, on_grid = words
    caption = f'Left: across the path, {on_path}. Right: on a grid, {on_grid}.'
    key = [(f'heat h{k}', label) for k, label in heat_words(step, np.concatenate(sizes))]
    title = 'Errors left after compensation, against the truth'
    return write_sheet(folder, 'figure4-residuals', pictures, 2, title, caption, key)


def draw_prediction(validation: Validation, folder: str | Path) -> Path:
    """Figure 5: prediction of the reference points by each calibration, mean over the cells."""
    tests = [c.reference for c in validation.cells]
    values = {'uncompensated': [t.uncompensated for t in tests]}
    for method in tests[0].residual:
        label = method if not method.isdigit() else f'{method} mm/min'
        values[label] = [t.residual[method] for t in tests]
    rows = []
    for name, own in values.items():
        size = 1e6 * float(np.mean(own))
        ends = (1e6 * float(np.min(own)), 1e6 * float(np.max(own)))
        kind = 'before' if name == 'uncompensated' else 'after'
        rows.append(Bar(name, ((size, kind),), f'{size:.2f} µm', ends=ends))
    picture = bars(rows, 'mean error at the reference points', names=110.0)
    caption = 'Bars: mean over the cells; strokes: from the smallest to the largest cell.'
    title = 'Mean error at the reference points'
    return write_sheet(folder, 'figure5-prediction', [picture], 1, title, caption)


def draw_validation(
    validation: Validation, measurement: DirectMeasurement, folder: str | Path
) -> list[Path]:
    """Write all figures; ``measurement`` is the direct one of the first cell."""
    drawn = (draw_path, draw_reference, draw_frame, draw_residuals, draw_prediction)
    files = [draw(validation, folder) for draw in drawn]
    comparison = validation.cells[0].direct
    readings = motion_readings(measurement, validation.cells[0].reference.truth.machine)
    for number, motion in enumerate(FIGURE_MOTIONS, start=6):
        name = f'figure{number}-{motion}'
        files.append(draw_motion(comparison, motion, folder, name, readings[motion]))
    files.append(draw_volume(comparison, folder, 'figure9-volume'))
    return files


def write_validation(
    validation: Validation, measurement: DirectMeasurement, folder: str | Path
) -> list[Path]:
    """Write the figures, and the table as ``write_table`` does.

    Parameters
    ----------
    measurement : DirectMeasurement
        The direct one of the first cell.
    """
    folder = ensure_folder(folder)
    files = draw_validation(validation, measurement, folder)
    return [*files, *write_table(validation.seeds, validation.rows, folder)]


def write_table(seeds: Sequence[int], rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write validation.txt and validation.json; their paths.

    Parameters
    ----------
    seeds : sequence of int
        Of the cells.
    """
    data = {
        'schema': SCHEMA,
        'cells': list(seeds),
        'rows': rows_to_dict(rows),
        'provenance': provenance('validate', coverage=WORDS),
    }
    write_text(folder / 'validation.txt', format_rows(rows) + '\n')
    write_text(folder / FILE, json.dumps(data, indent=1, allow_nan=False) + '\n')
    return [folder / 'validation.txt', folder / FILE]
