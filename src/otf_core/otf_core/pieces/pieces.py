# SPDX-License-Identifier: Apache-2.0
"""Reduction of samples to path pieces (paper 2.3: 500 000 points to 4427 values).

A piece never crosses a table node, so every error table is linear inside it and the mean of its
samples loses nothing. Left out: corners, also where the control rounds them further, standstill
and the moments around it, and outliers, which are samples far from the running median of their
leg. Curves have pieces of their own kind, see ``tracking.curves``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.blocks import blocks
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import leg_bounds, sides_of_travel
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.curves import SHORT_CURVE, Lines, curve_boundaries
from otf_core.tracking.matching import OFF_PATH


def over_windows(combine: np.ufunc, values: NDArray[Any], size: int) -> NDArray[Any]:
    """Combine the values of every window.

    Two windows that overlap or meet make a longer one, so their length doubles from pass to pass.

    Parameters
    ----------
    combine : ufunc
        Of two values, which may be taken in repeatedly: maximum, minimum, logical_or.
    values : ndarray, shape (..., n)
    size : int
        Values in a window.

    Returns
    -------
    ndarray, shape (..., n - size + 1)
    """
    width = 1
    while width < size:
        step = min(width, size - width)
        values = combine(values[..., :-step], values[..., step:])
        width += step
    return values


MEDIAN_HALF = 5
"""samples on either side that a sample is compared with to detect an outlier."""
MIN_OUTLIER = 3e-5
"""m; smaller deviations are never called outliers: they may be kinks of steep error tables, and
as bad samples they average out."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two independent normal components of unit variance."""


def outlying(
    offset_of: Callable[[slice], Array], bounds: Sequence[tuple[int, int]], limit: float
) -> NDArray[np.bool_]:
    """Samples far from the running median of their leg, by robust standard deviation.

    No sample is further from its median than the samples around it are apart, so where these
    are all within ``MIN_OUTLIER`` there is nothing to look for. The ends of a leg are continued by
    point reflection, which keeps the slope; the end sample, about which it is reflected, is
    compared with the extrapolated median instead.

    Parameters
    ----------
    offset_of : callable
        Offsets (3, m), m, of a slice of the samples; so that not all are held at once.
    bounds : sequence of (int, int)
        First sample and one past the last of every leg.
    """
    if all(_apart(offset_of(slice(*leg))) < MIN_OUTLIER for leg in bounds):
        return np.zeros(bounds[-1][1], dtype=bool)
    distance = np.empty(bounds[-1][1])
    for leg in bounds:
        distance[slice(*leg)] = np.linalg.norm(_from_median(offset_of(slice(*leg))), axis=0)
    sigma = float(np.median(distance)) / RAYLEIGH_MEDIAN
    return np.asarray(distance > max(limit * sigma, MIN_OUTLIER))


def _from_median(offset: Array) -> Array:
    """Offsets of a leg (3, n) less their running median."""
    from scipy.ndimage import median_filter  # 25 ms; most runs do without

    if offset.shape[1] <= MEDIAN_HALF:
        return np.asarray(offset - np.median(offset, axis=1, keepdims=True))
    reach = ((0, 0), (MEDIAN_HALF, MEDIAN_HALF))
    padded = np.pad(offset, reach, mode='reflect', reflect_type='odd')
    # of one dimension at a time: SciPy then moves the window, five times as fast
    smooth = np.stack([median_filter(own, 2 * MEDIAN_HALF + 1) for own in padded])
    smooth = smooth[:, MEDIAN_HALF:-MEDIAN_HALF]
    rest = offset - smooth
    rest[:, 0] = offset[:, 0] - (2 * smooth[:, 1] - smooth[:, 2])
    rest[:, -1] = offset[:, -1] - (2 * smooth[:, -2] - smooth[:, -3])
    return np.asarray(rest)


