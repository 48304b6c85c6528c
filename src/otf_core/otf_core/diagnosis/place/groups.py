# SPDX-License-Identifier: Apache-2.0
"""Path pieces and their residual, as a whole and in groups: views, groupings, bands.

What figures and words about a gap are made from: plain arrays of every run.

Legs are the independent units: corners separate them, and the noise within one is correlated.

Ways to group path pieces: by time, leg, travel, feed, region and beam.

Residual of groups of path pieces against what noise leaves there.

With S the sum of squared residuals of a group and C the noise covariance of a leg, noise alone
gives S the mean sum tr(C) and the variance 2 sum tr(C C), both over the legs; the correlation of
the noise within a leg is in C. How well groups are told from one another also counts the scatter
of the legs, where it is larger.

Residual by frequency: bands along time and along the position of each axis.

Every leg is turned into waves (orthonormal real Fourier basis, pieces taken as evenly spaced), so
the squares of all bands add up to the square of the residual, and the noise is turned alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

from otf_core.arrays import Array, Index
from otf_core.effects.terms import State
from otf_core.model.path import TRAVELS, leg_bounds
from otf_core.noise.noise_model import TYPICAL_CORRELATION_TIME
from otf_core.solving.whitener import Whitener

DEGREE = float(np.degrees(1.0))


@dataclass(frozen=True)
class RunView:
    """One run, piece by piece, in driving order.

    Attributes
    ----------
    axis_names : tuple of str
        Of the machine, in the order of the components of ``q``.
    time : ndarray, shape (p,), s
        Since the start of the recording.
    leg : ndarray of int64, shape (p,)
        Number of the leg; a leg driven again has another number.
    q : ndarray, shape (p, k), m and rad
        Nominal axis positions.
    direction : ndarray, shape (p, k)
        Unit direction of travel in the axes.
    speed : ndarray, shape (p,), m/s
    beam : ndarray, shape (p, 3), m
        From the tracker to the target, machine frame.
    axes : ndarray, shape (c, p, 3)
        Unit directions of the c rows of every piece, perpendicular to the path.
    residual_before, residual_after : ndarray, shape (c, p), m
        Without and with the causes.
    expected : ndarray, shape (c, p), m
        Standard deviation of the noise that the simulation shows there.
    noise : Whitener, optional
        Of the noise, on any scale. Without it, ``expected`` with a typical correlation time.
    rotary : tuple of str
        Axes of which ``q`` is in rad.
    point : ndarray, shape (p, 3), m, optional
        Nominal position of the target, where it is not ``q``.
    part : ndarray of int64, shape (p,), optional
        Number of the part, where a run has several.
    part_names : tuple of str
        Of these.
    """

    name: str
    axis_names: tuple[str, ...]
    time: Array
    leg: Index
    q: Array
    direction: Array
    speed: Array
    beam: Array
    axes: Array
    residual_before: Array
    residual_after: Array
    expected: Array
    noise: Whitener | None = None
    rotary: tuple[str, ...] = ()
    point: Array | None = None
    part: Index | None = None
    part_names: tuple[str, ...] = ()

    def scale(self, axis: int) -> tuple[float, str]:
        """Factor and unit in which positions of an axis are stated."""
        return (DEGREE, 'deg') if self.axis_names[axis] in self.rotary else (1e3, 'mm')

    @property
    def place(self) -> Array:
        """Nominal position of the target, shape (p, 3), m."""
        return self.q if self.point is None else self.point

    @cached_property
    def bounds(self) -> list[tuple[int, int]]:
        """First piece and one past the last of every leg."""
        return leg_bounds(self.leg)

    @cached_property
    def whitener(self) -> Whitener:
        """Frees rows of the correlation of the noise, scaled so that it is ``expected``."""
        if self.noise is not None:
            return self.noise.scaled(self.expected / self.noise.expected)
        typical = [
            [factor * own[low:high, None] for factor, own in zip(leg, self.expected, strict=True)]
            for (low, high), leg in ((b, self._typical(*b)) for b in self.bounds)
        ]
        return Whitener.from_factors(self.bounds, typical)

    @cached_property
    def covariances(self) -> list[list[Array]]:
        """Noise covariance of every leg and component, m^2."""
        return [[factor @ factor.T for factor in leg] for leg in self.whitener.factors]

    def _typical(self, low: int, high: int) -> tuple[Array, ...]:
        gap = np.abs(self.time[low:high, None] - self.time[None, low:high])
        matrix = 0.99 * np.exp(-gap / TYPICAL_CORRELATION_TIME) + 0.01 * np.eye(high - low)
        factor = np.asarray(cholesky(matrix, lower=True))
        return (factor,) * len(self.axes)

    def with_noise(self, factor: float) -> RunView:
        """The same with a factor on the noise."""
        return replace(self, expected=factor * self.expected)

    def whiten(self, columns: Array) -> Array:
        """Whiten columns (c, p, k), m, component by component, shape (c p, k)."""
        return self.whitener.whiten(columns).reshape(-1, columns.shape[2])

    def vectors(self, residual: Array) -> Array:
        """Residual (c, p) as vectors in the machine frame, shape (p, 3)."""
        return np.asarray(np.einsum('cp,cpk->pk', residual, self.axes))


def part_targets(state: State) -> tuple[str, ...]:
    """Target of every part of a run; empty for those without points."""
    if state.turning is None:
        return ()
    targets, names = list(state.machine.targets), []
    for number in range(int(state.turning.part.max(initial=-1)) + 1):
        own = state.turning.target[state.turning.part == number]
        names.append(targets[own[0]] if len(own) else '')
    return tuple(names)


def part_names(state: State) -> tuple[str, ...]:
    """Parts of a run with their targets, as they are named in words."""
    return tuple(
        f'part {number}' + (f' ({target})' if target else '')
        for number, target in enumerate(part_targets(state), start=1)
    )


def noise_factor(views: Sequence[RunView], simulated: float) -> float:
    """Factor on the noise of runs with which it leaves the residual ``simulated``, m, in all."""
    square = sum(float((v.expected**2).sum()) for v in views)
    pieces = sum(len(v.leg) for v in views)
    return simulated / max(float(np.sqrt(square / pieces)), 1e-300)


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
    units : tuple of (float, str)
        Of positions: factor and unit in which the edges are stated.
    """

    kind: str
    labels: list[str]
    indices: list[Index]
    edges: Array | None = None
    second: Array | None = None
    units: tuple[tuple[float, str], ...] = ()


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


