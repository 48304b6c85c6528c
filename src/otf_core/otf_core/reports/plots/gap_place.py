# SPDX-License-Identifier: Apache-2.0
"""Residual in the volume: three views, colour for its size, arrows for its mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from otf_core.diagnosis.place.views import RunView
from otf_core.model.machine import AXES
from otf_core.reports.plots.figure import new_figure, quiet

CELLS = 8
"""Along the longest axis."""
PLANES = ((0, 1), (0, 2), (1, 2))
ARROW = 0.9
"""Length of the longest arrow, cells."""
FEWEST = 5
"""Pieces in a cell from which it is drawn."""
LEVELS = 12
"""Colours."""


@dataclass(frozen=True)
class _Cells:
    """Square cells of a view: edges, root mean square (um), centres, mean vectors (um)."""

    edges: tuple[Any, Any]
    rms: Any
    centre: Any
    mean: Any


def _cells(views: Sequence[RunView], vectors: Any, plane: tuple[int, int], size: float) -> _Cells:
    q = np.concatenate([v.q[:, plane] for v in views])
    low = q.min(axis=0)
    index = np.floor((q - low) / size + 1e-9).astype(int)
    number = index @ np.array([index[:, 1].max() + 1, 1])
    enough = np.bincount(number)[number] >= FEWEST
    keys, cell = np.unique(index[enough], axis=0, return_inverse=True)
    cell, vectors = cell.reshape(-1), vectors[enough]
    count = np.bincount(cell)
    square = np.bincount(cell, (vectors**2).sum(axis=1)) / count
    mean = np.stack([np.bincount(cell, vectors[:, k]) / count for k in plane], axis=1)
    shape = index.max(axis=0) + 1
    rms = np.full(shape, np.nan)
    rms[tuple(keys.T)] = 1e6 * np.sqrt(square)
    edges = (low[0] + size * np.arange(shape[0] + 1), low[1] + size * np.arange(shape[1] + 1))
    return _Cells(edges, rms, low + (keys + 0.5) * size, 1e6 * mean)


def _colours() -> Any:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps['YlOrRd'](np.linspace(0.05, 0.8, LEVELS)))


def draw_place(views: Sequence[RunView], causes: bool) -> Any:
    """Figure of all runs together: upper row without, lower row with the causes.

    Parameters
    ----------
    views : sequence of RunView
    causes : bool
        Show the residual with the causes too.
    """
    states = [('without the causes' if causes else 'residual', 'residual_before')]
    states += [('with the causes', 'residual_after')] if causes else []
    spans = np.max([np.ptp(v.q, axis=0) for v in views], axis=0)
    size = float(spans.max()) / CELLS
    rows = []
    for _, name in states:
        vectors = np.concatenate([v.vectors(getattr(v, name)) for v in views])
        rows.append([_cells(views, vectors, plane, size) for plane in PLANES])
    top = max(float(np.nanmax(c.rms)) for row in rows for c in row)
    longest = max(float(np.linalg.norm(c.mean, axis=1).max()) for row in rows for c in row)
    wide = [max(float(spans[a]), size) for a, _ in PLANES]
    tall = max(float(spans[b]) for _, b in PLANES)
    height = max(1.4, 7.0 * max(tall, size) / sum(wide))
    figure = new_figure(10, (height + 0.75) * len(states))
    axes = figure.subplots(len(states), 3, squeeze=False, width_ratios=wide)
    for row, cells, (label, _) in zip(axes, rows, states, strict=True):
        for one, plane, cell in zip(row, PLANES, cells, strict=True):
            mesh = one.pcolormesh(
                *cell.edges, cell.rms.T, cmap=_colours(), vmin=0.0, vmax=top, lw=0
            )
            one.quiver(
                *cell.centre.T, *cell.mean.T, angles='xy', scale_units='xy', pivot='mid',
                scale=max(longest, 1e-9) / (ARROW * size), width=0.012, color='#222222',
            )  # fmt: skip
            one.set_aspect('equal')
            one.set_xlabel(f'{AXES[plane[0]]} (m)')
            one.set_ylabel(f'{AXES[plane[1]]} (m)')
            quiet(one, grid=False)
        row[1].set_title(f'{label} (longest arrow of all: {longest:.2g} µm)', fontsize=10)
    figure.colorbar(mesh, ax=axes, label='rms (µm)', shrink=0.8)
    return figure
