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

from otf_core.arrays import Array, Index
from otf_core.errors import InputError
from otf_core.model.axis_path import BREAK, AxisPath, position_at
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.joints import ReflectorView, Sight
from otf_core.model.machine import SPINDLE, Machine
from otf_core.model.motions import DIRECTIONS, location_names
from otf_core.model.observation import Samples
from otf_core.rotary.track import MOST, STEP, Curve, Track, assign_places, by_length

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
HALF_CHORD, LONGEST_STEP = 2e-3, 5e-3
"""m; half of the chord that gives the direction of travel, and longest step along a curve."""


@dataclass(frozen=True)
class Part:
    """One part of a run as it was measured.

    Attributes
    ----------
    path : AxisPath
        In the order of the axes of the machine.
    first, last : int
        Its samples.
    """

    path: AxisPath
    first: int
    last: int


@dataclass(frozen=True)
class MatchedRun:
    """A run whose samples have places on the nominal curves.

    Attributes
    ----------
    pose : RigidTransform
        Tracker to the link that it stands on.
    places : mapping of target to ndarray, shape (3,), m
    place : ndarray, shape (n,)
        Legs done in its part, of every sample; NaN where it belongs to none.
    part : ndarray of int64, shape (n,)
        Part of every sample; -1 for none.
    location : mapping of name to float, m and rad
        Rough location errors of the rotary axes.
    distance : tuple of float
        m; median distance of the samples from the curve, for every part.
    driven : tuple of float
        Share of the curve that was driven, for every part.
    missing : tuple of AxisPath
        Parts of the path at its end that were not recorded.
    """

    machine: Machine
    parts: tuple[Part, ...]
    pose: RigidTransform
    places: Mapping[str, Array]
    place: Array
    part: Index
    location: Mapping[str, float]
    distance: tuple[float, ...]
    driven: tuple[float, ...]
    missing: tuple[AxisPath, ...] = ()

    def sight(self, target: str) -> Sight:
        """A target at the place that is known of it now."""
        return sight_at(self.machine, target, self.places)


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
    lengths = [Track.of(samples, a, b).length if b - a > 50 else 0.0 for a, b in pairwise(marks)]
    chords = [float(np.linalg.norm(samples.xyz[e] - samples.xyz[e - 1])) for e in ends]
    nominal = [Curve.of(Sight.of_target(machine, p.target), p.positions).length for p in paths]
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
    track: Track
    reach: Array


def match(
    samples: Samples,
    machine: Machine,
    paths: Sequence[AxisPath],
    pose: RigidTransform | None = None,
    places: Mapping[str, Array] | None = None,
    *,
    quick: bool = False,
) -> MatchedRun:
    """Find pose, places of reflectors and the place of every sample.

    Parameters
    ----------
    paths : sequence of AxisPath
        Parts in driving order, axes as of the machine.
    pose : RigidTransform, optional
        Where it is known already.
    places : mapping of target to ndarray, optional
        The same.
    quick : bool
        Coarser and with fewer rounds: enough to tell whether it fits at all.

    Raises
    ------
    InputError
        If track and path do not belong together.
    """
    parts = split_parts(samples, machine, paths)
    known = dict(places) if places is not None else nominal_places(machine)
    following, tracks = [], []
    for part in parts:
        curve = Curve.of(sight_at(machine, part.path.target, known), part.path.positions)
        track = Track.of(samples, part.first, part.last)
        if track.length < 0.02:
            raise InputError(
                f"part '{part.path.target}': the reflector moves by only "
                f'{1e3 * track.length:.1f} mm; is a part missing, or a broken beam between parts?'
            )
        tracks.append(track)
        coarse = max(QUICK_STEP, track.length / PLENTY)
        track = track.resampled(min(coarse, max(STEP, track.length / FEWEST)))
        cut_off = len(parts) < len(paths) and part is parts[-1]
        reach = track.reach if cut_off else by_length(track, curve)
        following.append(_Following(part, track, reach))
    if pose is None:
        pose = _first_pose(machine, following, known)
    rounds = QUICK_ROUNDS if quick else ROUNDS
    pose, known, location = _refined(machine, following, pose, known, rounds)
    if not quick:
        following = [_finer(f, track) for f, track in zip(following, tracks, strict=True)]
        pose, known, location = _refined(
            machine, following, pose, known, rounds, location, NARROWEST
        )
    matched = _placed(samples, machine, following, pose, known, location)
    return replace(matched, missing=tuple(paths[len(parts) :]))


