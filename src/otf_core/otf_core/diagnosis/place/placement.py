# SPDX-License-Identifier: Apache-2.0
"""The place of a gap: the view that separates most, and words on it.

Which view of a gap separates most: along the path, in the volume, over time or over the beam.

Every leg is cut into blocks of a few pieces; y is the mean square residual of a block beyond
noise. Of every grouping of the blocks the share of the variance of y between its groups is taken,
less what k groups of N blocks have by chance (the adjusted coefficient of determination):

    share = 1 - (1 - R^2) (N - 1) / (N - k)

The grouping with the largest share is the view in which the gap has a place. One of a single
quantity is preferred to one of two positions that has little more, and one in the terms of the
machine to one over the beam: a reader looks for the cause at the machine first.

The place of a gap in words: on which lines, where in the volume, when, how far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from otf_core.arrays import Array
from otf_core.diagnosis.place import groups as by
from otf_core.diagnosis.place.groups import Grouping, RunView, partition
from otf_core.model.path import TRAVELS

PATH, VOLUME, TIME, BEAM = 'path', 'volume', 'time', 'beam'
VIEWS = (PATH, VOLUME, TIME, BEAM)
BLOCK = 6
"""Pieces of a block."""
LEAST_SHARE = 0.08
"""Share from which a grouping separates anything that is worth a word."""
CHANCE = 1e-4
"""Probability below which groups do not differ by chance, of some twenty groupings looked at."""
SLICES, CELLS, RANGES = 6, 4, 10
"""Groups along an axis, along either axis of a plane, and over the beam."""

SIMPLER = 0.85
"""A grouping by one quantity is preferred to one by two if it has this part of its share."""
AT_THE_MACHINE = 0.9
"""A grouping by one quantity of the machine is preferred to one over the beam if it has this part
of its share."""


@dataclass(frozen=True)
class Separation:
    """How well one grouping separates a gap.

    Attributes
    ----------
    view : str
        One of ``VIEWS``.
    share : float
        See the head of this file; at most 1, about 0 by chance.
    probability : float
        Of so large a share by chance (F test).
    """

    view: str
    grouping: Grouping
    share: float
    probability: float

    @property
    def counts(self) -> bool:
        """True if it is worth a word."""
        return self.share > LEAST_SHARE and self.probability < CHANCE


def groupings_by_view(views: Sequence[RunView]) -> list[tuple[str, Grouping]]:
    """Every grouping that is weighed, with its view."""
    axes = range(len(views[0].axis_names))
    return [
        (PATH, by.by_moving_axes(views)),
        *((PATH, by.by_sense(views, k)) for k in axes),
        (PATH, by.by_feed(views)),
        (PATH, by.by_corner(views)),
        *((VOLUME, by.by_position(views, (k,), SLICES)) for k in axes),
        *((VOLUME, by.by_position(views, pair, CELLS)) for pair in combinations(axes, 2)),
        (TIME, by.by_time(views)),
        *([(TIME, by.by_part(views))] if any(v.part_names for v in views) else []),
        (BEAM, by.by_distance(views, RANGES)),
        (BEAM, by.by_azimuth(views, RANGES)),
        (BEAM, by.by_elevation(views, RANGES)),
    ]


def separations(views: Sequence[RunView], residuals: Sequence[Array]) -> list[Separation]:
    """Separation by every grouping, the one to be shown first; see the head of this file.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m
    """
    starts = [_block_starts(v) for v in views]
    excess, weight = [], []
    for view, residual, start in zip(views, residuals, starts, strict=True):
        square = np.sum(residual**2 - view.expected**2, axis=0)
        count = np.diff([*start, len(square)])
        excess.append(np.add.reduceat(square, start) / count)
        weight.append(count)
    y, n = np.concatenate(excess), np.concatenate(weight).astype(float)
    ranked = []
    for view_name, grouping in groupings_by_view(views):
        middle = (
            own[np.minimum(s + c // 2, len(own) - 1)]
            for own, s, c in zip(grouping.indices, starts, weight, strict=True)
        )
        share, probability = _share(y, n, np.concatenate(list(middle)))
        ranked.append(Separation(view_name, grouping, share, probability))
    ranked.sort(key=lambda s: -s.share * (1.0 if s.grouping.second is None else SIMPLER))
    first, *others = ranked
    if first.view == BEAM:
        direct = [s for s in others if s.view != BEAM and s.grouping.second is None]
        if direct and direct[0].share >= AT_THE_MACHINE * first.share:
            ranked.remove(direct[0])
            ranked.insert(0, direct[0])
    return ranked


def _block_starts(view: RunView) -> NDArray[np.int64]:
    """First piece of every block of a run."""
    starts = []
    for low, high in view.bounds:
        count = max(1, round((high - low) / BLOCK))
        starts.append(np.linspace(low, high, count, endpoint=False).round().astype(np.int64))
    return np.concatenate(starts)


def _share(y: Array, weight: Array, group: NDArray[np.int64]) -> tuple[float, float]:
    """Share of the variance between groups beyond chance, and the probability of it by chance."""
    keys, index = np.unique(group, return_inverse=True)
    k, count = len(keys), len(y)
    mean = np.average(y, weights=weight)
    total = float(np.sum(weight * (y - mean) ** 2))
    if k < 2 or count <= k or total <= 0.0:
        return 0.0, 1.0
    of_group = np.bincount(index, weight)
    means = np.bincount(index, weight * y) / of_group
    between = float(np.sum(of_group * (means - mean) ** 2)) / total
    within = max(1.0 - between, 1e-12)
    share = 1.0 - within * (count - 1) / (count - k)
    ratio = (between / (k - 1)) / (within / (count - k))
    return share, float(fdtrc(k - 1, count - k, ratio))


MUCH, LITTLE = 0.6, 0.3
"""Shares of the largest gap of a group: from here on the gap lies there; below it there is nothing
worth a word."""
UNSURE, HALF = 2.0, 0.5
"""Standard deviations below which an excess may be none, and its gap is then below this share."""
FEWEST_PIECES = 0.01
"""Share of all pieces below which a group is not named in words."""
CLEAR = 4.0
"""Standard deviations from which there is something, of many groups looked at, and from which the
mean of the legs in one sense of travel has a sign."""
CONCENTRATED = 0.2
"""Share of the gap beyond the share of the path that parts must hold to be its place."""
NAMED = 3
"""Groups that are named at most."""
FILLED = 0.75
"""Share of the cells of a rectangle with much of the gap from which it is named as one."""


@dataclass(frozen=True)
class Part:
    """A group of pieces and what of the gap lies there.

    Attributes
    ----------
    place : int
        Number of its label in the grouping.
    excess, u_excess : float, m^2
        Mean square beyond noise and its standard deviation.
    """

    label: str
    place: int
    excess: float
    u_excess: float
    pieces: int

    @property
    def gap(self) -> float:
        """Root mean square beyond noise, m."""
        return float(np.sqrt(max(self.excess, 0.0)))


@dataclass(frozen=True)
class Placement:
    """Parts of a gap in the grouping that separates it most.

    Attributes
    ----------
    parts : tuple of Part
        All that have pieces.
    words : str
        Where it lies; empty if it has no place.
    """

    separation: Separation
    parts: tuple[Part, ...]
    words: str

    def share(self, chosen: Sequence[Part]) -> tuple[float, float]:
        """Share of the squared gap and of the pieces that some parts hold."""
        whole = sum(max(p.excess, 0.0) * p.pieces for p in self.parts)
        square = sum(max(p.excess, 0.0) * p.pieces for p in chosen)
        pieces = sum(p.pieces for p in self.parts)
        return square / max(whole, 1e-300), sum(p.pieces for p in chosen) / max(pieces, 1)

    def concentrated(self, chosen: Sequence[Part]) -> bool:
        """True if some parts hold clearly more of the gap than of the path."""
        gap, path = self.share(chosen)
        return gap > path + CONCENTRATED


def place_in_order(
    views: Sequence[RunView],
    residuals: Sequence[Array],
    ranking: Sequence[Separation],
) -> Placement:
    """Place of a gap in the first grouping that has words for it, else without words.

    Parameters
    ----------
    views, residuals
        See ``place_gap``.
    ranking : sequence of Separation
        The largest share first.
    """
    first = place_gap(views, residuals, ranking[0])
    placement = first
    for best in ranking[1:]:
        if placement.words or not best.counts:
            break
        placement = place_gap(views, residuals, best)
    return placement if placement.words else first


def place_gap(views: Sequence[RunView], residuals: Sequence[Array], best: Separation) -> Placement:
    """Where a gap lies, in the grouping that separates it most.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), m
    """
    [groups] = partition(views, [best.grouping], residuals)
    numbers = {label: k for k, label in enumerate(best.grouping.labels)}
    parts = []
    for group in groups:
        own = group.label, numbers[group.label], group.excess, group.u_excess, group.pieces
        parts.append(Part(*own))
    placement = Placement(best, tuple(parts), '')
    return (
        replace(placement, words=_words(placement, views, residuals)) if best.counts else placement
    )


def _words(placement: Placement, views: Sequence[RunView], residuals: Sequence[Array]) -> str:
    """Place, its share of the gap and of the path, and where there is nothing."""
    pieces = sum(p.pieces for p in placement.parts)
    worth = [p for p in placement.parts if p.pieces >= FEWEST_PIECES * pieces]
    top = max((p.gap for p in worth), default=0.0)
    much = [p for p in worth if p.gap >= MUCH * top and p.excess > UNSURE * p.u_excess]
    if not much:
        return ''
    none = [
        p for p in worth
        if p.gap < LITTLE * top or (p.excess < UNSURE * p.u_excess and p.gap < HALF * top)
    ]  # fmt: skip
    grouping = placement.separation.grouping
    if grouping.kind == 'lines':
        some = [p for p in worth if p not in none]
        place, held = _line_words(views[0].axis_names, worth, much, some)
        if not placement.concentrated(held):
            return ''
        nothing = _rest_words(none, _line_names([p.label for p in none], 'or'))
        moving = [a for a in views[0].axis_names if place.endswith(f' {a}')]
        sense = _sense_words(views, residuals, moving[0]) if moving else ''
        return f'{place}{sense}{_share_words(placement, held)}{nothing}'
    if not placement.concentrated(much):
        return ''
    words = _sense_place if grouping.kind.startswith('sense') else _group_words
    if grouping.edges is not None and grouping.second is None:
        words = _ordered_words
    elif grouping.second is not None:
        return _plane_words(placement, much)
    place = words(grouping, much)
    rest = len(none) == len(worth) - len(much)
    return (
        f'{place}{_share_words(placement, much)}{_rest_words(none if rest else (), "elsewhere")}'
    )


def _rest_words(none: Sequence[Part], where: str) -> str:
    """Where there is nothing beyond noise, or little; empty of no parts."""
    if not none:
        return ''
    nothing = all(p.excess < CLEAR * p.u_excess for p in none)
    return f'; {"nothing beyond noise" if nothing else "little"} {where}'


def _group_words(grouping: Grouping, much: Sequence[Part]) -> str:
    """Up to three groups by their labels."""
    most = sorted(much, key=lambda p: -p.gap)[:NAMED]
    words = {'time': 'from', 'part': 'in'}.get(grouping.kind, 'at')
    return f'{words} {join_names([p.label for p in most])}'


def _share_words(placement: Placement, chosen: Sequence[Part]) -> str:
    gap, path = placement.share(chosen)
    return f' ({100 * gap:.0f} % of the squared gap on {100 * path:.0f} % of the path)'


def join_names(names: Sequence[str], last: str = 'and') -> str:
    """Names with commas, and a word before the last."""
    return f' {last} '.join([', '.join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _line_names(labels: Sequence[str], last: str = 'and') -> str:
    """Lines along axes and diagonals by the axes they move."""
    lines = [n for n in labels if len(n) == 1]
    diagonals = [n for n in labels if len(n) > 1]
    parts = [f'on lines along {join_names(lines, last)}'] if lines else []
    if diagonals:
        parts.append(
            f'on diagonal{"s" if len(diagonals) > 1 else ""} {join_names(diagonals, last)}'
        )
    return f' {last} '.join(parts)


def _line_words(
    axes: Sequence[str], driven: Sequence[Part], much: Sequence[Part], some: Sequence[Part]
) -> tuple[str, Sequence[Part]]:
    """Lines by what they have in common, and which parts these are."""
    for chosen in (some, much):
        names = {p.label for p in chosen}
        for axis in axes:
            with_it = {p.label for p in driven if axis in p.label}
            diagonals = {n for n in with_it if len(n) > 1}
            if diagonals and names == diagonals:
                return f'on the diagonals that move {axis}', chosen
            if names == with_it and len(with_it) < len(driven):
                return f'wherever {axis} moves', chosen
            if names == {p.label for p in driven} - with_it and with_it:
                return f'on all lines that do not move {axis}', chosen
        if names == {p.label for p in driven if len(p.label) > 1}:
            return 'on all diagonals', chosen
    return _line_names([p.label for p in much]), much


def _sense_words(views: Sequence[RunView], residuals: Sequence[Array], axis: str) -> str:
    """Whether one sense of travel of an axis has more of the gap, and whether signs differ."""
    k = views[0].axis_names.index(axis)
    ways: list[list[Array]] = [[], []]
    square: list[list[float]] = [[], []]
    for view, residual in zip(views, residuals, strict=True):
        vectors = view.vectors(residual)
        for low, high in view.bounds:
            travel = float(view.direction[low, k])
            if TRAVELS < abs(travel) < 1.0 - TRAVELS:
                way = int(travel < 0)
                ways[way].append(vectors[low:high].mean(axis=0))
                square[way].append(float(np.mean(residual[:, low:high] ** 2)))
    if min(len(ways[0]), len(ways[1])) < 2:
        return ''
    sizes = [float(np.sqrt(np.mean(s))) for s in square]
    if min(sizes) < MUCH * max(sizes):
        return f', more with {axis} {"backward" if sizes[1] > sizes[0] else "forward"}'
    means = [np.mean(w, axis=0) for w in ways]
    spread = [np.std(w, axis=0, ddof=1) / np.sqrt(len(w)) for w in ways]
    along = int(np.argmax(np.abs(means[0] - means[1])))
    clear = all(abs(m[along]) > CLEAR * s[along] for m, s in zip(means, spread, strict=True))
    opposite = clear and means[0][along] * means[1][along] < 0
    return ', in both senses' + (' with opposite signs' if opposite else '')


def _sense_place(grouping: Grouping, much: Sequence[Part]) -> str:
    """Senses of travel: labels are 'X forward', 'X backward', 'X at rest'."""
    names = [p.label for p in much]
    axis = names[0].split()[0]
    if len(names) == 2 and not any(n.endswith('rest') for n in names):
        return f'when {axis} moves, in both senses'
    ways = {'rest': 'is at rest', 'forward': 'moves forward', 'backward': 'moves backward'}
    return f'when {axis} ' + ' or '.join(ways[n.split()[-1]] for n in names)


def _stretches(much: Sequence[Part]) -> list[tuple[int, int]]:
    """First and last number of every row of neighbouring parts."""
    places = sorted(p.place for p in much)
    cuts = [0, *(k for k, (a, b) in enumerate(pairwise(places), start=1) if b > a + 1)]
    return [(places[a], places[b - 1]) for a, b in pairwise([*cuts, len(places)])]


def _ordered_words(grouping: Grouping, much: Sequence[Part]) -> str:
    """Intervals of time, position, distance, angle, feed."""
    assert grouping.edges is not None
    if grouping.kind == 'feed':
        return f'at {join_names([p.label for p in much])}'
    first, last = 0, len(grouping.labels) - 1
    edges, stretches = grouping.edges, _stretches(much)
    name = grouping.kind.removeprefix('position of ')
    low_words, high_words, between, scale, unit = _INTERVALS.get(grouping.kind, _POSITION)
    if grouping.units:
        ((scale, unit),) = grouping.units
    parts = []
    for a, b in stretches:
        low, high = (f'{scale * edges[k]:.0f}' for k in (a, b + 1))
        if a == first and b == last:
            return 'everywhere'
        words = low_words if a == first else high_words if b == last else between
        parts.append(words.format(low=low, high=high, name=name, unit=unit))
    return join_names(parts)


_POSITION = (
    'where {name} is below {high} {unit}', 'where {name} is above {low} {unit}',
    'where {name} is between {low} {unit} and {high} {unit}', 1e3, 'mm',
)  # fmt: skip
_INTERVALS = {
    'time': (
        'in the first {high} {unit} of the run', 'after {low} {unit}',
        'from {low} {unit} to {high} {unit}', 1.0, 's',
    ),
    'distance': (
        'close to the tracker (up to {high} {unit})', 'far from the tracker (beyond {low} {unit})',
        'at {low} {unit} to {high} {unit} from the tracker', 1e3, 'mm',
    ),
    'azimuth': (
        'at azimuths of the beam below {high} {unit}',
        'at azimuths of the beam above {low} {unit}',
        'at azimuths of the beam from {low} {unit} to {high} {unit}', 1.0, 'deg',
    ),
    'elevation': (
        'at elevations of the beam below {high} {unit}',
        'at elevations of the beam above {low} {unit}',
        'at elevations of the beam from {low} {unit} to {high} {unit}', 1.0, 'deg',
    ),
    'distance from corners': (
        'within {high} {unit} of the corners', 'farther than {low} {unit} from the corners',
        'from {low} {unit} to {high} {unit} away from the corners', 1e3, 'mm',
    ),
}  # fmt: skip
"""By kind of grouping: words for its lower end, its upper end and what lies between, factor and
unit of the edges."""


def _plane_words(placement: Placement, much: Sequence[Part]) -> str:
    """A rectangle of two positions, or the cells with most."""
    grouping = placement.separation.grouping
    assert grouping.edges is not None and grouping.second is not None
    names = grouping.kind.removeprefix('position of ').split(' and ')
    count = len(grouping.second) - 1
    cells = np.array([divmod(p.place, count) for p in much])
    low, high = cells.min(axis=0), cells.max(axis=0)
    if len(much) < FILLED * float(np.prod(high - low + 1)):
        most = sorted(much, key=lambda p: -p.excess * p.pieces)[:NAMED]
        cells_words = join_names([f'({p.label})' for p in most])
        share = _share_words(placement, most)
        return f'unevenly over {join_names(names)}, most in {cells_words}{share}'
    parts = []
    both = zip(names, (grouping.edges, grouping.second), grouping.units, strict=True)
    for k, (name, edges, (factor, unit)) in enumerate(both):
        a, b = factor * edges[low[k]], factor * edges[high[k] + 1]
        if low[k] == 0 and high[k] == len(edges) - 2:
            continue
        if low[k] == 0:
            parts.append(f'{name} is below {b:.0f} {unit}')
        elif high[k] == len(edges) - 2:
            parts.append(f'{name} is above {a:.0f} {unit}')
        else:
            parts.append(f'{name} is between {a:.0f} {unit} and {b:.0f} {unit}')
    return f'where {join_names(parts)}{_share_words(placement, much)}'