def by_part(views: Sequence[RunView]) -> Grouping:
    """Parts of every run, each with its target."""
    labels: list[str] = []
    indices = []
    for view in views:
        own = np.zeros(len(view.leg), dtype=np.int64) if view.part is None else view.part
        indices.append(own + len(labels))
        labels += [_prefix(views, view) + name for name in view.part_names or ('part 1',)]
    return Grouping('part', labels, indices)


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
    if views[0].rotary:
        return replace(by_moving_axes(views), kind='line')
    senses, count = [f'{s}{a}' for a in axes for s in '+-'], len(axes)
    planes = [c for size in range(2, count + 1) for c in combinations(range(count), size)]
    number = {sum(1 << k for k in own): 2 * count + i for i, own in enumerate(planes)}
    place_of = np.array([number.get(code, -1) for code in range(1 << count)])
    indices = []
    for view in views:
        moving = np.abs(view.direction) > TRAVELS
        axis = np.argmax(np.abs(view.direction), axis=1)
        backward = np.take_along_axis(view.direction, axis[:, None], 1)[:, 0] < 0
        plane = place_of[moving.astype(np.int64) @ (1 << np.arange(count))]
        indices.append(np.where(moving.sum(axis=1) == 1, 2 * axis + backward, plane))
    labels = [f'diagonal {"".join(axes[k] for k in own)}' for own in planes]
    return Grouping('line', senses + labels, indices)


