# SPDX-License-Identifier: Apache-2.0
"""The place of a gap in words: on which lines, where in the volume, when, how far away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.diagnosis.place.groupings import Grouping
from otf_core.diagnosis.place.groups import partition
from otf_core.diagnosis.place.separation import Separation
from otf_core.diagnosis.place.views import RunView
from otf_core.model.path import TRAVELS

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


def first_placed(
    views: Sequence[RunView],
    residuals: Sequence[Array],
    ranking: Sequence[Separation],
) -> Placement:
    """Place of a gap in the first grouping that has words for it, else without words.

    Parameters
    ----------
    views, residuals
        See ``placed``.
    ranking : sequence of Separation
        The largest share first.
    """
    first = placed(views, residuals, ranking[0])
    found = first
    for best in ranking[1:]:
        if found.words or not best.counts:
            break
        found = placed(views, residuals, best)
    return found if found.words else first


def placed(views: Sequence[RunView], residuals: Sequence[Array], best: Separation) -> Placement:
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
    found = Placement(best, tuple(parts), '')
    return replace(found, words=_words(found, views, residuals)) if best.counts else found


def _words(found: Placement, views: Sequence[RunView], residuals: Sequence[Array]) -> str:
    """Place, its share of the gap and of the path, and where there is nothing."""
    pieces = sum(p.pieces for p in found.parts)
    worth = [p for p in found.parts if p.pieces >= FEWEST_PIECES * pieces]
    top = max((p.gap for p in worth), default=0.0)
    much = [p for p in worth if p.gap >= MUCH * top and p.excess > UNSURE * p.u_excess]
    if not much:
        return ''
    none = [
        p for p in worth
        if p.gap < LITTLE * top or (p.excess < UNSURE * p.u_excess and p.gap < HALF * top)
    ]  # fmt: skip
    grouping = found.separation.grouping
    if grouping.kind == 'lines':
        some = [p for p in worth if p not in none]
        place, held = _line_words(views[0].axis_names, worth, much, some)
        if not found.concentrated(held):
            return ''
        nothing = _rest_words(none, _line_names([p.label for p in none], 'or'))
        moving = [a for a in views[0].axis_names if place.endswith(f' {a}')]
        sense = _sense_words(views, residuals, moving[0]) if moving else ''
        return f'{place}{sense}{_share_words(found, held)}{nothing}'
    if not found.concentrated(much):
        return ''
    words = _sense_place if grouping.kind.startswith('sense') else _group_words
    if grouping.edges is not None and grouping.second is None:
        words = _ordered_words
    elif grouping.second is not None:
        return _plane_words(found, much)
    place = words(grouping, much)
    rest = len(none) == len(worth) - len(much)
    return f'{place}{_share_words(found, much)}{_rest_words(none if rest else (), "elsewhere")}'


def _rest_words(none: Sequence[Part], where: str) -> str:
    """Where there is nothing beyond noise, or little; empty of no parts."""
    if not none:
        return ''
    nothing = all(p.excess < CLEAR * p.u_excess for p in none)
    return f'; {"nothing beyond noise" if nothing else "little"} {where}'


def _group_words(grouping: Grouping, much: Sequence[Part]) -> str:
    """Up to three groups by their labels."""
    most = sorted(much, key=lambda p: -p.gap)[:NAMED]
    words = 'from' if grouping.kind == 'time' else 'at'
    return f'{words} {listed([p.label for p in most])}'


def _share_words(found: Placement, chosen: Sequence[Part]) -> str:
    gap, path = found.share(chosen)
    return f' ({100 * gap:.0f} % of the squared gap on {100 * path:.0f} % of the path)'


def listed(names: Sequence[str], last: str = 'and') -> str:
    """Names with commas, and a word before the last."""
    return f' {last} '.join([', '.join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _line_names(labels: Sequence[str], last: str = 'and') -> str:
    """Lines along axes and diagonals by the axes they move."""
    lines = [n for n in labels if len(n) == 1]
    diagonals = [n for n in labels if len(n) > 1]
    parts = [f'on lines along {listed(lines, last)}'] if lines else []
    if diagonals:
        parts.append(f'on diagonal{"s" if len(diagonals) > 1 else ""} {listed(diagonals, last)}')
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
        return f'at {listed([p.label for p in much])}'
    first, last = 0, len(grouping.labels) - 1
    edges, stretches = grouping.edges, _stretches(much)
    name = grouping.kind.removeprefix('position of ')
    low_words, high_words, between, scale, unit = _INTERVALS.get(grouping.kind, _POSITION)
    parts = []
    for a, b in stretches:
        low, high = (f'{scale * edges[k]:.0f}' for k in (a, b + 1))
        if a == first and b == last:
            return 'everywhere'
        words = low_words if a == first else high_words if b == last else between
        parts.append(words.format(low=low, high=high, name=name, unit=unit))
    return listed(parts)


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


def _plane_words(found: Placement, much: Sequence[Part]) -> str:
    """A rectangle of two positions, or the cells with most."""
    grouping = found.separation.grouping
    assert grouping.edges is not None and grouping.second is not None
    names = grouping.kind.removeprefix('position of ').split(' and ')
    count = len(grouping.second) - 1
    cells = np.array([divmod(p.place, count) for p in much])
    low, high = cells.min(axis=0), cells.max(axis=0)
    if len(much) < FILLED * float(np.prod(high - low + 1)):
        most = sorted(much, key=lambda p: -p.excess * p.pieces)[:NAMED]
        cells_words = listed([f'({p.label})' for p in most])
        return f'unevenly over {listed(names)}, most in {cells_words}{_share_words(found, most)}'
    parts = []
    for k, (name, edges) in enumerate(zip(names, (grouping.edges, grouping.second), strict=True)):
        a, b = 1e3 * edges[low[k]], 1e3 * edges[high[k] + 1]
        if low[k] == 0 and high[k] == len(edges) - 2:
            continue
        if low[k] == 0:
            parts.append(f'{name} is below {b:.0f} mm')
        elif high[k] == len(edges) - 2:
            parts.append(f'{name} is above {a:.0f} mm')
        else:
            parts.append(f'{name} is between {a:.0f} mm and {b:.0f} mm')
    return f'where {listed(parts)}{_share_words(found, much)}'
