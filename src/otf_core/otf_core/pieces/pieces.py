# SPDX-License-Identifier: Apache-2.0
"""Reduction of samples to path pieces (paper 2.3: 500 000 points to 4427 values).

A piece never crosses a table node, so every error table is linear inside it and the mean of its
samples loses nothing. Left out: corners, standstill and the moments around it, outliers. Curves
have pieces of their own kind, see ``curve_pieces``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import leg_bounds, sides_of_travel
from otf_core.tracking.alignment import Alignment
from otf_core.tracking.arcs import curvature
from otf_core.tracking.curve_pieces import curve_boundaries, near_joints
from otf_core.tracking.curves import SHORT_CURVE, Lines
from otf_core.tracking.matching import OFF_PATH

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLOCK = 65536
"""samples that are looked at in the machine frame at once: copies of all would be large."""
SPEED_WINDOW = 0.04
"""s; the speed of a sample is taken over this time."""

MEDIAN_HALF = 5
"""samples on either side that a sample is compared with to tell an outlier."""
GROSS = 3e-5
"""m; smaller deviations are never called outliers: they may be kinks of steep error tables, and
as bad samples they average out."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two independent normal components of unit variance."""


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
    samples : ndarray of int64, shape (u,)
        Places in the recording of the samples averaged; empty if not kept.
    piece : ndarray of int64, shape (u,)
        Piece of each of them.
    chord : ndarray of int64, shape (p,)
        Chord of the path on which the piece begins; empty if that is its leg.
    bend : ndarray, shape (p, 3), m/s^2
        Acceleration towards the inside of curves, machine frame; empty if there are none.
    spread : ndarray, shape (p,), m
        Standard deviation of the samples along the line; empty if pieces are points.
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
    samples: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    piece: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    chord: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    bend: Array = field(default_factory=lambda: np.zeros((0, 3)))
    spread: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def line(self) -> Index:
        """Straight line of the path on which each piece begins, shape (p,)."""
        return self.chord if len(self.chord) else self.leg

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.leg)

    def without(self, drop: NDArray[np.bool_]) -> Pieces:
        """Return the pieces that are not marked in ``drop``, shape (p,)."""
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
        kept = {name: getattr(self, name)[~drop] for name in arrays}
        stays = ~drop[self.piece]
        lost = int(self.count[drop].sum())
        return replace(
            self,
            **kept,
            samples=self.samples[stays],
            piece=(np.cumsum(~drop) - 1)[self.piece[stays]],
            chord=self.chord[~drop] if len(self.chord) else self.chord,
            bend=self.bend[~drop] if len(self.bend) else self.bend,
            spread=self.spread[~drop] if len(self.spread) else self.spread,
            used=self.used - lost,
            outliers=self.outliers + lost,
        )

    def mean_of(self, values: Array) -> Array:
        """Means over the pieces of values (u, ...) given for ``samples``."""
        ones = np.ones(len(self.piece)), (self.piece, np.arange(len(self.piece)))
        member = sparse.csr_array(sparse.coo_array(ones, shape=(len(self), len(self.piece))))
        total = (member @ values.reshape(len(values), -1)).reshape(len(self), *values.shape[1:])
        return np.asarray(total / self.count.reshape(-1, *([1] * (values.ndim - 1))))


def piece_boundaries(corners: Array, leg: int, nodes: tuple[Array, ...], size: float) -> Array:
    """Piece boundaries along one leg, m from its start: node crossings, then equal parts."""
    step = corners[leg + 1] - corners[leg]
    length = float(np.linalg.norm(step))
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


def _moving(samples: Samples, along: Array, leg: Index, config: CalibrationConfig) -> Array:
    """Speed of every sample along its leg, m/s; zero near standstill and leg changes."""
    half = max(1, round(0.5 * SPEED_WINDOW / samples.step))
    speed = np.zeros(len(samples))
    if len(samples) <= 2 * half:
        return speed
    span = (samples.stamp_ns[2 * half :] - samples.stamp_ns[: -2 * half]) * 1e-9
    same = leg[2 * half :] == leg[: -2 * half]
    advance = np.where(same, along[2 * half :] - along[: -2 * half], 0.0)
    speed[half:-half] = np.abs(advance) / np.maximum(span, 1e-9)
    still = np.flatnonzero(speed < config.standstill_speed)
    reach = np.zeros(len(samples) + 1)
    np.add.at(reach, np.maximum(still - half, 0), 1)
    np.add.at(reach, np.minimum(still + half + 1, len(samples)), -1)
    return np.where(np.cumsum(reach[:-1]) > 0, 0.0, speed)