def _apart(offset: Array) -> float:
    """Bound on the distance of the samples of a leg (3, n), m, from their running median."""
    size, count = 2 * MEDIAN_HALF + 1, offset.shape[1]
    if count <= size:
        return float(np.linalg.norm(np.ptp(offset, axis=1))) * (3.0 if count > 1 else 1.0)
    spread = over_windows(np.maximum, offset, size) - over_windows(np.minimum, offset, size)
    reach = np.maximum(spread[:, 0], spread[:, -1])
    return float(np.linalg.norm(np.maximum(spread.max(axis=1), 3.0 * reach)))


MAX_ROUNDING = 0.08
"""m; a rounding begins no further from its corner."""
OFF_LINE, END_OFF_LINE = 1e-4, 5e-4
"""m; what departs from its own line by the first is left out, where its end does by the second."""
MAX_BOW_RATIO = 15.0
"""A leg that is bent all along departs at its ends by less, as a multiple of its middle."""
MIN_IN_MIDDLE = 8
"""Samples in the middle half of a leg that show its own line."""
ROUNDING_TAIL = 1.2
"""A rounding begins before it shows: it departs with the square of the path length."""


def off_their_line(
    offset_of: Callable[[slice], Array],
    bounds: Sequence[tuple[int, int]],
    along: Array,
    total: Array,
) -> NDArray[np.bool_]:
    """Samples at the ends of legs that depart from their own line: corners that are rounded.

    Parameters
    ----------
    offset_of, bounds
        As of ``outlying``.
    along, total : ndarray, shape (n,), m
        From the start of the leg of every sample, and the length of that leg.
    """
    out = np.zeros(len(along), dtype=bool)
    for first, last in bounds:
        ends = np.concatenate(
            [offset_of(slice(k, k + 1)) for k in (first, (first + last) // 2, last - 1)], axis=1
        )
        if np.abs(np.diff(ends)).max() < 0.5 * END_OFF_LINE:
            continue
        leg, length = slice(first, last), float(total[first])
        place = along[leg]
        middle = np.abs(place - 0.5 * length) < 0.25 * length
        if middle.sum() < MIN_IN_MIDDLE:
            continue
        terms = np.stack([np.ones(len(place)), place], axis=1)
        offset = offset_of(leg).T
        off = offset - terms @ np.linalg.lstsq(terms[middle], offset[middle], rcond=None)[0]
        size = np.linalg.norm(off, axis=1)
        limit = max(OFF_LINE, MAX_BOW_RATIO * float(np.sqrt(np.mean(size[middle] ** 2))))
        for way in (place, length - place):
            rounded = (way < min(MAX_ROUNDING, 0.25 * length)) & (size > limit)
            if size[rounded].max(initial=0.0) > END_OFF_LINE:
                out[leg] |= way < ROUNDING_TAIL * way[rounded].max()
    return out


MAX_PARTS_OF_LEG = 200
"""Equal parts of one leg: long legs are those of large machines, whose functions are as long."""


def piece_boundaries(corners: Array, leg: int, nodes: tuple[Array, ...], size: float) -> Array:
    """Piece boundaries along one leg, m from its start: node crossings, then equal parts.

    Parts are ``size`` long, on legs of more than ``MAX_PARTS_OF_LEG`` of them longer.
    """
    step = corners[leg + 1] - corners[leg]
    length = float(np.linalg.norm(step))
    size = max(size, length / MAX_PARTS_OF_LEG)
    cuts = [np.array([0.0, length])]
    for axis in range(3):
        if abs(step[axis]) > 1e-9:
            cuts.append((nodes[axis] - corners[leg, axis]) / step[axis] * length)
    marks = np.unique(np.concatenate(cuts))
    marks = marks[(marks >= 0) & (marks <= length)]
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-6])]
    span = np.diff(marks)
    parts = np.maximum(np.ceil(span / size), 1.0).astype(np.int64)
    place = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = place * np.repeat(span / parts, parts) + np.repeat(marks[:-1], parts)
    return np.append(inner, length)


