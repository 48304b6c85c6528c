# SPDX-License-Identifier: Apache-2.0
"""Runs of one machine: each with its samples, path, tracker pose and target offset.

Solving, budget and diagnosis need pieces, the pose of the tracker, its noise and the shape of the
path (``Observed``: of a recording, or of a plan that is not driven yet); single samples only where
``Run`` is required.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.blocks import BLOCK
from otf_core.config import OTF, STANDSTILL, CalibrationConfig
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.files.text_table import SkippedLines
from otf_core.live.stages import Progress, silent
from otf_core.model.axis_path import AxisPath, PartsTrack, nominal_track
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.machine import TOOL, Machine
from otf_core.model.motions import AXES
from otf_core.model.nodes import table_nodes
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal
from otf_core.model.tables import ErrorTables, MotionTable, ScalarError
from otf_core.noise.noise_model import Misfit, NoiseModel, noise_and_misfit
from otf_core.noise.standstill import noise_model, standstill_noise
from otf_core.pieces.pieces import Pieces, reduce_to_pieces
from otf_core.pieces.stops import GENTLE, align_stops, find_stops, reduce_to_stops
from otf_core.tracking.alignment import Alignment, FollowedTrack, Part, align, line_step
from otf_core.tracking.curve_matching import match
from otf_core.tracking.curves import Lines, PathShape
from otf_core.tracking.leg_starts import leg_starts
from otf_core.tracking.matching import OFF_PATH
from otf_core.tracking.mismatch import check_matched
from otf_core.tracking.no_match import check_partial


@dataclass(frozen=True, kw_only=True)
class Observed:
    """Pieces of one run and how they are seen.

    Attributes
    ----------
    machine : Machine
        As set up in this run.
    pose : RigidTransform
        Tracker to the link that it stands on, to start from: fitted rigidly, or of a solution.
    noise : NoiseModel
        As the standstills of the run show it, else as specified.
    fitted : ndarray, shape (5,), optional
        Noise and misfit fitted to the residuals, see ``joint.fit_noise``.
    name : str
        Where it comes from, for messages and reports; empty if it needs none.
    late : float, s
        Where a recording was cut: start of this part after that of the recording.
    signals : mapping of str to Signal
        Recorded beside the samples.
    first_ns : int, ns
        Stamp from which the times of the pieces count.
    shape : PathShape, optional
        Corner points and curves of the path as driven, where three linear axes carry one target
        past the tracker.
    targets : tuple of str
        Target of every part.
    places : mapping of target to ndarray, shape (3,), m
        Where targets are known to be now; else as machine.yaml states it.
    base : mapping of target to ndarray, shape (3,), m
        At which the nominal points of the pieces were computed.
    same_station : bool
        The tracker was not moved since the run before.
    """

    machine: Machine
    pieces: Pieces
    pose: RigidTransform
    noise: NoiseModel
    fitted: Array | None = None
    name: str = ''
    late: float = 0.0
    signals: Mapping[str, Signal] = field(default_factory=dict)
    first_ns: int = 0
    shape: PathShape | None = None
    targets: tuple[str, ...] = (TOOL,)
    places: Mapping[str, Array] = field(default_factory=dict)
    base: Mapping[str, Array] = field(default_factory=dict)
    same_station: bool = False

    def sight(self, target: str) -> Sight:
        """A target at the place that is known of it now."""
        sight = Sight.of_target(self.machine, target)
        return replace(sight, place=self.places[target]) if target in self.places else sight

    def moved(self, target: str) -> Array:
        """Displacement of a target since its nominal points were computed, shape (3,), m."""
        known = target in self.places and target in self.base
        return self.places[target] - self.base[target] if known else np.zeros(3)

    def by_target(self) -> dict[str, NDArray[np.bool_]]:
        """Which pieces are of which target."""
        names = np.array(self.targets)[self.pieces.part]
        return {str(n): names == n for n in np.unique(names)}

    @property
    def leg_starts(self) -> Array | None:
        """When every line began from rest, as far as known; see ``tracking.leg_starts``."""
        return None

    @property
    def noise_and_misfit(self) -> tuple[NoiseModel, Misfit]:
        """Noise of single samples, and what the model leaves besides: as far as is known."""
        return noise_and_misfit(self.noise, self.fitted)


AnyRun = TypeVar('AnyRun', bound=Observed)
"""Runs of recordings stay such where they are moved, thinned or fitted."""


SNAP = 0.02
"""m; a covered range that ends this close to the path's own end is taken to reach it."""


