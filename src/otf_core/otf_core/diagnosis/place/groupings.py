# SPDX-License-Identifier: Apache-2.0
"""Ways to group path pieces: by time, leg, travel, feed, region and beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np
from numpy.typing import NDArray

from otf_core.diagnosis.place.views import RunView
from otf_core.model.path import TRAVELS

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_WINDOWS = 12
FEED_STEP = 0.1
"""Feeds that differ by a smaller share count as one."""
MOST_FEEDS = 4
THIRDS = ('low', 'middle', 'high')


@dataclass(frozen=True)
class Grouping:
    """Labels, and which of them every piece has; -1 for none.

    Attributes
    ----------
    kind : str
    labels : list of str
    indices : list of ndarray of int, shape (p,)
        One per run.
    """

    kind: str
    labels: list[str]
    indices: list[Index]


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
    for view in views:
        count = int(np.clip(len(view.bounds) // 4, 1, MOST_WINDOWS))
        edges = np.linspace(view.time.min(), view.time.max() + 1e-9, count + 1)
        indices.append(_bins(view.time, edges) + len(labels))
        labels += [_prefix(views, view) + text for text in _spans(edges, 0, 's')]
    return Grouping('time', labels, indices)


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
        labels.append(f'feed {np.median(mine):.3g} m/s' if mine.size else 'none')
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
    return Grouping(kind, labels, [_bins(v, edges) for v in values])