class _Means:
    """Sums per piece of quantities of its samples."""

    def __init__(self, piece: Index, total: int) -> None:
        self._piece, self._total = piece, total
        self.count = np.bincount(piece, minlength=total)

    def mean(self, values: Array) -> Array:
        """Mean per piece, shape (total,); 0 for an empty piece."""
        sums = np.bincount(self._piece, values, self._total)
        return np.asarray(sums / np.maximum(self.count, 1))


def _outliers(offset: Array, leg: Index, limit: float) -> NDArray[np.bool_]:
    """Samples far from the running median of their leg, by robust standard deviation.

    No sample is further from its median than the samples around it are apart, so where these
    are all within ``GROSS`` there is nothing to look for. The ends of a leg are continued by
    point reflection, which keeps the slope; the end sample, about which it is reflected, is
    compared with the extrapolated median instead.
    """
    bounds = leg_bounds(leg)
    if all(_apart(offset[low:high]) < GROSS for low, high in bounds):
        return np.zeros(len(offset), dtype=bool)
    rest = np.zeros_like(offset)
    for low, high in bounds:
        if high - low <= MEDIAN_HALF:
            rest[low:high] = offset[low:high] - np.median(offset[low:high], axis=0)
            continue
        part = offset[low:high]
        reach = ((MEDIAN_HALF, MEDIAN_HALF), (0, 0))
        padded = np.pad(part, reach, mode='reflect', reflect_type='odd')
        smooth = median_filter(padded, size=(2 * MEDIAN_HALF + 1, 1))[MEDIAN_HALF:-MEDIAN_HALF]
        rest[low:high] = part - smooth
        rest[low] = part[0] - (2 * smooth[1] - smooth[2])
        rest[high - 1] = part[-1] - (2 * smooth[-2] - smooth[-3])
    distance = np.linalg.norm(rest, axis=1)
    sigma = float(np.median(distance)) / RAYLEIGH_MEDIAN
    return np.asarray(distance > max(limit * sigma, GROSS))


def _apart(offset: Array) -> float:
    """Bound on the distance of the samples of a leg (n, 3), m, from their running median."""
    size = 2 * MEDIAN_HALF + 1
    if len(offset) <= size:
        return float(np.linalg.norm(np.ptp(offset, axis=0))) * (3.0 if len(offset) > 1 else 1.0)
    spread = maximum_filter1d(offset, size, axis=0) - minimum_filter1d(offset, size, axis=0)
    reach = spread[[MEDIAN_HALF, -MEDIAN_HALF - 1]].max(axis=0)
    return float(np.linalg.norm(np.maximum(spread.max(axis=0), 3.0 * reach)))


def samples_on_lines(
    samples: Samples, alignment: Alignment, config: CalibrationConfig
) -> tuple[Index, Array, Array, int]:
    """Samples in steady motion on the lines of the path.

    Returns
    -------
    index : ndarray of int64, shape (n,)
        Neither near corners nor standing still nor outliers.
    along : ndarray, shape (n,), m
        From the start of the leg or chord.
    speed : ndarray, shape (n,), m/s
    outliers : int
        Samples left out as outliers.

    Raises
    ------
    InputError
        If there is none.
    """
    leg = np.where(alignment.leg == OFF_PATH, 0, alignment.leg)
    pose, lines = alignment.T_machine_tracker, Lines.of(alignment.shape)
    on_chord = np.empty(len(samples))
    for part in _blocks(len(samples)):
        on_chord[part] = lines.along(pose.apply(samples.xyz[part]), leg[part])
    along = lines.start[leg] + on_chord
    stretch = np.where(alignment.leg == OFF_PATH, OFF_PATH, lines.shape.stretch[leg])
    speed = _moving(samples, along, stretch, config)
    low, high = _margins(lines, alignment, config)
    keep = (alignment.leg != OFF_PATH) & (speed > 0)
    keep &= (along > low[leg]) & (along < lines.total[leg] - high[leg])
    if not lines.shape.straight:
        keep &= ~near_joints(lines, leg, on_chord, config.corner_exclusion)
    chosen = np.flatnonzero(keep)
    if not len(chosen):
        raise InputError('no sample is left on the lines of the path away from corners and stops')
    offset = np.empty((len(chosen), 3))
    for part in _blocks(len(chosen)):
        here = chosen[part]
        line = leg[here]
        offset[part] = pose.apply(samples.xyz[here]) - on_chord[here, None] * lines.unit[line]
        bent = lines.shape.curved[line]
        offset[part][bent] -= lines.shape.corners[line[bent]]
    far = _outliers(offset, stretch[chosen], config.outlier_limit)
    chosen = chosen[~far]
    return chosen, on_chord[chosen], speed[chosen], int(far.sum())