def all_boundaries(
    lines: Lines, first: Index, nodes: tuple[Array, ...], size: float
) -> list[Array]:
    """Piece boundaries of every leg or part of a curve, m from its start.

    Parameters
    ----------
    first : ndarray of int64, shape (k,)
        First leg of each.
    nodes : three ndarrays, m
        Table nodes of the axes.
    size : float
        m.
    """
    corners, ends = lines.shape.corners, np.append(first[1:], len(lines.length))
    known: dict[bytes, Array] = {}  # laps drive the same lines

    def boundaries(a: int, b: int) -> Array:
        driven = corners[a : b + 1]
        key = driven.tobytes()
        if key not in known:
            known[key] = (
                piece_boundaries(driven, 0, nodes, size)
                if b == a + 1
                else curve_boundaries(driven, nodes, size)
            )
        return known[key]

    return [boundaries(a, b) for a, b in zip(first.tolist(), ends.tolist(), strict=True)]


Small = NDArray[np.int32]

SPEED_WINDOW = 0.04
"""s; the speed of a sample is taken over this time."""


@dataclass(frozen=True)
class Pieces:
    """Means over path pieces, in driving order.

    Attributes
    ----------
    xyz : ndarray, shape (p, 3), m
        Mean measured point in the tracker frame.
    leg : ndarray of int64, shape (p,)
        Leg of the path; on a curve the first chord of the part of it that shares slow noise.
    origin, direction : ndarray, shape (p, 3)
        Start point (m) and unit direction of that leg, machine frame; on a curve the mean foot
        and direction of the samples; at standstill the point itself and the direction of
        approach, zero where unknown.
    side : ndarray, shape (p, 3)
        Sign of the travel of each axis, see ``path.sides_of_travel``.
    count : ndarray of int64, shape (p,)
        Samples averaged.
    time : ndarray, shape (p,), s
        Mean time since the first sample of the recording.
    duration : ndarray, shape (p,), s
    speed : ndarray, shape (p,), m/s
    used : int
        Samples in all pieces.
    outliers : int
        Samples left out as outliers.
    end : float
        s, since the first sample, of the end of the recording; 0 stands for the last piece.
    standstill : bool
        True if the pieces are standstills at ``origin``, where all three directions count.
    samples : ndarray of int32, shape (u,)
        Places in the recording of the samples averaged; empty if not kept.
    piece : ndarray of int32, shape (u,)
        Piece of each of them.
    chord : ndarray of int64, shape (p,)
        Chord of the path on which the piece begins; empty if that is its leg.
    spread : ndarray, shape (p,), m
        Standard deviation of the samples along the line; empty if pieces are points.
    far : ndarray of int32, shape (o,)
        Places in the recording of samples on the lines that are in no piece as they are far from
        those around them.
    """

    xyz: Array
    leg: Index
    origin: Array
    direction: Array
    side: Array
    count: Index
    time: Array
    duration: Array
    speed: Array
    used: int
    outliers: int
    end: float = 0.0
    standstill: bool = False
    samples: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    piece: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    chord: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    spread: Array = field(default_factory=lambda: np.zeros(0))
    far: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))

    @property
    def line(self) -> Index:
        """Straight line of the path on which each piece begins, shape (p,)."""
        return self.chord if len(self.chord) else self.leg

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.leg)

    def without(self, drop: NDArray[np.bool_]) -> Pieces:
        """Return the pieces that are not marked in ``drop``, shape (p,)."""
        if not drop.any():
            return self
        arrays = (
            'xyz',
            'leg',
            'origin',
            'direction',
            'side',
            'count',
            'time',
            'duration',
            'speed',
        )
        fields = {name: getattr(self, name)[~drop] for name in arrays}
        stays = ~drop[self.piece]
        lost = int(self.count[drop].sum())
        return replace(
            self,
            **fields,
            samples=self.samples[stays],
            piece=(np.cumsum(~drop, dtype=self.piece.dtype) - 1)[self.piece[stays]],
            chord=self.chord[~drop] if len(self.chord) else self.chord,
            spread=self.spread[~drop] if len(self.spread) else self.spread,
            used=self.used - lost,
            outliers=self.outliers + lost,
        )

    def mean_of(self, blocks: Iterable[Array]) -> Array:
        """Means over the pieces of values (u, ...) given for ``samples``, block by block."""
        total, start = np.zeros(()), 0
        for values in blocks:
            piece = self.piece[start : start + len(values)]
            first, start = np.flatnonzero(np.diff(piece, prepend=-1)), start + len(values)
            if not total.ndim:
                total = np.zeros((len(self), *values.shape[1:]))
            np.add.at(total, piece[first], np.add.reduceat(values, first, axis=0))
        return np.asarray(total / self.count.reshape(-1, *([1] * (total.ndim - 1))))


