# SPDX-License-Identifier: Apache-2.0
"""Which sample belongs to which place of which part; pose of the tracker and places of reflectors.

Parts are distinguished by the broken beam. The arc length of the track says roughly how far a part
is driven; a rigid fit gives the pose, and pose, places of reflectors on the table and places on
the curves are then improved together: a sample of deviation d across the curve says

    d . a = (dt + dr x p) . a - (R dr_place) . a,    a across the direction of travel
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.axis_path import BREAK, AxisPath, driven_length, position_at
from otf_core.model.chain import ReflectorView, Sight
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.machine import SPINDLE, Machine
from otf_core.model.motions import DIRECTIONS, location_names
from otf_core.model.observation import Samples
from otf_core.tracking.alignment import Alignment, Part
from otf_core.tracking.arc_length import (
    LONGEST,
    MOST,
    STEP,
    TravelledTrack,
    assign_places,
    by_length,
)
from otf_core.tracking.curves import Lines, lines_of_part, shape_of_parts
from otf_core.tracking.driving_order import (
    OFF_PATH,
    assign_legs,
    is_as_planned,
    passages,
    visits,
)
from otf_core.tracking.matching import (
    MIN_SHARE_AS_PLANNED,
    MIN_SHARE_UNDOUBTED,
    MatchingInput,
    cut_track,
    driven_share_of,
)
from otf_core.tracking.measured_track import HOP, measured_track

MOST_BREAKS = 200
SAME_LENGTH = 0.1
"""Share by which the track of a whole part may be longer or shorter than its curve."""
MISMATCH = 0.3
"""Log of the ratio of measured and nominal length of a part that counts as one unit of misfit."""
KNOWN = 1e-4
"""m; places that are known better give the first pose."""
ROUNDS, QUICK_ROUNDS = 12, 5
QUICK_STEP, FEWEST, PLENTY = 6e-3, 200, 3000
"""m between places that are assigned to each other at first, or where it is only asked whether
they fit; and their number on a short part and on a long one."""
SETTLED = 1e-7
"""m; change of the points below which pose and places are good enough to start a solution from."""
WIDEST, NARROWEST = 0.15, 0.03
"""m; arc length about the expected one within which a track is matched, first and last."""
LEAST_OFF = 3e-6
"""m; nearer points count alike."""
NEAR = 2e-4
"""m; change of pose and places below which samples keep their legs."""
OFF_CURVE, OFF_RATIO = 4e-4, 8.0
"""m, and ratio to the median of its part: a sample further from its curve was driven elsewhere."""
JUMP = 1e-2
"""m; what is passed at once was not seen."""


def sight_at(machine: Machine, target: str, places: Mapping[str, Array]) -> Sight:
    """A target at the place that is known of it."""
    return replace(Sight.of_target(machine, target), place=places[target])


def split_parts(samples: Samples, machine: Machine, paths: Sequence[AxisPath]) -> list[Part]:
    """Tell the parts of a run apart by the broken beam.

    Where the beam was broken more often than parts were changed, the breaks are taken between
    which the track is about as long as the curve of every part. Of a recording that ended early
    the parts are those at the beginning of the path.

    Raises
    ------
    InputError
        If there are fewer breaks than parts call for, and the tracks are not those of the first.
    """
    ends = np.flatnonzero(np.diff(samples.stamp_ns) >= BREAK * 1e9) + 1
    if len(ends) > MOST_BREAKS:
        gaps = np.diff(samples.stamp_ns)[ends - 1]
        ends = np.sort(ends[np.argsort(gaps)[-MOST_BREAKS:]])
    marks = [0, *ends.tolist(), len(samples)]
    lengths = [
        TravelledTrack.of(samples, a, b).length if b - a > 50 else 0.0 for a, b in pairwise(marks)
    ]
    chords = [float(np.linalg.norm(samples.xyz[e] - samples.xyz[e - 1])) for e in ends]
    nominal = [
        float(lines_of_part(Sight.of_target(machine, p.target), p.positions).run[-1])
        for p in paths
    ]
    pieces = len(lengths)
    if pieces < len(paths):
        if not _are_first(lengths, nominal):
            raise InputError(
                f'the path has {len(paths)} parts, but breaks of the beam of 2 s or more number '
                f'{len(ends)}, not {len(paths) - 1}; break it while the reflector is moved by '
                f'hand between two parts, or give a recording for each part'
            )
        paths = paths[:pieces]
    best = np.full((len(paths) + 1, pieces + 1), np.inf)
    cut = np.zeros((len(paths) + 1, pieces + 1), dtype=np.int64)
    best[0, 0] = 0.0
    for k, wanted in enumerate(nominal, start=1):
        for end in range(k, pieces + 1):
            length = 0.0
            for start in range(end - 1, k - 2, -1):
                length += lengths[start] + (chords[start] if start < end - 1 else 0.0)
                off = np.log(max(length, 1e-3) / max(wanted, 1e-3)) / MISMATCH
                total = best[k - 1, start] + off * off
                if total < best[k, end]:
                    best[k, end], cut[k, end] = total, start
    parts: list[Part] = []
    end = pieces
    for k in range(len(paths), 0, -1):
        start = int(cut[k, end])
        parts.append(Part(paths[k - 1], marks[start], marks[end]))
        end = start
    return parts[::-1]


def _are_first(lengths: Sequence[float], nominal: Sequence[float]) -> bool:
    """Whether tracks are as long as the first curves, the last track at most."""
    share = np.array(lengths) / np.maximum(nominal[: len(lengths)], 1e-9)
    return bool(np.all(np.abs(share[:-1] - 1.0) <= SAME_LENGTH) and share[-1] <= 1.0 + SAME_LENGTH)


def nominal_places(machine: Machine) -> dict[str, Array]:
    """Places of all targets as machine.yaml states them."""
    return {name: np.array(t.place) for name, t in machine.targets.items()}


def is_known(machine: Machine, name: str) -> bool:
    """Return whether the place of a target is given well enough to find the tracker with it."""
    return machine.targets[name].link == SPINDLE or machine.targets[name].u <= KNOWN


@dataclass
class _Following:
    """A part while it is matched."""

    part: Part
    track: TravelledTrack
    reach: Array


@dataclass(frozen=True)
class _Start:
    """Parts as they were driven, and what is known of them before places are improved.

    Attributes
    ----------
    pose : RigidTransform, optional
        Tracker to the link that it stands on, if it is known.
    published : tuple of int
        Part of the path of every driven part.
    as_planned : bool
        Legs were driven forward and in order.
    rough : bool
        Reaches are those of arc lengths, right to centimetres; else to millimetres.
    coverage : float
        Driven share of the path where its order was found.
    """

    following: list[_Following]
    pose: RigidTransform | None
    published: tuple[int, ...]
    as_planned: bool
    rough: bool
    coverage: float = 1.0


def match(
    samples: Samples,
    machine: Machine,
    paths: Sequence[AxisPath],
    known: Alignment | None = None,
    *,
    quick: bool = False,
    in_any_order: bool = True,
) -> Alignment:
    """Find driving order, pose, places of reflectors and the place of every sample.

    Parameters
    ----------
    paths : sequence of AxisPath
        Parts in driving order, axes as of the machine.
    known : Alignment, optional
        With pose and places as they are known already.
    quick : bool
        Coarser and with fewer rounds: enough to tell whether it fits at all.
    in_any_order : bool
        Look for another order of the legs where the track does not follow the path as planned.

    Raises
    ------
    InputError
        If track and path do not belong together.
    """
    pose = known.T_machine_tracker if known else None
    places = dict(known.places) if known else nominal_places(machine)
    refused: InputError | None = None
    best: Alignment | None = None
    try:
        start = _start_by_lengths(samples, machine, paths, places, pose)
        best = _matched(samples, machine, paths, start, places, quick=quick)
    except InputError as error:
        refused = error
    if in_any_order and (best is None or best.followed < MIN_SHARE_AS_PLANNED):
        found = _start_by_order(samples, machine, paths, places, pose)
        if found is not None:
            other = _matched(samples, machine, paths, found, places, quick=True)
            again = _start_by_order(samples, machine, paths, other.places, other.T_machine_tracker)
            if again is not None:
                other = _matched(samples, machine, paths, again, other.places, quick=quick)
            if best is None or other.followed > best.followed:
                return other
    if best is None:
        assert refused is not None
        raise refused
    return best


def _matched(
    samples: Samples,
    machine: Machine,
    paths: Sequence[AxisPath],
    start: _Start,
    places: Mapping[str, Array],
    *,
    quick: bool,
) -> Alignment:
    """Improve pose, places of reflectors and places of samples together."""
    following, tracks = [], [f.track for f in start.following]
    for f in start.following:
        coarse = max(QUICK_STEP, f.track.length / PLENTY)
        track = f.track.resampled(min(coarse, max(STEP, f.track.length / FEWEST)))
        reach = np.interp(track.reach, f.track.reach, f.reach)
        following.append(_Following(f.part, track, reach))
    pose = start.pose or _first_pose(machine, following, places)
    rounds = QUICK_ROUNDS if quick else ROUNDS
    band = WIDEST if start.rough else 0.0
    pose, known, location = _refined(machine, following, pose, places, rounds, band=band)
    matched = _placed(samples, machine, following, pose, known, location)
    if not quick and matched.followed >= MIN_SHARE_AS_PLANNED:
        following = [_finer(f, track) for f, track in zip(following, tracks, strict=True)]
        band = min(band, NARROWEST)
        pose, known, location = _refined(machine, following, pose, known, rounds, location, band)
        matched = _placed(samples, machine, following, pose, known, location)
    travel = np.array([driven_length(machine, p.positions) for p in paths])
    own = [p.driven * driven_length(machine, p.path.positions) for p in matched.parts]
    shares = np.minimum(np.bincount(start.published, own, len(paths)) / travel, 1.0)
    missing = tuple(p for k, p in enumerate(paths) if k not in start.published)
    return replace(
        matched,
        missing=missing,
        last_leg_driven=not missing,
        as_planned=start.as_planned,
        coverage=float(shares @ travel / travel.sum()) if start.as_planned else start.coverage,
    )


def _start_by_lengths(
    samples: Samples,
    machine: Machine,
    paths: Sequence[AxisPath],
    places: Mapping[str, Array],
    pose: RigidTransform | None,
) -> _Start:
    """Parts driven as planned, told apart by the broken beam, places by arc lengths."""
    parts = split_parts(samples, machine, paths)
    following = []
    for part in parts:
        curve = lines_of_part(sight_at(machine, part.path.target, places), part.path.positions)
        track = TravelledTrack.of(samples, part.first, part.last)
        if track.length < 0.02:
            raise InputError(
                f"part '{part.path.target}': the reflector moves by only "
                f'{1e3 * track.length:.1f} mm; is a part missing, or a broken beam between parts?'
            )
        cut_off = len(parts) < len(paths) and part is parts[-1]
        reach = track.reach if cut_off else by_length(track, float(curve.run[-1]))
        following.append(_Following(part, track, reach))
    return _Start(following, pose, tuple(range(len(parts))), as_planned=True, rough=True)


def _start_by_order(
    samples: Samples,
    machine: Machine,
    paths: Sequence[AxisPath],
    places: Mapping[str, Array],
    pose: RigidTransform | None,
) -> _Start | None:
    """Parts as the order of the legs shows them, see ``tracking.driving_order``; None if none."""
    tolerance = CalibrationConfig.match_tolerance
    sights = [sight_at(machine, p.target, places) for p in paths]
    shape = shape_of_parts(sights, [p.positions for p in paths])
    guide = MatchingInput(shape, shape.vertices(0.5 * tolerance))
    track = measured_track(samples, tolerance)
    if pose is None:
        found = guide.find(track, tolerance)
    else:
        whole = cut_track(track, pose, guide.cuts, 2 * tolerance)
        found = assign_legs(pose, whole, guide.vertices, tolerance)
    if found is None or found.explained < MIN_SHARE_UNDOUBTED:
        return None
    driven = passages(found, shape, guide.vertex, 4 * tolerance)
    following, time = [], samples.time
    ends = [0, *(d.last for d in driven)]
    starts = [*(d.first for d in driven), len(samples)]
    for d, before, after in zip(driven, ends, starts[1:], strict=False):
        path, knots = paths[d.part], d.knots
        if np.all(np.diff(d.places) > 0.0):  # forward: the whole of it, wherever it was begun
            begin = np.interp(knots[:, 1], np.arange(len(d.places)), d.places)
            knots = np.column_stack([knots[:, 0], begin])
        else:
            path = replace(path, positions=position_at(path.positions, d.places))
        first = d.first - _standing(samples.xyz[min(before, d.first) : d.first + 1][::-1])
        last = min(d.last, after) + _standing(samples.xyz[d.last - 1 : max(after, d.last)])
        own = TravelledTrack.of(samples, first, last)
        curve = lines_of_part(sights[d.part], path.positions)
        place = np.interp(own.time, time[knots[:, 0].astype(np.int64)], knots[:, 1])
        reach = np.maximum.accumulate(np.interp(place, curve.shape.places, curve.run))
        following.append(_Following(Part(path, first, last), own, reach))
    return _Start(
        following,
        found.pose,
        tuple(d.part for d in driven),
        as_planned=is_as_planned(visits(found, guide.vertices, 4 * tolerance)),
        rough=False,
        coverage=driven_share_of(found, guide, 4 * tolerance),
    )


def _standing(xyz: Array) -> int:
    """Samples after the first that lie where it does."""
    away = np.linalg.norm(xyz - xyz[0], axis=1) > HOP
    return int(np.argmax(away)) - 1 if away.any() else len(xyz) - 1


def _finer(one: _Following, track: TravelledTrack) -> _Following:
    """The same part by more places of its track."""
    fine = track.resampled(max(STEP, track.length / MOST))
    return _Following(one.part, fine, np.interp(fine.reach, one.track.reach, one.reach))


def _curve(machine: Machine, one: _Following, places: Mapping[str, Array]) -> Lines:
    return lines_of_part(sight_at(machine, one.part.path.target, places), one.part.path.positions)


def _first_pose(
    machine: Machine, following: Sequence[_Following], places: Mapping[str, Array]
) -> RigidTransform:
    """Pose from the arc lengths; parts with known places decide where they fix it."""
    sure = [f for f in following if is_known(machine, f.part.path.target)]
    spread = 0.0
    if sure:
        points = np.concatenate([f.track.xyz for f in sure])
        spread = float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1])
        spread /= np.sqrt(len(points))
    chosen = sure if spread > 1e-2 else list(following)
    pose = None
    for _ in range(6):
        curves = [_curve(machine, f, places) for f in chosen]
        for f, curve in zip(chosen, curves, strict=True):
            if pose is not None:
                band = 0.05 + 0.02 * float(curve.run[-1])
                f.reach = assign_places(f.track, curve, pose.apply(f.track.xyz), band, f.reach)
        source = np.concatenate([f.track.xyz for f in chosen])
        target = np.concatenate([_at_run(c, f.reach) for f, c in zip(chosen, curves, strict=True)])
        before, pose = pose, _robust_fit(source, target)
        if before is not None:
            change = np.abs(before.apply(source) - pose.apply(source)).max()
            if change < 1e-5:
                break
    assert pose is not None
    return pose


def _robust_fit(source: Array, target: Array) -> RigidTransform:
    pose = rigid_fit(source, target)
    for _ in range(3):
        off = np.linalg.norm(pose.apply(source) - target, axis=1)
        near = off <= 3.0 * np.median(off)
        if near.sum() < 10:
            break
        pose = rigid_fit(source[near], target[near])
    return pose


def _refined(
    machine: Machine,
    following: Sequence[_Following],
    pose: RigidTransform,
    places: Mapping[str, Array],
    rounds: int,
    lines: Mapping[str, float] | None = None,
    band: float = WIDEST,
) -> tuple[RigidTransform, dict[str, Array], dict[str, float]]:
    """Pose, places of reflectors on the table and lines of axes from the tracks of all parts.

    Reaches are right within ``band``, m, or, where it is 0, as far as the closest place needs it.
    """
    known, location = dict(places), dict(lines or dict.fromkeys(machine.location, 0.0))
    actual = apply_location_errors(machine, location)
    free = sorted(
        {
            f.part.path.target
            for f in following
            if machine.targets[f.part.path.target].link != SPINDLE
            and machine.targets[f.part.path.target].u > 0.0
        }
    )
    column = {name: 6 + 3 * k for k, name in enumerate(free)}
    first = 6 + 3 * len(free)
    size = first + len(location)
    far = band > 0.0
    for _ in range(rounds):
        normal, right = np.zeros((size, size)), np.zeros(size)
        for name, at in column.items():
            u = machine.targets[name].u
            own = np.arange(at, at + 3)
            normal[own, own] += 1e-6 / u**2  # next to nothing beside millions of samples
            right[own] += 1e-6 / u**2 * (np.array(machine.targets[name].place) - known[name])
        for k, value in enumerate(location.values(), start=first):
            normal[k, k] += 1.0
            right[k] -= value
        for f in following:
            curve = _curve(actual, f, known)
            points = pose.apply(f.track.xyz)
            if far:
                f.reach = assign_places(
                    f.track, curve, points, min(band, 0.5 * float(curve.run[-1])), f.reach
                )
            name = f.part.path.target
            chord, along, tangent, _ = curve.closest(points, *curve.chord_at(f.reach))
            f.reach = curve.run[chord] + along
            q = curve.interpolated(curve.shape.positions, chord, along)
            seen = sight_at(actual, name, known).at(q)
            at_lines = {scalar: k for k, scalar in enumerate(location, start=first)}
            acting, matrix, side = _equations(points, seen, tangent, column.get(name), at_lines)
            normal[np.ix_(acting, acting)] += matrix
            right[acting] += side
        step = np.asarray(np.linalg.lstsq(normal, right, rcond=1e-12)[0], dtype=np.float64)
        pose = pose.moved_by(step[:3], step[3:6])
        for name, at in column.items():
            known[name] = known[name] + step[at : at + 3]
        for k, scalar in enumerate(location, start=first):
            location[scalar] += float(step[k])
        actual = apply_location_errors(machine, location)
        band = max(NARROWEST, 0.5 * band)
        far = far and float(np.abs(step[[0, 1, 2, *range(6, first)]]).max()) > NEAR
        if np.abs(step[[0, 1, 2, *range(6, size)]]).max() < SETTLED * 100:
            break
    return pose, known, location


def _equations(
    points: Array,
    seen: ReflectorView,
    tangent: Array,
    at_place: int | None,
    at_lines: Mapping[str, int],
) -> tuple[list[int], Array, Array]:
    """Normal equations of the deviations of points across their curve, robustly weighted.

    Returns
    -------
    acting : list of int
        Unknowns that act on these points, k of them.
    matrix, right : ndarray, shapes (k, k) and (k,)
    """
    off = points - seen.position
    off = off - tangent * np.einsum('ij,ij->i', off, tangent)[:, None]
    scale = 1.0 / np.sqrt(np.maximum(np.linalg.norm(off, axis=1), LEAST_OFF))
    lines = {k: scalar for scalar, k in at_lines.items() if scalar in seen.scalars}
    of_place = range(0) if at_place is None else range(at_place, at_place + 3)
    acting = [*range(6), *of_place, *lines]
    rows = np.zeros((len(points), 3, len(acting)))
    rows[:, :, :3] = np.eye(3)
    for k in range(3):
        rows[:, :, 3 + k] = np.cross(np.eye(3)[k], points)
    if of_place:
        rows[:, :, 6:9] = -np.eye(3) if seen.inner is None else -seen.inner
    for k, scalar in enumerate(lines.values(), start=6 + len(of_place)):
        rows[:, :, k] = -seen.scalars[scalar]
    rows -= tangent[:, :, None] * np.einsum('nj,njk->nk', tangent, rows)[:, None]
    whole = (rows * scale[:, None, None]).reshape(-1, len(acting))
    return acting, whole.T @ whole, -whole.T @ (off * scale[:, None]).reshape(-1)


def apply_location_errors(machine: Machine, location: Mapping[str, float]) -> Machine:
    """The machine with the lines of its rotary axes where location errors put them."""
    axes = dict(machine.axes)
    for name in machine.rotary_names:
        spec = axes[name]
        assert spec.direction is not None
        six = np.zeros(6)
        for scalar in location_names(name):
            six[DIRECTIONS.index(scalar[0])] = location.get(scalar, 0.0)
        direction = np.array(spec.direction) + np.cross(six[3:], spec.direction)
        x, y, z = (float(v) for v in direction / np.linalg.norm(direction))
        a, b, c = (float(v) for v in np.array(spec.centre) + six[:3])
        axes[name] = replace(spec, direction=(x, y, z), centre=(a, b, c))
    return replace(machine, axes=axes)


def _at_run(curve: Lines, reach: Array) -> Array:
    """Points of a track at path lengths, shape (n, 3), m."""
    chord, along = curve.chord_at(reach)
    return curve.at(along, chord)


def _placed(
    samples: Samples,
    machine: Machine,
    following: Sequence[_Following],
    pose: RigidTransform,
    places: Mapping[str, Array],
    location: Mapping[str, float],
) -> Alignment:
    """Chords of all samples, with everything at its place."""
    actual = apply_location_errors(machine, location)
    shape = shape_of_parts(
        [sight_at(machine, f.part.path.target, places) for f in following],
        [f.part.path.positions for f in following],
    )
    leg = np.full(len(samples), OFF_PATH, dtype=np.int32)
    parts, near, time = [], [], samples.time
    assert shape.part is not None
    for k, f in enumerate(following):
        own = slice(f.part.first, f.part.last)
        curve = _curve(actual, f, places)
        reach = np.interp(time[own], f.track.time, f.reach)
        off = np.linalg.norm(pose.apply(f.track.xyz) - _at_run(curve, f.reach), axis=1)
        limit = max(OFF_CURVE, OFF_RATIO * float(np.median(off)))
        on = np.interp(time[own], f.track.time, off) < limit
        first, (chord, _) = np.flatnonzero(shape.part == k)[0], curve.chord_at(reach)
        leg[own] = np.where(on, first + chord, OFF_PATH)
        near.append(off < CalibrationConfig.match_tolerance)
        step, moved = np.diff(f.reach), np.diff(f.track.reach)
        seen = near[-1][1:] & near[-1][:-1] & (step < LONGEST * moved + JUMP)
        share = float(step[seen].sum() / curve.run[-1])
        parts.append(replace(f.part, driven=share, distance=float(np.median(off))))
    return Alignment(
        pose, shape.corners, leg, 1.0, True, shape, parts=tuple(parts), places=places,
        location=location, followed=float(np.mean(np.concatenate(near))),
    )  # fmt: skip
