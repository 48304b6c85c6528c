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
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from otf_core.arrays import Array
from otf_core.blocks import BLOCK
from otf_core.config import CalibrationConfig
from otf_core.errors import ConfigError, InputError, OtfError
from otf_core.files.text_table import SkippedLines
from otf_core.model.axis_path import AxisPath
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform, rigid_fit
from otf_core.model.machine import TOOL, Machine
from otf_core.model.nodes import table_nodes
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal
from otf_core.noise.noise_model import Misfit, NoiseModel, noise_and_misfit
from otf_core.noise.standstill import noise_model
from otf_core.pieces.pieces import Pieces, reduce_to_pieces
from otf_core.tracking.alignment import Alignment, FollowedTrack, align, line_step
from otf_core.tracking.curves import Lines, PathShape
from otf_core.tracking.leg_starts import leg_starts
from otf_core.tracking.matching import OFF_PATH
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
        Corner points and curves of the path as driven, where it is one of three linear axes.
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
    axis_paths : tuple of AxisPath
        Parts that were driven, of a machine with rotary axes; ``path`` is their track then.

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
    axis_paths: tuple[AxisPath, ...] = ()


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

    shape: PathShape
    samples: Samples
    path: NominalPath
    alignment: Alignment
    read: tuple[str, ...] = ()
    left_out: tuple[SkippedLines, ...] = ()

    @classmethod
    def of(
        cls,
        recording: Recording,
        alignment: Alignment,
        pieces: Pieces,
        pose: RigidTransform,
        noise: NoiseModel,
    ) -> Run:
        """Put together what was found in a recording."""
        return cls(
            machine=recording.machine,
            shape=alignment.shape,
            pieces=pieces,
            pose=pose,
            noise=noise,
            name=recording.name,
            samples=recording.samples,
            path=recording.path,
            alignment=alignment,
            signals=recording.signals,
            first_ns=int(recording.samples.stamp_ns[0]),
            read=tuple(recording.remarks),
            left_out=recording.left_out,
        )

    @cached_property
    def leg_starts(self) -> Array | None:
        """When every line began from rest, s since the recording; NaN where it is not seen."""
        if self.pieces.standstill:
            return None
        lines = Lines.of(self.alignment.shape)
        return self.late + leg_starts(self.samples, self.pose, self.alignment.leg, lines)

    @property
    def recording(self) -> Recording:
        """What was recorded; its remarks with the first part of a run that was cut."""
        read = self.read if self.late == 0.0 else ()
        left_out = self.left_out if self.late == 0.0 else ()
        return Recording(self.samples, self.path, self.machine, self.name, read, left_out=left_out)


def check_same_machine(recordings: Sequence[Recording]) -> None:
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


def covered_range(alignment: Alignment, recording: Recording) -> tuple[Array, Array]:
    """Part of the axis ranges that the driven legs cover.

    Returns
    -------
    low, high : ndarray, shape (3,), m

    Raises
    ------
    InputError
        If the path leaves the ranges of the machine.
    """
    machine, corners = recording.machine, alignment.corners
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
    return np.maximum(low, machine.lower), np.minimum(high, machine.upper)


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
    low, high = zip(*ranges, strict=True)
    return table_nodes(machine, np.min(low, axis=0), np.max(high, axis=0))


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


def prepare_runs(
    recordings: Sequence[Recording], config: CalibrationConfig
) -> tuple[list[Run], dict[str, Array]]:
    """Align and reduce recordings for a common set of table nodes.

    Returns
    -------
    nodes : mapping of axis to ndarray, m
    """
    check_same_machine(recordings)
    alignments, ranges = [], []
    for recording in recordings:
        with errors_of(recording.name):
            samples, path = recording.samples, recording.path
            alignments.append(aligned := align(samples, path, config, recording.seen))
            check_partial(
                samples,
                path,
                aligned.T_machine_tracker,
                aligned.coverage,
                config.match_tolerance,
            )
            ranges.append(covered_range(alignments[-1], recording))
    nodes = common_nodes(recordings[0].machine, ranges)
    runs = []
    for recording, alignment in zip(recordings, alignments, strict=True):
        with errors_of(recording.name):
            runs.append(reduce_recording(recording, alignment, nodes, config))
    return runs, nodes


def reduce_recording(
    recording: Recording,
    alignment: Alignment,
    nodes: Mapping[str, Array],
    config: CalibrationConfig,
) -> Run:
    """Reduce an aligned recording to pieces for given table nodes."""
    samples, machine = recording.samples, recording.machine
    spacing = tuple(nodes[a] for a in machine.axis_names)
    pieces = reduce_to_pieces(samples, alignment, spacing, config)
    pose = rigid_pose(pieces, alignment.T_machine_tracker, config)
    noise = noise_model(samples, machine.tracker, config.standstill_speed)
    return Run.of(recording, alignment, pieces, pose, noise)


def run_id(recordings: Sequence[Recording], config: CalibrationConfig) -> str:
    """Return the identifier of a calibration: a digest of its recordings and parameters."""
    digest = hashlib.sha256()
    for r in recordings:
        driven = [p.positions for p in r.axis_paths] or [r.path.points]
        for part in (r.samples.stamp_ns, r.samples.xyz, *driven):
            digest.update(np.ascontiguousarray(part).reshape(-1).data)
        digest.update(json.dumps(r.machine.to_dict(), sort_keys=True).encode())
    digest.update(json.dumps(asdict(config), sort_keys=True).encode())
    return digest.hexdigest()[:12]