@dataclass(frozen=True)
class Recording:
    """One recorded run.

    Attributes
    ----------
    path : NominalPath
        Of the target on three linear axes; else the track of all parts, see
        ``axis_path.nominal_track``.
    machine : Machine
        The same machine in all runs; its target offset and tracker may differ.
    name : str
        Where it comes from, for messages and reports; empty if it needs none.
    remarks : tuple of str
        What was repaired or left out of it, in words; warnings of every result.
    signals : mapping of str to Signal
        Recorded beside the samples; possible causes in a diagnosis.
    seen : FollowedTrack, optional
        What was found of the track before its last samples came; it saves time and changes
        nothing.
    left_out : tuple of SkippedLines
        Lines of a text that are not samples, by reason.

    Examples
    --------
    Samples and path need not come from a bag:

    >>> own = otf_core.Recording(recording.samples, recording.path, machine, name='Monday')
    >>> own.path is recording.path
    True
    """

    samples: Samples
    path: NominalPath
    machine: Machine
    name: str = ''
    remarks: tuple[str, ...] = ()
    signals: Mapping[str, Signal] = field(default_factory=dict)
    seen: FollowedTrack | None = None
    left_out: tuple[SkippedLines, ...] = ()

    @property
    def parts(self) -> tuple[AxisPath, ...]:
        """What was driven: as many parts as the path has, one of three linear axes without any."""
        if isinstance(self.path, PartsTrack):
            return self.path.parts
        return (AxisPath(AXES, self.path.points),)


@contextmanager
def errors_of(name: str) -> Iterator[None]:
    """Put the name of a recording in front of what is wrong with it; nothing if it has none."""
    try:
        yield
    except OtfError as error:
        if not name:
            raise
        raise type(error)(f'{name}: {error}') from None


@dataclass(frozen=True, kw_only=True)
class Run(Observed):
    """A recording reduced to pieces.

    Attributes
    ----------
    path : NominalPath
        As published.
    read : tuple of str
        Remarks of the recording.
    left_out : tuple of SkippedLines
        See ``Recording``.
    """

    samples: Samples
    path: NominalPath
    alignment: Alignment
    read: tuple[str, ...] = ()
    left_out: tuple[SkippedLines, ...] = ()

    def speed_at_rest(self, config: CalibrationConfig) -> float:
        """Speed below which the target counts as standing still, m/s."""
        return config.rest_speed if self.shape is None else config.standstill_speed

    @cached_property
    def leg_starts(self) -> Array | None:
        """When every line began from rest, s since the recording; NaN where it is not seen."""
        if self.pieces.standstill or self.shape is None:
            return None
        lines = Lines.of(self.shape)
        return self.late + leg_starts(self.samples, self.pose, self.alignment.leg, lines)

    @property
    def recording(self) -> Recording:
        """What was recorded; its remarks with the first part of a run that was cut."""
        first = self.late == 0.0
        return Recording(
            self.samples,
            self.path,
            self.machine,
            self.name,
            self.read if first else (),
            self.signals,
            left_out=self.left_out if first else (),
        )


class _OfMachine(Protocol):
    """Of a machine, and with a name for messages."""

    @property
    def machine(self) -> Machine: ...

    @property
    def name(self) -> str: ...