def _blocks(count: int) -> list[slice]:
    return [slice(low, low + BLOCK) for low in range(0, count, BLOCK)]


def _margins(lines: Lines, alignment: Alignment, config: CalibrationConfig) -> tuple[Array, Array]:
    """Length left out at the start and the end of the leg or curve of every chord, m.

    A curve so short that nothing else is left of it is the rounding of a corner.
    """
    short = 0.25 * lines.total
    short[lines.shape.curved & (lines.total < SHORT_CURVE * config.corner_exclusion)] = np.inf
    margin = np.minimum(config.corner_exclusion, short)
    margin = np.where(np.isinf(short), lines.total, margin)
    if alignment.rounded is None:
        return margin, margin
    low, high = alignment.rounded.T
    return np.maximum(margin, low), np.maximum(margin, high)


def reduce_to_pieces(
    samples: Samples, alignment: Alignment, nodes: tuple[Array, ...], config: CalibrationConfig
) -> Pieces:
    """Average samples over path pieces.

    Parameters
    ----------
    samples : Samples
    alignment : Alignment
    nodes : three ndarrays, m
        Table nodes of X, Y, Z; pieces end there.
    config : CalibrationConfig

    Raises
    ------
    InputError
        If nothing is left.
    """
    chosen, along, speed, outliers = samples_on_lines(samples, alignment, config)
    lines, leg = Lines.of(alignment.shape), alignment.leg[chosen]
    shape = lines.shape
    first = np.unique(shape.group)
    marks = _marks(lines, first, nodes, config.piece_length)
    shift = np.concatenate([[0.0], np.cumsum([m[-1] + 1.0 for m in marks])])
    bounds = np.concatenate([m + s for m, s in zip(marks, shift[:-1], strict=True)])
    group = shape.group[leg]
    place = (lines.start[leg] - lines.start[group]) + along
    place = np.where(shape.curved[leg], np.maximum(place, 0.0), place)
    piece = np.searchsorted(bounds, shift[np.searchsorted(first, group)] + place, side='right') - 1
    pieces = _collect(samples, chosen, piece, alignment, lines.unit, speed, place, outliers)
    return pieces if shape.straight else _on_curves(pieces, lines, alignment, along, speed)


def _marks(lines: Lines, first: Index, nodes: tuple[Array, ...], size: float) -> list[Array]:
    """Piece boundaries of every leg or part of a curve, m from its start."""
    corners, ends = lines.shape.corners, np.append(first[1:], len(lines.length))
    return [
        piece_boundaries(corners, a, nodes, size)
        if b == a + 1
        else curve_boundaries(corners[a : b + 1], nodes, size)
        for a, b in zip(first.tolist(), ends.tolist(), strict=True)
    ]


def _on_curves(
    pieces: Pieces, lines: Lines, alignment: Alignment, along: Array, speed: Array
) -> Pieces:
    """Give pieces of curves the mean foot, direction and acceleration of their samples."""
    chord = alignment.leg[pieces.samples]
    foot = lines.at(along, chord)
    direction = pieces.mean_of(lines.unit[chord])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    curved = lines.shape.curved[pieces.leg][:, None]
    bend = curvature(lines).mean(axis=1)[chord] * speed[:, None] ** 2
    return replace(
        pieces,
        origin=np.where(curved, pieces.mean_of(foot), pieces.origin),
        direction=np.where(curved, direction, pieces.direction),
        leg=lines.shape.group[pieces.leg],
        chord=pieces.leg,
        bend=pieces.mean_of(bend),
    )


def _collect(
    samples: Samples,
    chosen: Index,
    piece: Index,
    alignment: Alignment,
    unit: Array,
    speed: Array,
    place: Array,
    outliers: int,
) -> Pieces:
    names, dense = np.unique(piece, return_inverse=True)
    means = _Means(dense, len(names))
    time = samples.time
    rate = 1.0 / max(samples.step, 1e-9)
    first = np.zeros(len(names), dtype=np.int64)
    first[dense[::-1]] = chosen[::-1]
    leg = alignment.leg[first]
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
        samples=chosen,
        piece=np.asarray(dense, dtype=np.int64),
        used=len(chosen),
        outliers=outliers,
        end=float(time[-1]),
        spread=np.sqrt(np.maximum(means.mean(place**2) - means.mean(place) ** 2, 0.0)),
    )