def _finer(one: _Following, track: Track) -> _Following:
    """The same part by more places of its track."""
    fine = track.resampled(max(STEP, track.length / MOST))
    return _Following(one.part, fine, np.interp(fine.reach, one.track.reach, one.reach))


def _curve(machine: Machine, one: _Following, places: Mapping[str, Array]) -> Curve:
    return Curve.of(sight_at(machine, one.part.path.target, places), one.part.path.positions)


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
                band = 0.05 + 0.02 * curve.length
                f.reach = assign_places(f.track, curve, pose.apply(f.track.xyz), band, f.reach)
        source = np.concatenate([f.track.xyz for f in chosen])
        target = np.concatenate([c.at(f.reach) for f, c in zip(chosen, curves, strict=True)])
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
    """Pose, places of reflectors on the table and lines of axes from the tracks of all parts."""
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
    far = True
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
                    f.track, curve, points, min(band, 0.5 * curve.length), f.reach
                )
            name = f.part.path.target
            place, seen, tangent = closest(
                sight_at(actual, name, known), curve, curve.place_at(f.reach), points
            )
            f.reach = curve.reach_at(place)
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
        far = float(np.abs(step[[0, 1, 2, *range(6, first)]]).max()) > NEAR
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


def closest(
    sight: Sight, curve: Curve, place: Array, points: Array
) -> tuple[Array, ReflectorView, Array]:
    """Closest places of a curve to points, from near ones.

    The direction of travel is that of a chord of some length about a place: chains of corners that
    stand for a smooth curve have ripples, of which noise makes the closest point ambiguous.

    Returns
    -------
    place : ndarray, shape (n,)
    seen : ReflectorView
        Reflector there.
    tangent : ndarray, shape (n, 3)
        Unit direction of travel.
    """
    reach = curve.reach_at(place)
    moving = np.arange(len(reach))
    for _ in range(ROUNDS):
        own = reach[moving]
        step = np.einsum('ni,ni->n', points[moving] - curve.at(own), _chord(curve, own))
        own = own + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        reach[moving] = np.clip(own, 0.0, curve.length)
        moving = moving[np.abs(step) >= SETTLED]
        if not len(moving):
            break
    place = curve.place_at(reach)
    seen = sight.at(position_at(curve.positions, place))
    return place, seen, _chord(curve, reach)


def _chord(curve: Curve, reach: Array) -> Array:
    """Unit directions (n, 3) of symmetric chords about places by arc length."""
    half = np.minimum(HALF_CHORD, np.minimum(reach, curve.length - reach))
    half = np.maximum(half, 1e-5)
    step = curve.at(reach + half) - curve.at(reach - half)
    return np.asarray(step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None])


def _placed(
    samples: Samples,
    machine: Machine,
    following: Sequence[_Following],
    pose: RigidTransform,
    places: Mapping[str, Array],
    location: Mapping[str, float],
) -> MatchedRun:
    actual = apply_location_errors(machine, location)
    place, number = np.full(len(samples), np.nan), np.full(len(samples), -1, dtype=np.int64)
    distance, driven = [], []
    time = samples.time
    for k, f in enumerate(following):
        own = slice(f.part.first, f.part.last)
        curve = _curve(actual, f, places)
        reach = np.interp(time[own], f.track.time, f.reach)
        place[own], number[own] = curve.place_at(reach), k
        off = np.linalg.norm(pose.apply(f.track.xyz) - curve.at(f.reach), axis=1)
        distance.append(float(np.median(off)))
        driven.append(float((f.reach.max() - f.reach.min()) / curve.length))
    parts = tuple(f.part for f in following)
    return MatchedRun(
        machine, parts, pose, places, place, number, location, tuple(distance), tuple(driven)
    )