def by_moving_axes(views: Sequence[RunView]) -> Grouping:
    """Axes that move: lines along one, diagonals of two or three; labels are their names."""
    axes = views[0].axis_names
    count = len(axes)
    sets = [c for size in range(1, count + 1) for c in combinations(range(count), size)]
    number = {sum(1 << k for k in own): i for i, own in enumerate(sets)}
    labels = [''.join(axes[k] for k in own) for own in sets]
    place_of = np.array([number.get(code, -1) for code in range(1 << count)])
    indices = [
        place_of[(np.abs(v.direction) > TRAVELS).astype(np.int64) @ (1 << np.arange(count))]
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
    names, units = [views[0].axis_names[k] for k in axes], [views[0].scale(k) for k in axes]
    named = [
        [f'{name} {f * a:.0f} {unit} to {f * b:.0f} {unit}' for a, b in pairwise(own)]
        for name, own, (f, unit) in zip(names, edges, units, strict=True)
    ]
    labels = [', '.join(parts) for parts in product(*named)]
    indices = []
    for view in views:
        index = np.zeros(len(view.leg), dtype=np.int64)
        for k, own in zip(axes, edges, strict=True):
            index = index * count + _bins(view.q[:, k], own)
        indices.append(index)
    kind, second = f'position of {" and ".join(names)}', edges[1] if len(edges) > 1 else None
    return Grouping(kind, labels, indices, edges[0], second, tuple(units))


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
        index = np.zeros(len(view.leg), dtype=np.int64)
        for k, own in enumerate(edges):
            index = index * counts[k] + _bins(view.q[:, k], own)
        indices.append(index)
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


FEWEST_LEGS = 4
"""From here on the scatter of the legs is looked at."""


@dataclass(frozen=True)
class Group:
    """Some path pieces.

    Attributes
    ----------
    kind : str
        What the pieces were grouped by.
    rms, expected : float
        m; root mean square of the perpendicular distance, and what noise leaves.
    excess, u_excess : float
        m^2; mean square beyond noise and its standard deviation, scatter of the legs included.
    significance : float
        How unlikely noise alone is to give so much: in standard deviations of a normal quantity.
    """

    label: str
    kind: str
    rms: float
    expected: float
    excess: float
    u_excess: float
    significance: float
    pieces: int
    legs: int

    def with_noise(self, factor: float) -> Group:
        """The same with a factor on the noise expected, and the excess beyond that."""
        expected = factor * self.expected
        return replace(self, expected=expected, excess=self.rms**2 - expected**2)

    def row(self, **further: Any) -> dict[str, Any]:
        """Plain data for gap.json."""
        return {
            'label': self.label,
            'kind': self.kind,
            'rms_um': 1e6 * self.rms,
            'expected_um': 1e6 * self.expected,
            'significance': self.significance,
            'pieces': self.pieces,
            'legs': self.legs,
            **further,
        }


@dataclass(frozen=True)
class LegRows:
    """One component of one leg, or its image under a rotation such as a Fourier transform.

    Attributes
    ----------
    values : ndarray, shape (n,), m
    covariance : ndarray, shape (n, n), m^2
        Of the noise.
    """

    values: Array
    covariance: Array


@dataclass(frozen=True)
class LegSums:
    """Sums of one leg for each of g groups: squares, noise, variance of the squares, pieces."""

    square: Array
    noise: Array
    variance: Array
    pieces: Array

    def only(self, groups: slice) -> LegSums:
        """Sums for some of the groups."""
        return LegSums(*(getattr(self, part.name)[groups] for part in fields(self)))


def leg_rows(view: RunView, residual: Array) -> Iterator[tuple[slice, list[LegRows]]]:
    """Yield the pieces of each leg and its components."""
    for (low, high), leg in zip(view.bounds, view.covariances, strict=True):
        yield slice(low, high), [LegRows(residual[c, low:high], k) for c, k in enumerate(leg)]


def rows_along(rows: Sequence[LegRows], weights: Array) -> LegRows:
    """Sum of components with weights, shape (c, n)."""
    values = sum(w * r.values for w, r in zip(weights, rows, strict=True))
    parts = (w[:, None] * r.covariance * w for w, r in zip(weights, rows, strict=True))
    return LegRows(np.asarray(values), np.asarray(sum(parts)))


def leg_sums(rows: Sequence[LegRows], member: NDArray[np.bool_], pieces: Array) -> LegSums:
    """Sums of one leg.

    Parameters
    ----------
    member : ndarray of bool, shape (n, g)
        Which groups each value belongs to.
    pieces : ndarray, shape (g,)
    """
    square, noise, variance = (np.zeros(member.shape[1]) for _ in range(3))
    here = np.flatnonzero(member.any(axis=0))
    inside = member[:, here].astype(float)
    for row in rows:
        square[here] += inside.T @ row.values**2
        noise[here] += inside.T @ np.diag(row.covariance)
        variance[here] += 2.0 * ((row.covariance**2 @ inside) * inside).sum(axis=0)
    return LegSums(square, noise, variance, pieces)


def normal_score(square: float, noise: float, variance: float) -> float:
    """Standard deviations of a normal quantity that is as unlikely as a sum of squares.

    The sum is taken as chi-square with as many degrees of freedom as its mean and variance call
    for, and turned by its cube root (Wilson and Hilferty 1931).

    Parameters
    ----------
    square, noise, variance : float
        Sum of squares, its mean and its variance if there is only noise.
    """
    spread = variance / (9.0 * noise**2)
    return float((np.cbrt(square / noise) - (1.0 - spread)) / np.sqrt(spread))


def make_groups(labels: Sequence[str], kind: str, sums: Sequence[LegSums]) -> list[Group]:
    """Groups with at least one piece, from the sums of all legs of all runs."""
    square, noise, variance, pieces = (
        np.stack([getattr(s, name) for s in sums], axis=1)
        for name in ('square', 'noise', 'variance', 'pieces')
    )
    groups = []
    for g, label in enumerate(labels):
        part = pieces[g] > 0
        if not part.any():
            continue
        count = float(pieces[g].sum())
        difference = square[g, part] - noise[g, part]
        spread = float(variance[g].sum())
        if part.sum() >= FEWEST_LEGS:
            mean = difference.sum() * pieces[g, part] / count
            legs = part.sum()
            spread = max(spread, float(((difference - mean) ** 2).sum()) * legs / (legs - 1))
        excess, deviation = float(difference.sum()), float(np.sqrt(spread))
        chance = normal_score(
            float(square[g].sum()), float(noise[g].sum()), float(variance[g].sum())
        )
        groups.append(
            Group(
                label,
                kind,
                float(np.sqrt(square[g].sum() / count)),
                float(np.sqrt(noise[g].sum() / count)),
                excess / count,
                deviation / count,
                chance,
                round(count),
                int(part.sum()),
            )
        )
    return groups


def partition(
    views: Sequence[RunView],
    groupings: Sequence[Grouping],
    residuals: Sequence[Array] | None = None,
) -> list[list[Group]]:
    """Groups of pieces that have the same index, of every grouping.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (c, p), optional
        ``residual_before`` where not given.
    """
    sums = []
    for k, view in enumerate(views):
        residual = view.residual_before if residuals is None else residuals[k]
        member = np.concatenate(
            [own.indices[k][:, None] == np.arange(len(own.labels)) for own in groupings], axis=1
        )
        for part, rows in leg_rows(view, residual):
            sums.append(leg_sums(rows, member[part], member[part].sum(axis=0)))
    groups, start = [], 0
    for own in groupings:
        part = slice(start, start + len(own.labels))
        start = part.stop
        groups.append(make_groups(own.labels, own.kind, [one.only(part) for one in sums]))
    return groups


def unevenness(groups: Sequence[Group]) -> float:
    """How much more the excess differs between groups than chance makes it.

    Returns
    -------
    float
        Sum of squared differences over their variances, less three times what chance gives.
    """
    if len(groups) < 2:
        return 0.0
    excess = np.array([g.excess for g in groups])
    weight = 1.0 / np.maximum([g.u_excess for g in groups], 1e-300) ** 2
    mean = float((weight * excess).sum() / weight.sum())
    return float((weight * (excess - mean) ** 2).sum() - 3.0 * (len(groups) - 1))


TIME_BANDS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Hz; edges of the bands along time."""
WAVE_BANDS, TURN_BANDS = (0.4, 0.2, 0.1, 0.05, 0.025), (90.0, 45.0, 20.0, 10.0, 5.0)
"""m and degrees; edges of the bands along an axis: lengths of waves."""
FEWEST_PIECES = 6
"""Legs with fewer pieces tell nothing of frequencies."""
WELL_ALONG = 0.2
"""Direction component from which an axis counts as moving along."""


@dataclass(frozen=True)
class Bands:
    """A division by frequency.

    Attributes
    ----------
    axis : int, optional
        For waves along an axis; along time where not given.
    edges : ndarray, shape (b,)
        Rising; Hz, or waves per m or rad.
    labels : sequence of str, b + 1
    """

    axis: int | None
    edges: Array
    labels: Sequence[str]

    def member(self, view: RunView, part: slice) -> NDArray[np.bool_] | None:
        """Band of each wave of a leg, shape (n, b + 1); None if the leg does not count."""
        count, along = part.stop - part.start, view.time[part]
        if self.axis is not None:
            if np.abs(view.direction[part, self.axis]).min() < WELL_ALONG:
                return None
            along = view.q[part, self.axis]
        cycles = (np.arange(count) + 1) // 2
        frequency = cycles * (1.0 / max(_span(along), 1e-9))
        band = np.searchsorted(self.edges, frequency * (1 + 1e-9), side='right')
        return np.asarray(band[:, None] == np.arange(len(self.edges) + 1))


def as_waves(values: Array) -> Array:
    """Values (..., n) in the orthonormal real Fourier basis: mean, then cosine, sine of each."""
    count = values.shape[-1]
    spectrum = np.fft.rfft(values, norm='ortho')[..., 1:]
    waves = np.empty_like(values)
    waves[..., 0] = values.sum(axis=-1) / np.sqrt(count)
    waves[..., 1::2] = np.sqrt(2.0) * spectrum.real
    waves[..., 2::2] = -np.sqrt(2.0) * spectrum.imag[..., : (count - 1) // 2]
    if count % 2 == 0:
        waves[..., -1] /= np.sqrt(2.0)
    return waves


def _span(values: Array) -> float:
    """Length covered by evenly spaced values, one spacing beyond the last."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps)) * len(values)


def band_groups(
    views: Sequence[RunView], states: Sequence[Sequence[Array]], bands: Sequence[Bands]
) -> list[list[list[Group]]]:
    """Groups of each state of the residual by each division.

    Parameters
    ----------
    states : sequence of (sequence of ndarray, shape (c, p), m)
        Residuals of all runs; the noise, which takes the time, is turned once for all.
    """
    sums: list[list[list[LegSums]]] = [[[] for _ in bands] for _ in states]
    for view, *residuals in zip(views, *states, strict=True):
        for (low, high), covariances in zip(view.bounds, view.covariances, strict=True):
            if high - low < FEWEST_PIECES:
                continue
            noise = [as_waves(as_waves(k).T) for k in covariances]
            waves = [as_waves(values[:, low:high]) for values in residuals]
            for number, own in enumerate(bands):
                member = own.member(view, slice(low, high))
                if member is None:
                    continue
                pieces = np.where(member.any(axis=0), high - low, 0)
                for state, values in zip(sums, waves, strict=True):
                    rows = [LegRows(v, k) for v, k in zip(values, noise, strict=True)]
                    state[number].append(leg_sums(rows, member, pieces))
    return [
        [_groups(views, own, legs) for own, legs in zip(bands, state, strict=True)]
        for state in sums
    ]


def _groups(views: Sequence[RunView], bands: Bands, legs: Sequence[LegSums]) -> list[Group]:
    if not legs:
        return []
    own = None if bands.axis is None else views[0].axis_names[bands.axis]
    return make_groups(bands.labels, f'waves along {own}' if own else 'frequency', legs)


def usual_bands(views: Sequence[RunView]) -> list[Bands]:
    """By frequency along time, and by wavelength along each axis."""
    low = (f'{a:g} Hz to {b:g} Hz' for a, b in pairwise(TIME_BANDS))
    labels = [f'0 Hz to {TIME_BANDS[0]:g} Hz', *low, f'{TIME_BANDS[-1]:g} Hz and more']
    axes = range(len(views[0].axis_names))
    return [
        Bands(None, np.array(TIME_BANDS), labels),
        *(_wave_bands(views[0], axis) for axis in axes),
    ]


def _wave_bands(view: RunView, axis: int) -> Bands:
    """Bands by wavelength along one axis."""
    name = view.axis_names[axis]
    if name in view.rotary:
        lengths, words = np.radians(TURN_BANDS), [f'{w:g} deg' for w in TURN_BANDS]
    else:
        lengths, words = np.array(WAVE_BANDS), [f'{1e3 * w:g} mm' for w in WAVE_BANDS]
    between = (f'{b} to {a}' for a, b in pairwise(words))
    labels = [f'above {words[0]}', *between, f'below {words[-1]}']
    return Bands(axis, 1.0 / lengths, [f'{name}: {text}' for text in labels])
