# SPDX-License-Identifier: Apache-2.0
"""Figure of a plan: path, tracker and beams in space, and how well every error will be known."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from otf_core.model.motions import MOTIONS, SQUARENESS, unit_of
from otf_core.planning.plan_report import PlanReport
from otf_core.reports.drawing.bars import Bar, bars
from otf_core.reports.drawing.heat import LEVELS, heat_classes, heat_step, heat_words
from otf_core.reports.drawing.scene import Dots, Item, Strokes, box, scene, tracker_items
from otf_core.reports.drawing.sheet import write_sheet

UNITS = {'m': 'um', 'rad': 'urad'}
"""Millionths of what errors are in."""
CAPTION = (
    'Above: the path with the tracker and its beams to the corners of the volume; standard '
    'uncertainty of the error vector, k = 1, the best rigid motion taken out, as colour. Below: '
    'standard uncertainty (k = 1) of every error, mean of the nodes of a table; strokes: the '
    'largest. All of noise alone.'
)


def draw_path(report: PlanReport, *, turns: bool = False) -> str:
    """Path, tracker and its beams to the corners of the volume."""
    machine, place = report.setup.machine, report.setup.place
    points, low, high = report.plan.path.points, machine.lower, machine.upper
    ends = np.stack([points[:-1], points[1:]], axis=1)
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0]
    corners = np.array(list(product(*zip(low, high, strict=True))))
    beams = np.stack([np.broadcast_to(place, corners.shape), corners], axis=1)
    items: list[Item] = [
        Strokes('z thin dash', beams),
        Strokes('after thin', ends),
        *box(low, high),
        *tracker_items(place, low, high),
    ]
    both = np.vstack([low, high, place])
    return scene(items, both.min(axis=0), both.max(axis=0), 'path and tracker', turns=turns)


def draw_grid(report: PlanReport, step: float, *, turns: bool = False) -> str:
    """Uncertainty of the error vector on the grid in classes of ``step``, um."""
    machine, found = report.setup.machine, report.forecast
    classes = heat_classes(1e6 * np.linalg.norm(found.grid_u_free, axis=1), step)
    items = box(machine.lower, machine.upper)
    items += [
        Dots(f'heat big h{level}', found.grid[classes == level])
        for level in range(LEVELS)
        if np.any(classes == level)
    ]
    return scene(items, machine.lower, machine.upper, 'uncertainty in the volume', turns=turns)


def draw_error_bars(report: PlanReport, unit: str) -> str:
    """Bars of all errors of a unit."""
    found, words = report.forecast, UNITS[unit]
    rows = []
    for name in (*SQUARENESS, *MOTIONS):
        if unit_of(name) != unit:
            continue
        if name not in found.solution.accepted:
            rows.append(Bar(name, (), 'not seen by this path'))
            continue
        u = found.u[name]
        mean, most = float(u.mean()), float(u.max())
        said = f'{1e6 * mean:.2f}, largest {1e6 * most:.2f} {words}'
        rows.append(Bar(name, ((1e6 * mean, 'after'),), said, 1e6 * most))
    return bars(rows, f'uncertainty of errors in {words}', width=480.0)


def write_plan_picture(report: PlanReport, folder: Path) -> Path:
    """Write plan.svg into a folder."""
    size = np.linalg.norm(report.forecast.grid_u_free, axis=1)
    step = heat_step(1e6 * size)
    key = [(f'heat h{level}', f'u {said}') for level, said in heat_words(step, size)]
    pictures = [draw_path(report), draw_grid(report, step)]
    pictures += [draw_error_bars(report, unit) for unit in UNITS]
    title = f'Plan for {report.setup.machine.name}: {report.how}'
    return write_sheet(folder, 'plan', pictures, 2, title, CAPTION, key)
