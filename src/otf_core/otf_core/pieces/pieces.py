# SPDX-License-Identifier: Apache-2.0
"""Reduction of samples to path pieces (paper 2.3: 500 000 points to 4427 values).

A piece never crosses a table node, so every error table is linear inside it and the mean of its
samples loses nothing. Left out: corners, also where the control rounds them further, standstill
and the moments around it, and outliers, which are samples far from the running median of their
leg. Curves have pieces of their own kind, see ``tracking.curves``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.blocks import blocks
from otf_core.config import OTF, CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import leg_bounds, sides_of_travel
from otf_core.model.tables import ErrorTables
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.curves import SHORT_CURVE, STANDS, Lines, PathShape, piece_boundaries
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


Small = NDArray[np.int32]

SPEED_WINDOW = 0.04
"""s; the speed of a sample is taken over this time."""


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Means over pieces of the path, or stops, in driving order; p of them, of k axes.

    Attributes
    ----------
    q : ndarray, shape (p, k), m and rad
        Axis positions at the mean place of the samples on the path; at a stop those of its point.
    step : ndarray, shape (p, k)
        Change of the axis positions per unit of place: on a straight line the unit direction, so
        that places are in m, on a curve the change over one leg of the path; at stops that of
        the approach.
    spread : ndarray, shape (p,)
        Standard deviation of the places of the samples: q +- spread step are two Gauss points.
    xyz : ndarray, shape (p, 3), m
        Mean measured point, tracker frame.
    nominal : ndarray, shape (p, 3), m
        Mean nominal point at the places of the samples, in the frame that the pose leads to.
    direction : ndarray, shape (p, 3)
        Unit direction of travel in that frame, on a curve the mean one; at stops the direction
        of approach, zero where unknown.
    origin : ndarray, shape (p, 3), m
        Start of the straight line of a piece, which tells lines apart; else the nominal point.
    part : ndarray of int64, shape (p,)
        Part of the run: what is driven with one reflector in view.
    leg : ndarray of int64, shape (p,)
        Pieces that share slow noise.
    stretch : ndarray of int64, shape (p,)
        Straight line of the path (on a curve of chords that on which the piece begins), or smooth
        stretch in the axes.
    side : ndarray, shape (p, k)
        Sense of the last travel of every axis, see ``path.sides_of_travel``.
    rate : ndarray, shape (p, k), m/s and rad/s
        Speeds of the axes.
    speed : ndarray, shape (p,), m/s
        Of the reflector along the path.
    count : ndarray of int64, shape (p,)
        Samples averaged.
    time, duration : ndarray, shape (p,), s
        Mean time since the first sample of the recording.
    used, outliers : int
        Samples in all pieces, and left out as outliers.
    end : float
        s, since the first sample, of the end of the recording; 0 stands for the last piece.
    method : str
        'otf'; 'standstill': the pieces are stops, where all three directions count; 'points': they
        are components of pairs, each in its ``direction`` of the measured frame.
    samples, piece : ndarray of int32, shape (u,)
        Places in the recording of the samples averaged, and the piece of each; empty if not kept.
    far : ndarray of int32, shape (o,)
        Places in the recording of samples on the lines that are in no piece as they are far from
        those around them.
    stamps : tuple of int, ns
        Of the first and last sample of the recording.
    """

    q: Array
    step: Array
    spread: Array
    xyz: Array
    nominal: Array
    direction: Array
    origin: Array
    part: Index
    leg: Index
    stretch: Index
    side: Array
    rate: Array
    speed: Array
    count: Index
    time: Array
    duration: Array
    used: int = 0
    outliers: int = 0
    end: float = 0.0
    method: str = OTF
    samples: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    piece: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    far: Small = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    stamps: tuple[int, int] = (0, 0)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.leg)

    @property
    def standstill(self) -> bool:
        """Whether nothing moves in them."""
        return self.method != OTF

    def without(self, drop: NDArray[np.bool_]) -> Pieces:
        """Return the pieces that are not marked in ``drop``, shape (p,)."""
        if not drop.any():
            return self
        stays, lost = ~drop[self.piece], int(self.count[drop].sum())
        return replace(
            self,
            **{name: getattr(self, name)[~drop] for name in OF_EACH},
            samples=self.samples[stays],
            piece=(np.cumsum(~drop, dtype=self.piece.dtype) - 1)[self.piece[stays]],
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


OF_EACH = tuple(f.name for f in fields(Pieces) if f.default is f.default_factory is MISSING)
"""Names of the arrays with a row for every piece."""


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


LEAST_CHORD = 0.9
"""Length of a chord over its arc of 4 mm; where a curve turns back more sharply, as that of a
reflector which almost stands while the axes turn, the closest place is ambiguous."""
LEAST_DIRECTION = 0.5
"""Length of the mean of the unit directions in a piece; below there is no direction of travel."""


@dataclass(frozen=True)
class _Steady:
    """Samples in steady motion on the lines of the path.

    Attributes
    ----------
    index : ndarray of int64, shape (n,)
        Places in the recording.
    chord : ndarray, shape (n,)
    along : ndarray, shape (n,), m
        From the start of the chord.
    speed : ndarray, shape (n,), m/s
        Of the travel of the axes.
    nominal, tangent : ndarray, shape (n, 3), optional
        Nominal point, m, and direction of travel where chords stand for curves, else zero; None
        if none does.
    """

    index: Index
    chord: Index
    along: Array
    speed: Array
    nominal: Array | None = None
    tangent: Array | None = None

    def at(self, keep: NDArray[np.bool_]) -> _Steady:
        """Return some of the samples."""
        arrays: dict[str, Any] = {
            n: own if own is None else own[keep] for n, own in vars(self).items()
        }
        return replace(self, **arrays)


def _steady_samples(
    samples: Samples,
    alignment: Alignment,
    lines: Lines,
    config: CalibrationConfig,
    tables: ErrorTables | None,
) -> tuple[_Steady, Index]:
    """Samples on lines, neither near corners nor standing still nor outliers; and the outliers.

    Raises
    ------
    InputError
        If there is none.
    """
    leg = np.where(alignment.leg == OFF_PATH, 0, alignment.leg)
    pose, shape = alignment.T_machine_tracker, lines.shape
    seen, per_length = lines.seen_from(pose), lines.travel_per_length
    on_chord, along = np.empty((2, len(samples)))
    for part in blocks(len(samples)):
        here = leg[part]
        on_chord[part] = seen.along(samples.xyz[part], here)
        along[part] = lines.start[here] + on_chord[part] * per_length[here]
    stretch = np.where(alignment.leg == OFF_PATH, OFF_PATH, shape.stretch.astype(leg.dtype)[leg])
    speed = _moving(samples, along, stretch, config)
    margin = _margin(lines, config)
    keep = (alignment.leg != OFF_PATH) & (speed > 0)
    for part in blocks(len(samples)):
        here, own = leg[part], along[part]
        keep[part] &= (own > margin[here]) & (own < lines.total[here] - margin[here])
    chosen = np.flatnonzero(keep)
    del keep
    steady = _Steady(chosen, leg[chosen], on_chord[chosen], speed[chosen])
    if shape.sights:
        steady = _on_curves(samples, pose, lines, steady, tables)
    if not len(steady.index):
        raise InputError('no sample is left on the lines of the path away from corners and stops')
    curved = shape.curved

    def offset_of(part: slice) -> Array:
        line = steady.chord[part]
        offset = pose.apply(samples.xyz.take(steady.index[part], axis=0))
        offset -= steady.along[part, None] * lines.unit.take(line, axis=0)
        bent = curved[line]
        if bent.any():
            offset[bent] -= lines.corners[line[bent]]
        return np.ascontiguousarray(offset.T)

    def offset_on_curves(part: slice) -> Array:
        bent = curved[steady.chord[part]]
        offset = offset_of(part)
        if bent.any():
            assert steady.nominal is not None
            own = pose.apply(samples.xyz[steady.index[part][bent]]) - steady.nominal[part][bent]
            offset[:, bent] = own.T
        return offset

    offsets = offset_on_curves if shape.sights else offset_of
    on = steady.chord
    legs = [b for b in leg_bounds(shape.stretch[on]) if not curved[on[b[0]]]]
    reach = lines.start[on] + steady.along * per_length[on]
    steady = steady.at(~off_their_line(offsets, legs, reach, lines.total[on]))
    del on, reach
    out = outlying(offsets, leg_bounds(shape.stretch[steady.chord]), config.outlier_limit)
    return steady.at(~out), steady.index[out]


def _on_curves(
    samples: Samples,
    pose: RigidTransform,
    lines: Lines,
    steady: _Steady,
    tables: ErrorTables | None,
) -> _Steady:
    """Closest places, and nominal points, of samples where chords stand for curves."""
    shape = lines.shape
    chord, along = steady.chord.astype(np.int64), steady.along.copy()
    nominal, tangent = np.zeros((2, len(chord), 3))
    straight = np.ones(len(chord), dtype=bool)
    assert shape.part is not None
    for number, sight in enumerate(shape.sights):
        own = np.flatnonzero(shape.curved[chord] & (shape.part[chord] == number))
        if not len(own):
            continue
        points = pose.apply(samples.xyz[steady.index[own]])
        if tables is not None:
            points = points - lines.interpolated(
                sight.at(shape.positions).displacement(tables), chord[own], along[own]
            )
        chord[own], along[own], tangent[own], share = lines.closest(points, chord[own], along[own])
        q = lines.interpolated(shape.positions, chord[own], along[own])
        nominal[own] = sight.nominal(q)
        straight[own] = share > LEAST_CHORD
    keep = straight & (lines.length[chord] > STANDS)
    return _Steady(steady.index, chord, along, steady.speed, nominal, tangent).at(keep)


def _margin(lines: Lines, config: CalibrationConfig) -> Array:
    """Length left out at both ends of the leg or curve of every chord, m.

    A curve of linear axes so short that nothing else is left of it is the rounding of a corner.
    """
    margin = np.minimum(config.corner_exclusion, 0.25 * lines.total)
    if not lines.shape.sights:
        rounding = lines.shape.curved & (lines.total < SHORT_CURVE * config.corner_exclusion)
        margin[rounding] = lines.total[rounding]
    return margin


def reduce_to_pieces(
    samples: Samples,
    alignment: Alignment,
    nodes: Sequence[Array],
    config: CalibrationConfig,
    tables: ErrorTables | None = None,
) -> Pieces:
    """Average samples over path pieces.

    Parameters
    ----------
    nodes : sequence of ndarrays, m and rad
        Table nodes of the axes; pieces end there.
    tables : ErrorTables, optional
        Errors that are taken off before the closest places on curves are looked for.

    Raises
    ------
    InputError
        If nothing is left.
    """
    lines = Lines.of(alignment.shape)
    steady, far = _steady_samples(samples, alignment, lines, config, tables)
    shape, leg, per_length = lines.shape, steady.chord, lines.travel_per_length
    first = np.unique(shape.group)
    marks = _all_boundaries(lines, first, nodes, config.piece_length)
    shift = np.concatenate([[0.0], np.cumsum([m[-1] + 1.0 for m in marks])])
    bounds = np.concatenate([m + s for m, s in zip(marks, shift[:-1], strict=True)])
    place, piece = np.empty(len(leg)), np.empty(len(leg), dtype=np.int32)
    for part in blocks(len(leg)):
        here = leg[part]
        group = shape.group[here]
        own = (lines.start[here] - lines.start[group]) + steady.along[part] * per_length[here]
        place[part] = own = np.where(shape.curved[here], np.maximum(own, 0.0), own)
        beyond = shift[np.searchsorted(first, group)] + own
        piece[part] = np.searchsorted(bounds, beyond, side='right') - 1
    pieces = _collect(samples, steady, piece, lines, place)
    pieces = replace(pieces, outliers=len(far), far=far.astype(np.int32))
    if shape.straight:
        return pieces
    return _bent(pieces, lines, steady)


def _all_boundaries(
    lines: Lines, first: Index, nodes: Sequence[Array], size: float
) -> list[Array]:
    """Piece boundaries of every leg or part of a curve, m from its start.

    ``first`` (k,) is the first leg of each; see ``curves.piece_boundaries``.
    """
    shape, ends = lines.shape, np.append(first[1:], len(lines.length))
    travel, periods = shape.travel, shape.periods
    known: dict[bytes, Array] = {}  # laps drive the same lines

    def boundaries(a: int, b: int) -> Array:
        driven = shape.positions[a : b + 1]
        key = driven.tobytes()
        if key not in known:
            unit = lines.unit[a:b] if b > a + 1 else None
            known[key] = piece_boundaries(driven, nodes, size, travel[a:b], unit, periods)
        return known[key]

    return [boundaries(a, b) for a, b in zip(first.tolist(), ends.tolist(), strict=True)]


def _bent(pieces: Pieces, lines: Lines, steady: _Steady) -> Pieces:
    """Give pieces of curves the mean place and direction of their samples."""
    chord, shape = steady.chord.astype(np.int64), lines.shape
    curved = shape.curved[pieces.stretch][:, None]

    def mean(values: Array, before: Array) -> Array:
        return np.where(curved, pieces.mean_of([values]), before)

    q = mean(lines.interpolated(shape.positions, chord, steady.along), pieces.q)
    if steady.nominal is None or steady.tangent is None:
        nominal, tangent = q, lines.unit[chord]
    else:
        nominal, tangent = mean(steady.nominal, pieces.nominal), steady.tangent
    direction = mean(tangent, pieces.direction)
    size = np.linalg.norm(direction, axis=1, keepdims=True)
    per_travel, speed = _per_travel(shape)[chord], steady.speed / lines.travel_per_length[chord]
    step = mean(per_travel, pieces.step) if shape.sights else direction / size
    pieces = replace(
        pieces,
        q=q,
        step=step,
        nominal=nominal,
        direction=direction / np.maximum(size, 1e-12),
        origin=np.where(curved, nominal, pieces.origin),
        leg=shape.group[pieces.stretch],
        stretch=shape.stretch[pieces.stretch] if shape.sights else pieces.stretch,
        rate=mean(per_travel * steady.speed[:, None], pieces.rate),
        speed=mean(speed[:, None], pieces.speed[:, None])[:, 0],
    )
    return pieces.without(size[:, 0] < LEAST_DIRECTION)


def _per_travel(shape: PathShape) -> Array:
    """Change of the axis positions per travel on every chord, shape (m, k)."""
    return np.asarray(np.diff(shape.positions, axis=0) / np.maximum(shape.travel, STANDS)[:, None])


def _collect(
    samples: Samples, steady: _Steady, piece: Small, lines: Lines, place: Array
) -> Pieces:
    """Means of the samples of every piece; on a curve as if its chord were a line."""
    shape, chosen = lines.shape, steady.index
    there = np.bincount(piece) > 0
    count = int(there.sum())
    dense = (np.cumsum(there, dtype=np.int32) - 1)[piece]
    means = _Means(dense, count)
    time = samples.time
    first = np.zeros(count, dtype=np.int64)
    first[dense[::-1]] = np.arange(len(chosen))[::-1]
    leg = steady.chord[first].astype(np.int64)
    per_travel, per_length = _per_travel(shape), lines.travel_per_length[leg]
    mean_speed, along = means.mean(steady.speed), means.mean(place)
    on_chord = along - (lines.start[leg] - lines.start[shape.group[leg]])
    nominal = shape.corners[leg] + (on_chord / per_length)[:, None] * lines.unit[leg]
    return Pieces(
        q=shape.positions[leg] + on_chord[:, None] * per_travel[leg],
        step=per_travel[leg],
        spread=np.sqrt(np.maximum(means.mean(place**2) - along**2, 0.0)),
        xyz=np.stack([means.mean(samples.xyz[chosen, k]) for k in range(3)], axis=1),
        nominal=nominal,
        direction=lines.unit[leg],
        origin=shape.corners[leg],
        part=np.zeros_like(leg) if shape.part is None else shape.part[leg],
        leg=leg,
        stretch=leg,
        side=_sides(shape)[leg],
        rate=mean_speed[:, None] * per_travel[leg],
        speed=mean_speed / per_length,
        count=means.count,
        time=means.mean(time[chosen]),
        duration=np.asarray(means.count * samples.step, dtype=np.float64),
        used=len(chosen),
        end=float(time[-1]),
        samples=chosen.astype(np.int32),
        piece=dense,
        stamps=(int(samples.stamp_ns[0]), int(samples.stamp_ns[-1])),
    )


def _sides(shape: PathShape) -> Array:
    """Sense of the last travel of every axis on every chord, part by part, shape (m, k)."""
    per_travel = _per_travel(shape)
    if shape.part is None:
        return sides_of_travel(per_travel)
    return np.concatenate([sides_of_travel(per_travel[a:b]) for a, b in leg_bounds(shape.part)])
