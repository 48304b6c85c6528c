# SPDX-License-Identifier: Apache-2.0
"""Samples of matched parts reduced to pieces of the curves, or to stops at the corners.

A piece ends where any axis crosses a node of its table, and is short in travel and in rotation.
Deviations are those of the samples from their own places on the curve, so that no sagitta enters
their mean; the direction in which nothing is known is the mean direction of travel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array, Index
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.axis_path import driven_through, position_at, travel_of_legs
from otf_core.model.machine import Machine
from otf_core.model.observation import Samples
from otf_core.model.path import leg_bounds, sides_of_travel
from otf_core.model.tables import ErrorTables
from otf_core.noise.standstill import find_standstills
from otf_core.pieces.pieces import outlying
from otf_core.rotary.curve_matching import HALF_CHORD, MatchedRun, closest
from otf_core.rotary.track import Curve

TOGETHER = 60
"""Pieces that share slow noise at most."""
FEW = 2
"""Samples of a piece at least."""
LEAST_CHORD = 0.9
"""Length of a chord over its arc of 4 mm; where a curve turns back more sharply, as that of a
reflector which almost stands while the axes turn, the closest place is ambiguous."""
AT_STOP = 1.5e-3
"""m; stops are this near their corners."""
LATE_NS = 0.5e9
"""ns without a sample after which another piece begins."""
GENTLE = 0.05
"""s; left out at both ends of a standstill beside what its speed leaves out."""
SETTLED = 0.05
"""s; shortest stop that is averaged."""


@dataclass(frozen=True)
class AxisPieces:
    """Means over pieces of the curves of one run, in driving order.

    Attributes
    ----------
    q : ndarray, shape (p, k), m and rad
        Axis positions in the middle.
    step : ndarray, shape (p, k)
        Change of the axis positions per unit of place: q moves along it.
    spread : ndarray, shape (p,)
        Standard deviation of the places of the samples, in legs.
    xyz : ndarray, shape (p, 3), m
        Mean measured point, tracker frame.
    nominal : ndarray, shape (p, 3), m
        Mean nominal point at the places of the samples.
    direction : ndarray, shape (p, 3)
        Unit direction of travel in the frame of the tracker's link; zero at stops.
    part : ndarray of int64, shape (p,)
    leg : ndarray of int64, shape (p,)
        Pieces that share slow noise.
    stretch : ndarray of int64, shape (p,)
        Smooth stretch of the path between two corners.
    side : ndarray, shape (p, k)
        Sense of the last travel of every axis.
    rate : ndarray, shape (p, k), m/s and rad/s
        Speeds of the axes.
    count : ndarray of int64, shape (p,)
    time, duration : ndarray, shape (p,), s
    samples, used, outliers : int
        Of the recording, in pieces, left out for their distance.
    standstill : bool
        All three directions count.
    """

    q: Array
    step: Array
    spread: Array
    xyz: Array
    nominal: Array
    direction: Array
    part: Index
    leg: Index
    stretch: Index
    side: Array
    rate: Array
    count: Index
    time: Array
    duration: Array
    samples: int = 0
    used: int = 0
    outliers: int = 0
    standstill: bool = False
    stamps: tuple[int, int] = field(default=(0, 0))

    def __len__(self) -> int:
        """Number of pieces."""
        return len(self.leg)

    @property
    def origin(self) -> Array:
        """Nominal points, which tell lines apart."""
        return self.nominal

    def without(self, drop: NDArray[np.bool_]) -> AxisPieces:
        """Leave some out."""
        if not drop.any():
            return self
        names = (
            'q', 'step', 'spread', 'xyz', 'nominal', 'direction', 'part', 'leg', 'stretch',
            'side', 'rate', 'count', 'time', 'duration',
        )  # fmt: skip
        fields = {name: getattr(self, name)[~drop] for name in names}
        lost = int(self.count[drop].sum())
        return replace(self, **fields, used=self.used - lost, outliers=self.outliers + lost)


@dataclass(frozen=True)
class Reach:
    """Lengths along a path by the travel of its axes, see ``axis_path.travel_per_unit``.

    Attributes
    ----------
    corners : ndarray, shape (n,), m
        From the first corner to every corner.
    stretch : ndarray of int64, shape (n - 1,)
        Smooth stretch of every leg.
    ends : ndarray, shape (s, 2), m
        Where every stretch begins and ends.
    """

    corners: Array
    stretch: Index
    ends: Array

    @classmethod
    def of(cls, machine: Machine, positions: Array) -> Reach:
        """Lengths along corners (n, k)."""
        length = travel_of_legs(machine, positions)
        turned = ~driven_through(machine, positions)
        stretch = np.append(0, np.cumsum(turned)).astype(np.int64)
        corners = np.append(0.0, np.cumsum(length))
        first = np.flatnonzero(np.append(True, turned))
        ends = np.stack([corners[first], corners[np.append(first[1:], len(length))]], axis=1)
        return cls(corners, stretch, ends)


def reduce_to_pieces(
    samples: Samples,
    matched: MatchedRun,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    tables: ErrorTables | None = None,
) -> AxisPieces:
    """Average samples over pieces.

    Parameters
    ----------
    nodes : mapping of axis to ndarray, m and rad
    tables : ErrorTables, optional
        Errors that are taken off before the closest places are looked for.

    Raises
    ------
    InputError
        If nothing is left.
    """
    parts = range(len(matched.parts))
    tried = [_of_part(samples, matched, k, nodes, config, tables) for k in parts]
    reduced = [f for f in tried if f is not None]
    if not reduced:
        raise InputError('no sample is left on the path away from its corners')
    return join_parts(samples, reduced)


def join_parts(samples: Samples, parts: Sequence[AxisPieces]) -> AxisPieces:
    """Pieces of several parts as one, legs and stretches numbered through."""
    legs = np.cumsum([0, *(f.leg.max() + 1 for f in parts)])
    stretches = np.cumsum([0, *(f.stretch.max() + 1 for f in parts)])
    names = (
        'q', 'step', 'spread', 'xyz', 'nominal', 'direction', 'part', 'side', 'rate', 'count',
        'time', 'duration',
    )  # fmt: skip
    arrays = {n: np.concatenate([getattr(f, n) for f in parts]) for n in names}
    return AxisPieces(
        **arrays,
        leg=np.concatenate([f.leg + n for f, n in zip(parts, legs, strict=False)]),
        stretch=np.concatenate([f.stretch + n for f, n in zip(parts, stretches, strict=False)]),
        samples=len(samples),
        used=sum(f.used for f in parts),
        outliers=sum(f.outliers for f in parts),
        standstill=parts[0].standstill,
        stamps=(int(samples.stamp_ns[0]), int(samples.stamp_ns[-1])),
    )


def _of_part(
    samples: Samples,
    matched: MatchedRun,
    number: int,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    tables: ErrorTables | None,
) -> AxisPieces | None:
    machine, part = matched.machine, matched.parts[number]
    positions, sight = part.path.positions, matched.sight(part.path.target)
    reach = Reach.of(machine, positions)
    own = _away_from_corners(np.arange(part.first, part.last), matched.place, reach, config)
    if len(own) < 10:
        return None
    points = matched.pose.apply(samples.xyz[own])
    curve, wanted = Curve.of(sight, positions), points
    if tables is not None:
        errors = sight.at(position_at(positions, curve.place)).displacement(tables)
        there = [np.interp(matched.place[own], curve.place, error) for error in errors.T]
        wanted = points - np.stack(there, axis=1)
    place, seen, tangent = closest(sight, curve, matched.place[own], wanted)
    offset = np.ascontiguousarray((points - seen.position).T)
    stretch = reach.stretch[_leg_of(place, positions)]
    far = outlying(
        lambda chosen: np.ascontiguousarray(offset[:, chosen]),
        leg_bounds(stretch),
        config.outlier_limit,
    )
    keep = np.flatnonzero(~far & (chord_shares(curve, place, stretch, reach) > LEAST_CHORD))
    if len(keep) < 10:
        return None
    line = _Line(own[keep], place[keep], seen.position[keep], tangent[keep])
    return replace(
        _averaged(samples, matched, number, line, reach, nodes, config), outliers=int(far.sum())
    )


@dataclass(frozen=True)
class _Line:
    """Samples of a part in steady motion.

    Attributes
    ----------
    own : ndarray of int64, shape (n,)
        In the recording.
    place : ndarray, shape (n,)
    nominal, tangent : ndarray, shape (n, 3)
        Closest point of the curve, m, and its direction.
    """

    own: Index
    place: Array
    nominal: Array
    tangent: Array


def _leg_of(place: Array, positions: Array) -> Index:
    return np.clip(place.astype(np.int64), 0, len(positions) - 2)


def chord_shares(curve: Curve, place: Array, stretch: Index, reach: Reach) -> Array:
    """Lengths (n,) of symmetric chords about places over those of their arcs on the stretch."""
    along = curve.reach_at(place)
    first = curve.reach_at(np.searchsorted(reach.stretch, stretch).astype(float))
    last = curve.reach_at(np.searchsorted(reach.stretch, stretch, side='right').astype(float))
    half = np.minimum(HALF_CHORD, np.minimum(along - first, last - along))
    half = np.maximum(half, 1e-5)
    chord = curve.at(along + half) - curve.at(along - half)
    return np.asarray(np.linalg.norm(chord, axis=1) / (2.0 * half))


def _away_from_corners(own: Index, place: Array, reach: Reach, config: CalibrationConfig) -> Index:
    """Samples that are not near the ends of their stretch."""
    corners = np.arange(len(reach.corners))
    along = np.interp(place[own], corners, reach.corners)
    leg = np.clip(place[own].astype(np.int64), 0, len(corners) - 2)
    ends = reach.ends[reach.stretch[leg]]
    margin = np.minimum(config.corner_exclusion, 0.25 * (ends[:, 1] - ends[:, 0]))
    return own[(along - ends[:, 0] > margin) & (ends[:, 1] - along > margin)]


def _averaged(
    samples: Samples,
    matched: MatchedRun,
    number: int,
    line: _Line,
    reach: Reach,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
) -> AxisPieces:
    """Means over the pieces of a part."""
    positions = matched.parts[number].path.positions
    leg = _leg_of(line.place, positions)
    stretch, q = reach.stretch[leg], position_at(positions, line.place)
    piece = _pieces_of(matched.machine, samples, line, q, stretch, reach, nodes, config)
    total = int(piece[-1]) + 1
    count = np.bincount(piece, minlength=total)

    def mean(values: Array) -> Array:
        if values.ndim == 1:
            return np.bincount(piece, values, total) / count
        return np.stack([np.bincount(piece, v, total) / count for v in values.T], axis=1)

    direction = mean(line.tangent)
    size = np.linalg.norm(direction, axis=1)
    middle, time = mean(line.place), mean(samples.time[line.own])
    first = np.searchsorted(piece, np.arange(total))
    steps = np.diff(positions, axis=0)
    unit = steps / np.maximum(np.abs(steps).max(axis=1, keepdims=True), 1e-12)
    pieces = AxisPieces(
        q=mean(q),
        step=mean(steps[leg]),  # a piece may lie on several chords of a smooth stretch
        spread=np.sqrt(np.maximum(mean(line.place**2) - middle**2, 0.0)),
        xyz=mean(samples.xyz[line.own]),
        nominal=mean(line.nominal),
        direction=direction / np.maximum(size, 1e-12)[:, None],
        part=np.full(total, number),
        leg=_shared(stretch[first], time),
        stretch=stretch[first],
        side=sides_of_travel(unit)[leg[first]],
        rate=_rates(mean(q), time, stretch[first]),
        count=count,
        time=time,
        duration=np.asarray(count * samples.step, dtype=np.float64),
        used=len(line.own),
    )
    return pieces.without((count < FEW) | (size < 0.5))


def _rates(q: Array, time: Array, stretch: Index) -> Array:
    """Speeds of the axes (p, k) from the neighbours of every piece on its stretch."""
    place = np.arange(len(q))
    same = stretch[1:] == stretch[:-1]
    before, after = place - np.append(False, same), place + np.append(same, False)
    return np.asarray(
        (q[after] - q[before]) / np.maximum(time[after] - time[before], 1e-9)[:, None]
    )


def _pieces_of(
    machine: Machine,
    samples: Samples,
    line: _Line,
    q: Array,
    stretch: Index,
    reach: Reach,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
) -> Index:
    """Number of the piece of every sample, shape (n,)."""
    along = np.interp(line.place, np.arange(len(reach.corners)), reach.corners)
    key = [stretch, np.floor((along - reach.ends[stretch, 0]) / config.piece_length)]
    for k, axis in enumerate(machine.axis_names):
        key.append(np.searchsorted(nodes[axis], machine.axes[axis].wrapped(q[:, k]) + 1e-9))
    marks = np.stack([np.asarray(own, dtype=np.int64) for own in key], axis=1)
    new = np.append(True, np.any(np.diff(marks, axis=0) != 0, axis=1))
    late = np.append(False, np.diff(samples.stamp_ns[line.own]) > LATE_NS)
    return np.asarray(np.cumsum(new | late) - 1)


def _shared(stretch: Index, time: Array) -> Index:
    """Number of the pieces that share slow noise: of one stretch, not too many, without a gap."""
    new = np.append(True, np.diff(stretch) != 0) | np.append(False, np.diff(time) > 5.0)
    start = np.maximum.accumulate(np.where(new, np.arange(len(stretch)), 0))
    place = np.arange(len(stretch)) - start
    return np.asarray(np.cumsum(new | (place % TOGETHER == 0)) - 1)


def reduce_to_stops(
    samples: Samples, matched: MatchedRun, config: CalibrationConfig
) -> AxisPieces:
    """Average the stops at the corners.

    Raises
    ------
    InputError
        If there are none.
    """
    parts = []
    for number, part in enumerate(matched.parts):
        one = _stops_of_part(samples, matched, number, config)
        if one is None:
            raise InputError(
                f"part {number + 1} ('{part.path.target}'): no stop lies at a corner of its path; "
                f'use the method otf for a run without stops'
            )
        parts.append(one)
    return join_parts(samples, parts)


def at_stops(samples: Samples, config: CalibrationConfig) -> Index:
    """First and one past the last sample of the standstills, shape (k, 2), without their ends.

    A reflector near an axis starts and stops so gently that a speed does not show it.
    """
    margin = round(GENTLE / samples.step)
    spans = find_standstills(samples, config.standstill_speed, SETTLED + 2.0 * GENTLE)
    return np.asarray(spans + np.array([margin, -margin]))


def _stops_of_part(
    samples: Samples, matched: MatchedRun, number: int, config: CalibrationConfig
) -> AxisPieces | None:
    part = matched.parts[number]
    positions, sight = part.path.positions, matched.sight(part.path.target)
    own = samples.part(part.first, part.last)
    spans = at_stops(own, config)
    corner_at = sight.nominal(positions)
    rows = []
    for a, b in spans.tolist():
        xyz = own.xyz[a:b]
        off = np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1)
        good = xyz[off <= config.outlier_limit * max(float(np.median(off)), 1e-9)]
        place = float(np.median(matched.place[part.first + a : part.first + b]))
        point = matched.pose.apply(good.mean(axis=0)[None])[0]
        low, high = max(0, int(place) - 2), min(len(positions), int(place) + 4)
        corner = low + int(np.argmin(np.linalg.norm(corner_at[low:high] - point, axis=1)))
        if np.linalg.norm(corner_at[corner] - point) < AT_STOP and len(good) > FEW:
            rows.append((corner, good.mean(axis=0), len(good), a, b))
    if not rows:
        return None
    columns = [np.array(v) for v in zip(*rows, strict=True)]
    at, xyz, count = columns[:3]
    first, last = columns[3] + part.first, columns[4] + part.first
    steps = np.diff(positions, axis=0, prepend=positions[:1])
    unit = steps / np.maximum(np.abs(steps).max(axis=1, keepdims=True), 1e-12)
    total, time = len(at), 0.5 * (samples.time[first] + samples.time[last - 1])
    return AxisPieces(
        q=positions[at],
        step=np.zeros_like(positions[at]),
        spread=np.zeros(total),
        xyz=xyz,
        nominal=corner_at[at],
        direction=np.zeros((total, 3)),
        part=np.full(total, number),
        leg=_shared(np.zeros(total, dtype=np.int64), time),
        stretch=np.arange(total),
        side=sides_of_travel(unit)[at],
        rate=np.zeros_like(positions[at]),
        count=count,
        time=time,
        duration=samples.time[last - 1] - samples.time[first],
        used=int(count.sum()),
        standstill=True,
    )