def _moving(samples: Samples, along: Array, leg: Index, config: CalibrationConfig) -> Array:
    """Speed of every sample along its leg, m/s; zero near standstill and leg changes."""
    half = max(1, round(0.5 * SPEED_WINDOW / samples.step))
    speed = np.zeros(len(samples))
    if len(samples) <= 2 * half:
        return speed
    for part in blocks(len(samples) - 2 * half):
        middle, late = (slice(part.start + k, part.stop + k) for k in (half, 2 * half))
        span = (samples.stamp_ns[late] - samples.stamp_ns[part]) * 1e-9
        advance = np.where(leg[late] == leg[part], along[late] - along[part], 0.0)
        speed[middle] = np.abs(advance) / np.maximum(span, 1e-9)
    still = np.pad(speed < config.standstill_speed, half)
    speed[over_windows(np.logical_or, still, 2 * half + 1)] = 0.0
    return speed


class _Means:
    """Sums per piece of quantities of its samples."""

    def __init__(self, piece: Small, total: int) -> None:
        self._piece, self._total = piece, total
        self.count = np.bincount(piece, minlength=total)

    def mean(self, values: Array) -> Array:
        """Mean per piece, shape (total,); 0 for an empty piece."""
        sums = np.bincount(self._piece, values, self._total)
        return np.asarray(sums / np.maximum(self.count, 1))


def samples_on_lines(
    samples: Samples, alignment: Alignment, config: CalibrationConfig
) -> tuple[Index, Array, Array, Index]:
    """Samples in steady motion on the lines of the path.

    Returns
    -------
    index : ndarray of int64, shape (n,)
        Neither near corners nor standing still nor outliers.
    along : ndarray, shape (n,), m
        From the start of the leg or chord.
    speed : ndarray, shape (n,), m/s
    far : ndarray of int64, shape (o,)
        Those left out as outliers.

    Raises
    ------
    InputError
        If there is none.
    """
    leg = np.where(alignment.leg == OFF_PATH, 0, alignment.leg)
    pose, lines = alignment.T_machine_tracker, Lines.of(alignment.shape)
    seen = lines.seen_from(pose)
    on_chord, along = np.empty((2, len(samples)))
    for part in blocks(len(samples)):
        on_chord[part] = seen.along(samples.xyz[part], leg[part])
        along[part] = lines.start[leg[part]] + on_chord[part]
    stretch = np.where(
        alignment.leg == OFF_PATH, OFF_PATH, lines.shape.stretch.astype(leg.dtype)[leg]
    )
    speed = _moving(samples, along, stretch, config)
    margin = _margin(lines, config)
    keep = (alignment.leg != OFF_PATH) & (speed > 0)
    for part in blocks(len(samples)):
        here, own = leg[part], along[part]
        keep[part] &= (own > margin[here]) & (own < lines.total[here] - margin[here])
    chosen = np.flatnonzero(keep)
    if not len(chosen):
        raise InputError('no sample is left on the lines of the path away from corners and stops')
    del keep
    curved = lines.shape.curved

    def offset_of(part: slice) -> Array:
        here = chosen[part]
        line = leg[here]
        offset = pose.apply(samples.xyz.take(here, axis=0))
        offset -= on_chord[here, None] * lines.unit.take(line, axis=0)
        bent = curved[line]
        if bent.any():
            offset[bent] -= lines.corners[line[bent]]
        return np.ascontiguousarray(offset.T)

    on = leg[chosen]
    legs = [b for b in leg_bounds(stretch[chosen]) if not curved[on[b[0]]]]
    chosen = chosen[~off_their_line(offset_of, legs, along[chosen], lines.total[on])]
    del along, on
    out = outlying(offset_of, leg_bounds(stretch[chosen]), config.outlier_limit)
    far, chosen = chosen[out], chosen[~out]
    return chosen, on_chord[chosen], speed[chosen], far