def check_same_machine(recordings: Sequence[_OfMachine]) -> None:
    """Refuse runs whose chains or axes differ; ConfigError names run and key."""
    first = _described(recordings[0].machine)
    for number, recording in enumerate(recordings[1:], start=2):
        for key, value in _described(recording.machine).items():
            if value != first[key]:
                raise ConfigError(
                    f'{recording.name or f"run {number}"}: {key}: {value}, but {first[key]} in '
                    f'{recordings[0].name or "run 1"}; runs solved together must be of one machine'
                    f' (target_offset and tracker may differ)'
                )


def _described(machine: Machine) -> dict[str, float | str]:
    """What makes a machine: its chain and axes, key by key."""
    axes: dict[str, dict[str, float]] = machine.to_dict()['axes']
    keys = {f'axes: {a}: {key}': v for a, spec in axes.items() for key, v in spec.items()}
    return {'chain': str(machine.chain), **keys}


def _covered_range(alignment: Alignment, recording: Recording) -> tuple[Array, Array]:
    """Part of the axis ranges that the driven legs cover, where axes move the reflector in view.

    Returns
    -------
    low, high : ndarray, shape (k,), m and rad
        Infinite for an axis that moves none.

    Raises
    ------
    InputError
        If the path leaves the ranges of the machine.
    """
    machine, corners = recording.machine, alignment.corners
    if alignment.shape.sights:
        return _driven_range(machine, alignment)
    path_low, path_high = corners.min(axis=0), corners.max(axis=0)
    low, high = _extremes(recording.samples.xyz, alignment, path_low + SNAP, path_high - SNAP)
    low = np.where(low < path_low + SNAP, path_low, low)
    high = np.where(high > path_high - SNAP, path_high, high)
    flat = path_high - path_low < 1e-6
    low, high = np.where(flat, path_low, low), np.where(flat, path_low, high)
    outside = np.maximum(machine.lower - low, high - machine.upper)
    if outside.max() > 1e-3:
        raise InputError(
            f'path: leaves the range of axis {machine.axis_names[int(np.argmax(outside))]} by '
            f'{1e3 * outside.max():.1f} mm; do bag and machine description belong together?'
        )
    return low, high


def _driven_range(machine: Machine, alignment: Alignment) -> tuple[Array, Array]:
    """Lowest and highest position (k,) of every axis in the parts that it moves."""
    low = np.full(len(machine.axis_names), np.inf)
    high = -low
    for part, sight in zip(alignment.parts, alignment.shape.sights, strict=True):
        for k in (machine.column(joint.name) for joint in sight.joints):
            axis, q = machine.axes[machine.axis_names[k]], part.path.positions[:, k]
            whole = axis.endless and np.ptp(q) > 6.0
            q = np.array([axis.min, axis.max]) if whole else axis.wrapped(q)
            low[k], high[k] = min(low[k], q.min()), max(high[k], q.max())
    return low, high


