# SPDX-License-Identifier: Apache-2.0
"""Ways to group path pieces: by time, leg, travel, feed, region and beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np

from otf_core.arrays import Array, Index
from otf_core.diagnosis.place.views import RunView
from otf_core.model.path import TRAVELS

MOST_WINDOWS = 12
FEED_STEP = 0.1
"""Feeds that differ by a smaller share count as one."""
MOST_FEEDS = 4
CORNER_DISTANCES = (0.0, 0.015, 0.03, 0.06, np.inf)
"""m; edges of the distances from corners."""
THIRDS = ('low', 'middle', 'high')


@dataclass(frozen=True)
class Grouping:
    """Labels, and which of them every piece has; -1 for none.

    Attributes
    ----------
    indices : list of ndarray of int, shape (p,)
        One per run.
    edges, second : ndarray, shape (n + 1,), optional
        Of ordered groups, in SI units or degrees; of a plane those of either axis.
    """

    kind: str
    labels: list[str]
    indices: list[Index]
    edges: Array | None = None
    second: Array | None = None


def _spans(edges: Array, digits: int, unit: str) -> list[str]:
    return [f'{a:.{digits}f} {unit} to {b:.{digits}f} {unit}' for a, b in pairwise(edges)]


def _bins(values: Array, edges: Array) -> Index:
    return np.clip(np.searchsorted(edges, values, side='right') - 1, 0, len(edges) - 2)


def _prefix(views: Sequence[RunView], view: RunView) -> str:
    return f'{view.name}: ' if len(views) > 1 else ''


def by_time(views: Sequence[RunView]) -> Grouping:
    """Equal time windows of every run."""
    labels: list[str] = []
    indices = []
    edges = np.zeros(0)
    for view in views:
        count = int(np.clip(len(view.bounds) // 4, 1, MOST_WINDOWS))
        edges = np.linspace(view.time.min(), view.time.max() + 1e-9, count + 1)
        indices.append(_bins(view.time, edges) + len(labels))
        labels += [_prefix(views, view) + text for text in _spans(edges, 0, 's')]
    return Grouping('time', labels, indices, edges if len(views) == 1 else None)


def by_leg(views: Sequence[RunView]) -> Grouping:
    """Every leg of every run."""
    labels: list[str] = []
    indices = []
    for view in views:
        index = np.zeros(len(view.leg), dtype=np.int64)
        for number, (low, high) in enumerate(view.bounds):
            index[low:high] = number + len(labels)
        indices.append(index)
        labels += [f'{_prefix(views, view)}leg {view.leg[low]}' for low, _ in view.bounds]
    return Grouping('path piece', labels, indices)


def by_line(views: Sequence[RunView]) -> Grouping:
    """Direction of the line: single axes with their sense, diagonals by the axes they move."""
    axes = views[0].axis_names
    senses = [f'{s}{a}' for a in axes for s in '+-']
    planes = [f'diagonal {"".join(p)}' for p in (*combinations(axes, 2), axes)]
    indices = []
    for view in views:
        moving = np.abs(view.direction) > TRAVELS
        axis = np.argmax(np.abs(view.direction), axis=1)
        backward = np.take_along_axis(view.direction, axis[:, None], 1)[:, 0] < 0
        still = np.where(moving[:, 2], np.where(moving[:, 1], 2, 1), 0)
        plane = np.where(moving.all(axis=1), 3, still)
        indices.append(np.where(moving.sum(axis=1) == 1, 2 * axis + backward, 6 + plane))
    return Grouping('line', senses + planes, indices)


def by_moving_axes(views: Sequence[RunView]) -> Grouping:
    """Axes that move: lines along one, diagonals of two or three; labels are their names."""
    axes = views[0].axis_names
    sets = [c for size in (1, 2, 3) for c in combinations(range(3), size)]
    number = {sum(1 << k for k in own): i for i, own in enumerate(sets)}
    labels = [''.join(axes[k] for k in own) for own in sets]
    found = np.array([number.get(code, -1) for code in range(8)])
    indices = [
        found[(np.abs(v.direction) > TRAVELS).astype(np.int64) @ np.array([1, 2, 4])]
        for v in views
    ]
    return Grouping('lines', labels, indices)


def by_corner(views: Sequence[RunView]) -> Grouping:
    """Distance from the nearer end of what was kept of the leg."""
    labels = [f'{1e3 * a:.0f} mm to {1e3 * b:.0f} mm' for a, b in pairwise(CORNER_DISTANCES[:-1])]
    labels.append(f'{1e3 * CORNER_DISTANCES[-2]:.0f} mm and more')
    edges, indices = np.array(CORNER_DISTANCES), []
    for view in views:
        near = np.zeros(len(view.leg))
        for low, high in view.bounds:
            along = np.linalg.norm(view.q[low:high] - view.q[low], axis=1)
            near[low:high] = np.minimum(along, along[-1] - along)
        indices.append(_bins(near, edges))
    return Grouping('distance from corners', labels, indices, edges)


def by_position(views: Sequence[RunView], axes: Sequence[int], count: int) -> Grouping:
    """Equal parts of the driven range of one axis or of each of several."""
    q = np.concatenate([v.q for v in views])[:, list(axes)]
    edges = [np.linspace(a, b + 1e-9, count + 1) for a, b in zip(q.min(0), q.max(0), strict=True)]
    names = [views[0].axis_names[k] for k in axes]
    named = [
        [f'{name} {1e3 * a:.0f} mm to {1e3 * b:.0f} mm' for a, b in pairwise(own)]
        for name, own in zip(names, edges, strict=True)
    ]
    labels = [', '.join(parts) for parts in product(*named)]
    indices = []
    for view in views:
        index = np.zeros(len(view.leg), dtype=np.int64)
        for k, own in zip(axes, edges, strict=True):
            index = index * count + _bins(view.q[:, k], own)
        indices.append(index)
    return Grouping(f'position of {" and ".join(names)}', labels, indices, *edges)


def by_sense(views: Sequence[RunView], axis: int) -> Grouping:
    """Sense of travel of one axis, diagonals included."""
    name = views[0].axis_names[axis]
    labels = [f'{name} forward', f'{name} backward', f'{name} at rest']
    indices = []
    for view in views:
        d = view.direction[:, axis]
        indices.append(np.where(np.abs(d) < TRAVELS, 2, np.where(d > 0, 0, 1)))
    return Grouping(f'sense of {name}', labels, indices)


def by_feed(views: Sequence[RunView]) -> Grouping:
    """Feeds: medians of the legs, those that are close taken together."""
    feeds = [
        np.concatenate([np.full(b - a, np.median(v.speed[a:b])) for a, b in v.bounds])
        for v in views
    ]
    every = np.unique(np.concatenate(feeds))
    jump = np.flatnonzero(np.diff(every) > FEED_STEP * every[1:])
    if len(jump) >= MOST_FEEDS:
        edges = np.quantile(every, np.linspace(0, 1, MOST_FEEDS + 1))
    else:
        middle = 0.5 * (every[jump] + every[jump + 1])
        edges = np.concatenate([every[:1], middle, every[-1:] + 1e-12])
    indices = [_bins(f, edges) for f in feeds]
    joined, groups = np.concatenate(feeds), np.concatenate(indices)
    labels = []
    for k in range(len(edges) - 1):
        mine = joined[groups == k]
        labels.append(f'feed {6e4 * np.median(mine):.0f} mm/min' if mine.size else 'none')
    return Grouping('feed', labels, indices)


def by_region(views: Sequence[RunView]) -> Grouping:
    """Thirds of the driven range along each axis."""
    q = np.concatenate([v.q for v in views])
    low, high = q.min(axis=0), q.max(axis=0)
    counts = [3 if b - a > 1e-6 else 1 for a, b in zip(low, high, strict=True)]
    edges = [np.linspace(a, b + 1e-9, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    named = [
        [f'{axis} {word}' for word in THIRDS] if n == 3 else [f'{axis} one level']
        for axis, n in zip(views[0].axis_names, counts, strict=True)
    ]
    labels = [', '.join(names) for names in product(*named)]
    indices = []
    for view in views:
        part = [_bins(view.q[:, k], edges[k]) for k in range(3)]
        indices.append((part[0] * counts[1] + part[1]) * counts[2] + part[2])
    return Grouping('region', labels, indices)


def by_distance(views: Sequence[RunView], count: int = 3) -> Grouping:
    """Length of the beam."""
    values = [np.linalg.norm(v.beam, axis=1) for v in views]
    return _equal('distance', values, count, 2, 'm')


def by_azimuth(views: Sequence[RunView], count: int = 4) -> Grouping:
    """Azimuth of the beam about machine Z, from machine X; in one turn about the mean."""
    values = []
    for view in views:
        flat = view.beam[:, 0] + 1j * view.beam[:, 1]
        middle = np.angle((flat / np.maximum(np.abs(flat), 1e-12)).mean())
        values.append(np.degrees(np.angle(flat * np.exp(-1j * middle)) + middle))
    return _equal('azimuth', values, count, 0, 'deg')


def by_elevation(views: Sequence[RunView], count: int = 3) -> Grouping:
    """Elevation of the beam over the machine's XY plane."""
    values = [
        np.degrees(np.arctan2(v.beam[:, 2], np.hypot(v.beam[:, 0], v.beam[:, 1]))) for v in views
    ]
    return _equal('elevation', values, count, 0, 'deg')


def _equal(kind: str, values: list[Array], count: int, digits: int, unit: str) -> Grouping:
    every = np.concatenate(values)
    edges = np.linspace(every.min(), every.max() + 1e-9, count + 1)
    labels = [f'{kind} {text}' for text in _spans(edges, digits, unit)]
    return Grouping(kind, labels, [_bins(v, edges) for v in values], edges)