def _margin(lines: Lines, config: CalibrationConfig) -> Array:
    """Length left out at both ends of the leg or curve of every chord, m.

    A curve so short that nothing else is left of it is the rounding of a corner.
    """
    short = 0.25 * lines.total
    short[lines.shape.curved & (lines.total < SHORT_CURVE * config.corner_exclusion)] = np.inf
    margin = np.minimum(config.corner_exclusion, short)
    return np.where(np.isinf(short), lines.total, margin)


def reduce_to_pieces(
    samples: Samples, alignment: Alignment, nodes: tuple[Array, ...], config: CalibrationConfig
) -> Pieces:
    """Average samples over path pieces.

    Parameters
    ----------
    nodes : three ndarrays, m
        Table nodes of X, Y, Z; pieces end there.

    Raises
    ------
    InputError
        If nothing is left.
    """
    chosen, along, speed, far = samples_on_lines(samples, alignment, config)
    lines, leg = Lines.of(alignment.shape), alignment.leg[chosen]
    shape = lines.shape
    first = np.unique(shape.group)
    marks = all_boundaries(lines, first, nodes, config.piece_length)
    shift = np.concatenate([[0.0], np.cumsum([m[-1] + 1.0 for m in marks])])
    bounds = np.concatenate([m + s for m, s in zip(marks, shift[:-1], strict=True)])
    place, piece = np.empty(len(leg)), np.empty(len(leg), dtype=np.int32)
    for part in blocks(len(leg)):
        here = leg[part]
        group = shape.group[here]
        own = (lines.start[here] - lines.start[group]) + along[part]
        place[part] = own = np.where(shape.curved[here], np.maximum(own, 0.0), own)
        beyond = shift[np.searchsorted(first, group)] + own
        piece[part] = np.searchsorted(bounds, beyond, side='right') - 1
    pieces = _collect(samples, chosen, piece, alignment, lines.unit, speed, place, far)
    return pieces if shape.straight else _on_curves(pieces, lines, alignment, along)


def _on_curves(pieces: Pieces, lines: Lines, alignment: Alignment, along: Array) -> Pieces:
    """Give pieces of curves the mean foot and direction of their samples."""
    chord = alignment.leg[pieces.samples].astype(np.int64)
    foot = lines.at(along, chord)
    direction = pieces.mean_of([lines.unit[chord]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    curved = lines.shape.curved[pieces.leg][:, None]
    return replace(
        pieces,
        origin=np.where(curved, pieces.mean_of([foot]), pieces.origin),
        direction=np.where(curved, direction, pieces.direction),
        leg=lines.shape.group[pieces.leg],
        chord=pieces.leg,
    )


def _collect(
    samples: Samples,
    chosen: Index,
    piece: Small,
    alignment: Alignment,
    unit: Array,
    speed: Array,
    place: Array,
    far: Index,
) -> Pieces:
    there = np.bincount(piece) > 0
    count = int(there.sum())
    dense = (np.cumsum(there, dtype=np.int32) - 1)[piece]
    means = _Means(dense, count)
    time = samples.time
    rate = 1.0 / max(samples.step, 1e-9)
    first = np.zeros(count, dtype=np.int64)
    first[dense[::-1]] = chosen[::-1]
    leg = alignment.leg[first].astype(np.int64)
    return Pieces(
        xyz=np.stack([means.mean(samples.xyz[chosen, k]) for k in range(3)], axis=1),
        leg=leg,
        origin=alignment.corners[leg],
        direction=unit[leg],
        side=sides_of_travel(unit)[leg],
        count=means.count,
        time=means.mean(time[chosen]),
        duration=means.count / rate,
        speed=means.mean(speed),
        samples=chosen.astype(np.int32),
        piece=dense,
        used=len(chosen),
        outliers=len(far),
        end=float(time[-1]),
        far=far.astype(np.int32),
        spread=np.sqrt(np.maximum(means.mean(place**2) - means.mean(place) ** 2, 0.0)),
    )
