# SPDX-License-Identifier: Apache-2.0
"""How far a run of several parts is, from tracker samples as they come in; whether it is over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.arrays import Array
from otf_core.config import CalibrationConfig, PlannerConfig
from otf_core.errors import InputError
from otf_core.model.axis_path import (
    BREAK,
    TRACK_STEP,
    TRACK_TURN,
    PartsTrack,
    along_legs,
    position_at,
    seconds_of_legs,
)
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.threads import limit_to_one_thread
from otf_core.tracking.arc_length import GrowingLength
from otf_core.tracking.curve_matching import (
    SAME_LENGTH,
    apply_location_errors,
    match,
    sight_at,
)
from otf_core.tracking.curves import lines_of_part
from otf_core.tracking.path_watch import PathWatcher

BREAK_NS = int(BREAK * 1e9)
PART_DRIVEN = 0.9
"""Share of a part after which a broken beam is taken for the move to the next one."""
LAST_DRIVEN = 0.985
"""Share of the length of the last part that has to be driven at the end of a run."""
FURTHER = 0.01
"""Share of the last part after which samples that did not follow the path are compared again."""


@dataclass(frozen=True)
class PartsDriven:
    """How far the parts of a run are driven; ``to_the_end``: the last one to its end."""

    to_the_end: bool


@dataclass(frozen=True)
class _LastPart:
    """The last part as samples follow it.

    Attributes
    ----------
    end : ndarray, shape (3,), m
        Its end point, in the frame of the tracker's link.
    driven, length : float
        m; what was driven when the samples were compared with the path, and its whole curve.
    """

    pose: RigidTransform
    end: Array
    driven: float
    length: float

    @property
    def nearly_whole(self) -> bool:
        """Whether it was driven so far that pose and length stay as they are."""
        return self.driven >= PART_DRIVEN * self.length


class PartsWatcher(PathWatcher):
    """Follows a run of several parts; the beam is broken between them.

    A comparison of all samples with the path takes as long as they are many, and where the linear
    axes follow a rotation the target nearly stands all the time. So samples are compared before
    the last part is over and once more near its end; else only new samples are looked at.

    Attributes
    ----------
    part : int
        Part that is being driven, from 1.
    starts : list of int
        Samples before every part but the first.
    """

    def __init__(self, path: PartsTrack, config: CalibrationConfig) -> None:
        super().__init__(path, config)
        self._track, self._tolerance = path, config.match_tolerance
        self._breaks = 0
        self._start = 0.0
        self._at_break = False
        self.part = 1
        self.starts: list[int] = []
        self._driven: GrowingLength | None = None
        self._looked = 0
        self._worth_comparing = 0.0
        self._last_part: _LastPart | None = None
        self._seconds: list[tuple[Array, Array]] | None = None

    def add(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Take one sample: stamp in ns, tracker frame, m."""
        broken = self._last is not None and stamp_ns - self._newest_ns >= BREAK_NS
        if broken:
            self._breaks += 1
            length = self._track.part_lengths[self.part - 1]
            driven = self.travelled - self._start >= PART_DRIVEN * length
            if driven and self.part < len(self._track.parts):
                self.starts.append(self._count)
                self.part += 1
                self._at_break = True
        super().add(stamp_ns, x, y, z)
        if self._at_break:
            self._start, self._at_break = self.travelled, False

    @property
    def share(self) -> float:
        """Share of the path that has been travelled; 0 before the last part."""
        return self.travelled / self._path.length if self.in_last_part else 0.0

    @property
    def time_share(self) -> float:
        """Share of the driving time that is over, hand moves left out.

        A path states no feed; its legs are taken to last as long as those of a plan at the usual
        one, of which rotary axes often are the slower ones.
        """
        if self._seconds is None:
            self._seconds = [_course(self._track, k) for k in range(len(self._track.parts))]
        way, seconds = self._seconds[self.part - 1]
        before = sum(float(own[-1]) for _, own in self._seconds[: self.part - 1])
        whole = sum(float(own[-1]) for _, own in self._seconds)
        now = float(np.interp(self.travelled - self._start, way, seconds))
        return (before + now) / whole

    @property
    def in_last_part(self) -> bool:
        """Whether the beam was broken often enough for the last part to be driven."""
        return self._breaks >= len(self._track.parts) - 1

    @limit_to_one_thread
    def look(self, samples: Samples) -> PartsDriven | None:  # type: ignore[override]
        """Tell whether the samples follow all parts to the end of the last; None if they do not.

        Parameters
        ----------
        samples : Samples
            All of the run up to a moment, no earlier one than at the last call. They may be in the
            order of their arrival.
        """
        samples = samples.in_order()
        new = samples.stamp_ns[max(0, self._looked - 1) :]
        self._looked = len(samples)
        if self._driven is None or (np.diff(new) >= BREAK_NS).any():
            self._driven = self._begin(samples)
        driven = self._driven.up_to(samples)
        if driven < self._worth_comparing:
            return PartsDriven(False)
        known = self._last_part
        if known is None or not known.nearly_whole:
            known = self._last_part = self._compare(samples)
            if known is None:
                self._worth_comparing = (1.0 + FURTHER) * driven
                return None
            driven = known.driven
            if not known.nearly_whole:
                self._worth_comparing = PART_DRIVEN * known.length
        off = float(np.linalg.norm(known.pose.apply(samples.xyz[-1:])[0] - known.end))
        return PartsDriven(off < self._tolerance and driven >= LAST_DRIVEN * known.length)

    def _begin(self, samples: Samples) -> GrowingLength:
        """Take the samples since the last break for the last part, if all others are driven."""
        track, self._last_part, self._worth_comparing = self._track, None, 0.0
        if self.part < len(track.parts):
            return GrowingLength(0, samples.step)
        last = track.parts[-1]
        nominal = lines_of_part(Sight.of_target(track.machine, last.target), last.positions).run
        self._worth_comparing = PART_DRIVEN * (1.0 - SAME_LENGTH) * float(nominal[-1])
        return GrowingLength(self.starts[-1] if self.starts else 0, samples.step)

    def _compare(self, samples: Samples) -> _LastPart | None:
        """Compare all samples with the path; None if they do not follow it."""
        track = self._track
        try:
            matched = match(samples, track.machine, track.parts, quick=True, in_any_order=False)
        except InputError:
            return None
        last = matched.parts[-1]
        if self._driven is None or self._driven.first != last.first:  # broken on its way, too
            self._driven = GrowingLength(last.first, samples.step)
        actual = apply_location_errors(track.machine, matched.location)
        sight = sight_at(actual, last.path.target, matched.places)
        curve = lines_of_part(sight, last.path.positions)
        driven = self._driven.up_to(samples)
        pose = matched.T_machine_tracker
        return _LastPart(pose, curve.corners[-1], driven, float(curve.run[-1]))


def _course(track: PartsTrack, number: int) -> tuple[Array, Array]:
    """Way of the reflector, m, and time, s, at points of a part that begins at 0."""
    part = track.parts[number]
    q = position_at(part.positions, along_legs(part.positions, TRACK_STEP, TRACK_TURN))
    points = Sight.of_target(track.machine, part.target).nominal(q)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    seconds = seconds_of_legs(track.machine, q, PlannerConfig.feed)
    return np.append(0.0, steps.cumsum()), np.append(0.0, seconds.cumsum())


def watcher_of(path: NominalPath, config: CalibrationConfig) -> PathWatcher:
    """Watcher of a run along a path."""
    if isinstance(path, PartsTrack):
        return PartsWatcher(path, config)
    return PathWatcher(path, config)