def _extremes(xyz: Array, alignment: Alignment, below: Array, above: Array) -> tuple[Array, Array]:
    """Lowest and highest coordinates of the samples on legs, machine frame, m.

    Samples are looked at until some are ``below`` and ``above``, each of shape (3,): those that
    are spread over the whole recording first.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    step = -(-len(xyz) // BLOCK)
    for part in (slice(first, None, step) for first in range(step)):
        on = alignment.leg[part] != OFF_PATH
        columns = np.ascontiguousarray(alignment.T_machine_tracker.apply(xyz[part][on]).T)
        low = np.minimum(low, columns.min(axis=1, initial=np.inf))
        high = np.maximum(high, columns.max(axis=1, initial=-np.inf))
        if np.all(low < below) and np.all(high > above):
            break
    return low, high


def common_nodes(machine: Machine, ranges: Sequence[tuple[Array, Array]]) -> dict[str, Array]:
    """Table nodes over all that runs cover, from their ranges (low, high)."""
    low, high = np.min([r[0] for r in ranges], axis=0), np.max([r[1] for r in ranges], axis=0)
    zero, unmoved = np.clip(0.0, machine.lower, machine.upper), ~np.isfinite(low)
    low, high = np.where(unmoved, zero, low), np.where(unmoved, zero, high)
    return table_nodes(machine, np.maximum(low, machine.lower), np.minimum(high, machine.upper))


def rigid_pose(pieces: Pieces, pose: RigidTransform, config: CalibrationConfig) -> RigidTransform:
    """Fine alignment on the pieces: perpendicular distances, every sample counting alike.

    Stops are fitted to their points, every stop counting alike.
    """
    if pieces.standstill:
        return rigid_fit(pieces.xyz, pieces.origin)
    lines, weight = np.hstack([pieces.origin, pieces.direction]), pieces.count.astype(float)
    another = np.concatenate([[True], np.any(lines[1:] != lines[:-1], axis=1)])
    line, (origin, direction) = np.cumsum(another) - 1, np.hsplit(lines[another], 2)
    for _ in range(config.max_iterations):
        points = pose.apply(pieces.xyz)
        step = line_step(points, origin, direction, weight, line)
        moved = pose.moved_by(*step)
        change = float(np.abs(moved.apply(pieces.xyz) - points).max())
        pose = moved
        if change < config.alignment_stop:
            break
    return pose


def follow(
    recording: Recording,
    config: CalibrationConfig,
    method: str = OTF,
    known: Alignment | None = None,
) -> Alignment:
    """Find the pose of the tracker, the places of the reflectors and the leg of every sample.

    Where three linear axes carry one target past the tracker, the path is lines on which samples
    have one projection (``alignment.align``); else it is curves of places that are not known
    before (``curve_matching.match``).

    Parameters
    ----------
    known : Alignment, optional
        Of another recording from the same place of the tracker.

    Raises
    ------
    InputError
        If samples and path do not belong together; says why.
    """
    samples, machine, path, parts = (
        recording.samples, recording.machine, recording.path, recording.parts,
    )  # fmt: skip
    if isinstance(path, PartsTrack):
        matched = match(samples, machine, parts, known)
        return replace(matched, remarks=check_matched(samples, matched, parts))
    if method == STANDSTILL:
        found = align_stops(samples, path, config)
    else:
        found = align(samples, path, config, recording.seen)
        check_partial(
            samples, path, found.T_machine_tracker, found.coverage, config.match_tolerance
        )
    return replace(found, parts=(Part(parts[0], 0, len(samples), found.coverage),))


def prepare_runs(
    recordings: Sequence[Recording],
    config: CalibrationConfig,
    method: str = OTF,
    progress: Progress = silent,
    *,
    same_station: bool = False,
) -> tuple[list[Run], dict[str, Array]]:
    """Follow and reduce recordings for a common set of table nodes.

    Parameters
    ----------
    method : str
        'otf', or 'standstill': only the stops at the corners.
    same_station : bool
        The tracker was not moved between the recordings. Where no axis turns, positions are
        counted from the target offset: runs of different offsets keep a pose each, which differ
        by as much as these were measured wrongly.

    Returns
    -------
    nodes : mapping of axis to ndarray, m and rad
    """
    check_same_machine(recordings)
    machine, ranges = recordings[0].machine, []
    on_curves = any(isinstance(one.path, PartsTrack) for one in recordings)  # then all are
    if on_curves:
        tracks = [nominal_track(one.machine, one.parts) for one in recordings]
        recordings = [replace(r, path=p) for r, p in zip(recordings, tracks, strict=True)]
    followed: list[Alignment] = []
    for k, recording in enumerate(recordings, start=1):
        with errors_of(recording.name):
            known = followed[0] if same_station and followed else None
            followed.append(follow(recording, config, method, known))
            ranges.append(_covered_range(followed[-1], recording))
        progress('aligning', k / (len(recordings) + 1))
    nodes = common_nodes(machine, ranges)
    tables = located_tables(machine, nodes, followed[0].location)
    places: dict[str, Array] = {}
    for one in reversed(followed):  # those of the first recording that saw them
        places |= {p.path.target: one.places[p.path.target] for p in one.parts if one.places}
    runs: list[Run] = []
    for recording, alignment in zip(recordings, followed, strict=True):
        with errors_of(recording.name):
            run = reduce_recording(recording, alignment, nodes, config, method, tables)
        own = {name: places[name] for name in run.base}
        same = same_station and bool(runs) and _counts_alike(runs[-1].machine, run.machine)
        pose = runs[-1].pose if same else run.pose
        runs.append(replace(run, pose=pose, places=own, same_station=same))
    return runs, nodes


def _counts_alike(one: Machine, other: Machine) -> bool:
    """Whether positions are counted from the same point."""
    return bool(np.array_equal(Sight.of_tool(one).origin, Sight.of_tool(other).origin))


def reduce_recording(
    recording: Recording,
    alignment: Alignment,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    method: str = OTF,
    tables: ErrorTables | None = None,
) -> Run:
    """Reduce a recording that was followed to pieces, or stops, for given table nodes.

    Parameters
    ----------
    tables : ErrorTables, optional
        Errors that are taken off before the closest places on curves are looked for.
    """
    samples, machine, sights = recording.samples, recording.machine, alignment.shape.sights
    if method == STANDSTILL:
        pieces = reduce_to_stops(samples, alignment, config)
    else:
        spacing = tuple(nodes[a] for a in machine.axis_names)
        pieces = reduce_to_pieces(samples, alignment, spacing, config, tables)
    pose = alignment.T_machine_tracker
    still = None
    if sights and method == STANDSTILL:
        still = standstill_noise(samples, find_stops(samples, config, GENTLE).span)
    speed = config.rest_speed if sights else config.standstill_speed
    targets = tuple(part.path.target for part in alignment.parts)
    return Run(
        machine=machine,
        pieces=pieces,
        pose=pose if sights else rigid_pose(pieces, pose, config),
        noise=still.noise if still else noise_model(samples, machine.tracker, speed),
        name=recording.name,
        signals=recording.signals,
        first_ns=int(samples.stamp_ns[0]),
        shape=None if sights else alignment.shape,
        targets=targets,
        base={name: alignment.places[name] for name in targets if alignment.places},
        samples=samples,
        path=recording.path,
        alignment=alignment,
        read=tuple(recording.remarks),
        left_out=recording.left_out,
    )


def reduce_run_again(
    run: Run,
    tables: ErrorTables,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
    method: str = OTF,
) -> Run:
    """Reduce a run at the pose, places and errors that are known now.

    Only on curves does it change which place a sample is nearest to: other runs stay as they are.
    """
    if not run.alignment.shape.sights:
        return run
    followed = run.alignment.moved(run.pose, run.places)
    reduced = reduce_recording(run.recording, followed, nodes, config, method, tables)
    return replace(run, alignment=followed, pieces=reduced.pieces, base=reduced.base)


def located_tables(
    machine: Machine, nodes: Mapping[str, Array], location: Mapping[str, float]
) -> ErrorTables | None:
    """Tables of rotary axes whose lines lie elsewhere, and nothing else; None without any."""
    if not location:
        return None
    motions: dict[str, MotionTable] = {}
    for motion in machine.motions:
        zero = np.zeros(len(nodes[motion.axis]))
        motions[motion] = MotionTable(nodes[motion.axis], zero, zero)
    return ErrorTables(
        machine,
        motions,
        {n: ScalarError() for n in machine.squareness},
        {n: ScalarError(location[n]) for n in machine.location},
    )


def run_id(recordings: Sequence[Recording], config: CalibrationConfig) -> str:
    """Return the identifier of a calibration: a digest of its recordings and parameters."""
    digest = hashlib.sha256()
    for r in recordings:
        driven = [part.positions for part in r.parts]
        for part in (r.samples.stamp_ns, r.samples.xyz, *driven):
            digest.update(np.ascontiguousarray(part).reshape(-1).data)
        digest.update(json.dumps(r.machine.to_dict(), sort_keys=True).encode())
    digest.update(json.dumps(asdict(config), sort_keys=True).encode())
    return digest.hexdigest()[:12]
