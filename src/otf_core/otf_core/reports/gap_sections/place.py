# SPDX-License-Identifier: Apache-2.0
"""Residual in the volume: three views, colour for its size, arrows for its mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.views import RunView
from otf_core.diagnosis.result import Diagnosis
from otf_core.model.frames import XYZ
from otf_core.reports.drawing.heat import heat_classes, heat_key, heat_step
from otf_core.reports.drawing.panel import Panel
from otf_core.reports.drawing.scale import Scale
from otf_core.reports.gap_pictures import State, states
from otf_core.reports.quantities import listed
from otf_core.reports.section import Picture, Section

Array = NDArray[np.float64]

CELLS = 8
"""Along the longest axis."""
PLANES = ((0, 1), (0, 2), (1, 2))
ARROW = 0.9
"""Length of the longest arrow, cells."""
FEWEST = 5
"""Pieces in a cell from which it is drawn."""
WIDE, HIGH = 274.0, 228.0
"""px; room for the cells."""


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


def section(diagnosis: Diagnosis) -> Section:
    """Return the section."""
    return Section('place', 'In the volume', draw=lambda: _pictures(diagnosis))


def cells(views: Sequence[RunView], vectors: Array, plane: tuple[int, int]) -> Cells:
    """Cells of the views of all runs for vectors (p, 3), m; of the longest axis there are 8."""
    q = np.concatenate([v.q for v in views])
    wished = max(float(np.ptp(q, axis=0).max()) / CELLS, 1e-6)
    q = q[:, plane]
    low, span = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-6)
    count = np.maximum(np.rint(span / wished).astype(int), 1)
    size = span / count
    index = np.minimum(np.floor((q - low) / size + 1e-9).astype(int), count - 1)
    enough = np.bincount(index @ [count[1], 1])[index @ [count[1], 1]] >= FEWEST
    keys, cell = np.unique(index[enough], axis=0, return_inverse=True)
    cell, vectors = cell.reshape(-1), vectors[enough]
    number = np.bincount(cell)
    rms = 1e6 * np.sqrt(np.bincount(cell, (vectors**2).sum(axis=1)) / number)
    mean = [1e6 * np.bincount(cell, vectors[:, k]) / number for k in plane]
    return Cells(low + keys * size, size, rms, np.stack(mean, axis=1))


def _pictures(diagnosis: Diagnosis) -> Sequence[Picture]:
    return [volume_picture(diagnosis, PLANES)]


def volume_picture(diagnosis: Diagnosis, planes: Sequence[tuple[int, int]]) -> Picture:
    """Views of the volume in some planes, without and with the causes at one scale."""
    views = diagnosis.shown.views
    drawn = [(state, [_cells_of(views, state, plane) for plane in planes])
             for state in states(diagnosis)]  # fmt: skip
    every = [c for _, row in drawn for c in row]
    top = max((float(c.rms.max(initial=0.0)) for c in every), default=0.0)
    longest = max(float(np.linalg.norm(c.mean, axis=1).max(initial=0.0)) for c in every)
    step = heat_step(np.array([top]))
    parts = tuple(
        _panel(views, c, plane, step, longest, state.label)
        for state, row in drawn
        for plane, c in zip(planes, row, strict=True)
    )
    across = [XYZ[3 - sum(plane)] for plane in planes]
    caption = (
        f'The volume seen along {listed(across)}: colour is the root mean square of the residual '
        f'in cells of the view, arrows its mean; the longest arrow of all is {longest:.2g} um.'
    )
    columns = 3 if len(planes) > 1 else 2
    return Picture(parts, caption, columns=columns, key=heat_key(step, top, 'µm'))


def _cells_of(views: Sequence[RunView], state: State, plane: tuple[int, int]) -> Cells:
    pairs = zip(views, state.residuals, strict=True)
    return cells(views, np.concatenate([v.vectors(r) for v, r in pairs]), plane)


def _panel(
    views: Sequence[RunView],
    found: Cells,
    plane: tuple[int, int],
    step: float,
    longest: float,
    label: str,
) -> str:
    q = np.concatenate([v.q[:, plane] for v in views])
    middle, span = 0.5 * (q.min(axis=0) + q.max(axis=0)), np.ptp(q, axis=0)
    metre = max(float(span[0]) / WIDE, float(span[1]) / HIGH, 1e-9) * 1.08
    half = 0.5 * metre * np.array([WIDE, HIGH])
    low, high = middle - half, middle + half
    panel = Panel(
        Scale(1e3 * float(low[0]), 1e3 * float(high[0]), f'{XYZ[plane[0]]} (mm)'),
        Scale(1e3 * float(low[1]), 1e3 * float(high[1]), f'{XYZ[plane[1]]} (mm)'),
        height=HIGH + 62.0,
    )
    marks = []
    corners = panel.points(1e3 * found.low[:, 0], 1e3 * (found.low[:, 1] + found.size[1]))
    wide, tall = found.size / metre
    for (x, y), level in zip(corners, heat_classes(found.rms, step), strict=True):
        marks.append(
            f'<rect class="area heat h{level}" x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" '
            f'height="{tall:.1f}"/>'
        )
    centre = found.low + 0.5 * found.size
    reach = 0.5 * ARROW * found.size.min() / max(longest, 1e-9) * found.mean
    marks.append(panel.arrows(1e3 * (centre - reach), 1e3 * (centre + reach), 'dark thin'))
    names = ' and '.join(XYZ[k] for k in plane)
    return panel.draw(marks, f'residual over {names}, {label}', label)
