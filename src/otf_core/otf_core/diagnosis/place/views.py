# SPDX-License-Identifier: Apache-2.0
"""Residuals without and with the causes as plain data: by leg, group, place and frequency.

Block ``views`` of gap.json: what figures show. ``rms`` and ``mean`` are lists of one or two
entries: without the causes and, where there are causes, with them; um.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place import groups as by
from otf_core.diagnosis.place.groups import Bands, Grouping, RunView, band_groups, partition
from otf_core.diagnosis.place.placement import groupings_by_view
from otf_core.model.frames import XYZ

PURE_SHARE, OBLIQUE_SHARE = 0.9, 0.3
"""Share of an axis that lies across the path: legs that see it purely, legs that see it at all."""
PURE_LEGS_SHARE = 0.2
"""Share of legs that see an axis purely from which the others are not shown."""
CELLS_ALONG, PIECES_PER_CELL = 8, 5
"""Cells along the longest axis; pieces in a cell from which it is shown."""
BANDS_PER_OCTAVE = 2
LOWEST_FREQUENCY, HIGHEST_WAVE_NUMBER = 0.2, 80.0
"""Hz; waves per m."""
SHORTEST_TURN, MOST_WAVES_PER_RAD = 0.5, 10.0
"""rad and waves per rad: the same of rotary axes."""
SHORTEST_AXIS = 0.05
"""m; shorter axes show no waves."""
PLAIN_GROUPING = 'lines'
"""Grouping that is shown where none separates."""

States = Sequence[Sequence[Array]]
"""Residuals of all runs, without and with the causes."""


def _fine(values: Any, decimals: int = 4) -> Any:
    return (np.round(values, decimals) + 0.0).tolist()


def gap_views(views: Sequence[RunView], causes: bool, grouping: str) -> dict[str, Any]:
    """Return the block.

    Parameters
    ----------
    causes : bool
        Whether there are any.
    grouping : str
        Kind of the grouping that separates the gap; empty if none does.
    """
    states: list[list[Array]] = [[v.residual_before for v in views]]
    states += [[v.residual_after for v in views]] if causes else []
    wanted = grouping or PLAIN_GROUPING
    chosen = next(g for _, g in groupings_by_view(views) if g.kind == wanted)
    axes = range(len(views[0].axis_names))
    kinds = {
        'separating': [chosen],
        'line_and_feed': [by.by_line(views), by.by_feed(views)],
        'sense': [by.by_sense(views, k) for k in axes],
        'part': [by.by_part(views)] if any(v.part_names for v in views) else [],
        'distance': [by.by_distance(views, 8)],
        'angles': [by.by_azimuth(views, 4), by.by_elevation(views, 4)],
    }
    return {
        'kind': chosen.kind,
        'legs': [leg_view(v, [s[k] for s in states]) for k, v in enumerate(views)],
        'groups': {n: group_rows(views, g, states) for n, g in kinds.items() if g},
        'cells': [cell_view(views, plane, states) for plane in combinations(range(3), 2)],
        'bands': band_views(views, states),
    }


def group_rows(
    views: Sequence[RunView], parts: Sequence[Grouping], states: States
) -> list[dict[str, Any]]:
    """Root mean square by group, and what noise contributes, um."""
    drawn = [[g for own in partition(views, parts, state) for g in own] for state in states]
    return [
        {'label': same[0].label, 'rms': _fine([1e6 * g.rms for g in same]),
         'expected': _fine(1e6 * same[0].expected)}
        for same in zip(*drawn, strict=True)
    ]  # fmt: skip


def leg_view(view: RunView, residuals: Sequence[Array]) -> dict[str, Any]:
    """Of every leg: time, s, root mean square, and mean along X, Y and Z where it sees them."""

    def sizes(rows: Array) -> Any:
        square = np.sum(rows**2, axis=0)
        return _fine(1e6 * np.sqrt([square[a:b].mean() for a, b in view.bounds]))

    means = {}
    for k, axis in enumerate(XYZ):
        across = [view.axes[:, a:b, k] for a, b in view.bounds]
        seen = np.array([float((own**2).sum()) / own.shape[1] for own in across])
        pure = seen > PURE_SHARE
        chosen = np.flatnonzero(pure if pure.mean() > PURE_LEGS_SHARE else seen > OBLIQUE_SHARE)
        value = [
            [1e6 * float((across[n] * r[:, slice(*view.bounds[n])]).sum()) / across[n].shape[1]
             for n in chosen]
            for r in residuals
        ]  # fmt: skip
        means[axis] = {'leg': chosen.tolist(), 'mean': _fine(value)}
    return {
        'run': view.name,
        'duration': float(view.time.max()),
        'time': _fine([view.time[a:b].mean() for a, b in view.bounds], 3),
        'expected': sizes(view.expected),
        'rms': [sizes(r) for r in residuals],
        'means': means,
    }


def cells(views: Sequence[RunView], vectors: Array, plane: tuple[int, int]) -> dict[str, Any]:
    """Cells of a view of all runs for vectors (p, 3), m, nearly square: 8 of the longest axis.

    ``low``: lower corners (n, 2), m; ``size`` (2,), m; ``rms`` (n,) and ``mean`` (n, 2), um.
    """
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
    return {'low': _fine(low + keys * size, 6), 'size': _fine(size, 6), 'rms': _fine(rms),
            'mean': _fine(np.stack(mean, axis=1))}  # fmt: skip


def cell_view(views: Sequence[RunView], plane: tuple[int, int], states: States) -> dict[str, Any]:
    """The volume seen along one axis: range, m, and cells of every state."""
    q = np.concatenate([v.place[:, plane] for v in views])
    return {
        'plane': [XYZ[k] for k in plane],
        'range': _fine([q.min(axis=0), q.max(axis=0)], 6),
        'states': [
            cells(views, np.concatenate([v.vectors(r) for v, r in zip(views, s, strict=True)]),
                  plane)
            for s in states
        ],
    }  # fmt: skip


def _wave_bands(axis: int | None, low: float, high: float) -> Bands:
    count = max(3, round(BANDS_PER_OCTAVE * np.log2(high / low)))
    return Bands(axis, np.geomspace(low, high, count), [str(k) for k in range(count + 1)])


def band_views(views: Sequence[RunView], states: States) -> list[dict[str, Any]]:
    """Root mean square per half octave by frequency, Hz, and by wavelength, mm or degrees."""
    steps = np.concatenate([np.diff(v.time[a:b]) for v in views for a, b in v.bounds if b - a > 1])
    bands = [_wave_bands(None, LOWEST_FREQUENCY, 0.5 / float(np.median(steps)))]
    for k, name in enumerate(views[0].axis_names):
        length = max(float(np.ptp(v.q[:, k])) for v in views)
        turns = name in views[0].rotary
        if length > (SHORTEST_TURN if turns else SHORTEST_AXIS):
            highest = MOST_WAVES_PER_RAD if turns else HIGHEST_WAVE_NUMBER
            bands.append(_wave_bands(k, 1.0 / length, highest))
    groups = zip(*band_groups(views, states, bands), strict=True)
    return [_band_view(views[0], b, g) for b, g in zip(bands, groups, strict=True)]


def _band_view(view: RunView, bands: Bands, groups: Sequence[Sequence[Any]]) -> dict[str, Any]:
    axis = '' if bands.axis is None else view.axis_names[bands.axis]
    scale, unit = (1.0, 'Hz') if bands.axis is None else view.scale(bands.axis)
    edges = bands.edges
    inner = [[g for g in own if int(g.label) < len(edges)] for own in groups]
    at = np.array([float(edges[int(g.label)]) for g in inner[0]]) / np.sqrt(edges[1] / edges[0])
    return {
        'axis': axis,
        'unit': unit,
        'at': _fine(scale / at if axis else at, 5),
        'expected': _fine([1e6 * g.expected for g in inner[0]]),
        'rms': [_fine([1e6 * g.rms for g in own]) for own in inner],
    }


def separating_plane(where: Mapping[str, Any], axes: Sequence[str]) -> list[str]:
    """Plane of the grouping, or of a single axis the one that separates most with it."""

    def named(grouping: str) -> list[str]:
        head = 'position of '
        own = grouping.removeprefix(head).split(' and ')
        return own if grouping.startswith(head) else []

    names = [where['grouping'], *(s['grouping'] for s in where['separation'])]
    own = set(named(names[0]))
    for name in map(named, names):
        if len(name) == 2 and own <= set(name):
            return sorted(name, key=list(axes).index)
    return next(list(p) for p in combinations(XYZ, 2) if own <= set(p))
