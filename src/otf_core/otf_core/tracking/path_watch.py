# SPDX-License-Identifier: Apache-2.0
"""Has the machine finished the path? Judged from tracker samples as they come in."""

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
from otf_core.tracking.alignment import FollowedTrack, follow_track
from otf_core.tracking.arc_length import GrowingLength
from otf_core.tracking.curve_matching import (
    SAME_LENGTH,
    apply_location_errors,
    match,
    sight_at,
)
from otf_core.tracking.curves import lines_of_part
from otf_core.tracking.measured_track import HOP

END_STANDSTILL = 1.0
"""s; a standstill so long is evaluated: it ends the run if it is at the end point."""
MIN_TRAVEL = 0.5
"""Share of the path length before which no end is expected (gaps shorten the travel)."""
NEARLY, SOON = 0.98, 0.25
"""Driven share of the path, and standstill (s) at its end point, that end a run."""
AT_REST = 0.05
"""s after the start of such a standstill at which the run ends: later samples belong to no run,
and the evaluation can start before the standstill has lasted."""

STRAY, AT_ONCE_NS = 0.05, 50_000_000
"""m, ns; no target travels so far at once: a stray point, or the way back from one."""
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


class PathWatcher:
    """Follows the travelled length and recognises standstill at the end point.

    Travel and standstill are counted sample by sample; only a standstill after enough travel is
    compared with the path (by ``look``, which aligns and takes a fraction of a second). Samples
    that arrive after later ones are left out of both: they would count as ways there and back.

    Which samples a run has follows from stamps and points alone, not from when somebody looks.

    Between parts the beam is broken. A comparison of all samples with curves takes as long as they
    are many, and where the linear axes follow a rotation the target nearly stands all the time. So
    samples are compared before the last part is over and once more near its end; else only new
    samples are looked at.

    Attributes
    ----------
    travelled : float
        m
    part : int
        Part that is being driven, from 1.
    starts : list of int
        Samples before every part but the first.
    end : int or None
        Samples of the run if the standstill that is to be evaluated ends it; None if there is no
        such standstill.
    """

    def __init__(self, path: NominalPath, config: CalibrationConfig) -> None:
        self._path, self._config = path, config
        self.travelled = 0.0
        self._last: tuple[float, float, float] | None = None
        self._still_since_ns: int | None = None
        self._newest_ns = self._count = 0
        self.end: int | None = None
        self._here: int | None = None  # the same for the present standstill
        self._looked_at = self._stood = False
        self.part = 1
        self.starts: list[int] = []
        self._start, self._at_break, self._breaks = 0.0, False, 0
        self._courses: list[tuple[Array, Array]] | None = None
        self._driven: GrowingLength | None = None
        self._looked = 0
        self._worth_comparing = 0.0
        self._last_part: _LastPart | None = None

    def add(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Take one sample: stamp in ns, tracker frame, m."""
        if self._last is not None and stamp_ns - self._newest_ns >= BREAK_NS:
            self._begin_part()
        self._count += 1
        self._take(stamp_ns, x, y, z)
        if self._at_break:
            self._start, self._at_break = self.travelled, False

    def _take(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Count travel and standstill."""
        if self._last is not None:
            if stamp_ns < self._newest_ns:
                return
            dx, dy, dz = x - self._last[0], y - self._last[1], z - self._last[2]
            square = dx * dx + dy * dy + dz * dz
            if square < HOP * HOP:
                if self._still_since_ns is None:
                    self._still_since_ns = stamp_ns
                self._newest_ns = stamp_ns
                if self._here is None:
                    self._rest()
                return
            self._move_on()
            stray = square > STRAY * STRAY and stamp_ns - self._newest_ns < AT_ONCE_NS
            self.travelled += 0.0 if stray else square**0.5
        self._last = (x, y, z)
        self._still_since_ns = self._newest_ns = stamp_ns

    def _begin_part(self) -> None:
        """The beam was broken: if this part is driven, the next one begins."""
        self._breaks += 1
        lengths = self._path.part_lengths
        driven = self.travelled - self._start >= PART_DRIVEN * lengths[self.part - 1]
        if driven and self.part < len(lengths):
            self.starts.append(self._count)
            self.part += 1
            self._at_break = True

    def _rest(self) -> None:
        """The target stands: it may be the end."""
        if self.share >= MIN_TRAVEL and self.standstill >= self._long(AT_REST):
            self._here = self._count
            if self.end is None:
                self.end = self._here

    def _move_on(self) -> None:
        """The target moves: that was the end if it has stood for long enough, and only then."""
        if self._here is not None and self.end == self._here:
            self._stood = self.stood
            if not self._stood:
                self._next_end(None)
        self._here = None

    def _next_end(self, end: int | None) -> None:
        self.end, self._looked_at, self._stood = end, False, False

    @property
    def time_share(self) -> float:
        """Share of the driving time that is over, hand moves left out.

        A path states no feed; its legs are taken to last as long as those of a plan at the usual
        one, of which rotary axes often are the slower ones.
        """
        if not isinstance(self._path, PartsTrack):
            return min(1.0, self.travelled / self._path.length)
        if self._courses is None:
            self._courses = [_course(self._path, k) for k in range(len(self._path.parts))]
        way, seconds = self._courses[self.part - 1]
        before = sum(float(own[-1]) for _, own in self._courses[: self.part - 1])
        whole = sum(float(own[-1]) for _, own in self._courses)
        now = float(np.interp(self.travelled - self._start, way, seconds))
        return (before + now) / whole

    @property
    def standstill(self) -> float:
        """Seconds since the target last moved by a millimetre."""
        if self._still_since_ns is None:
            return 0.0
        return (self._newest_ns - self._still_since_ns) * 1e-9

    @property
    def worth_judging(self) -> bool:
        """True if the samples should be evaluated, which is so until ``judge`` is called."""
        return self.end is not None and not self._looked_at

    def judge(self) -> None:
        """Record that the samples are evaluated; once a standstill is enough."""
        self._looked_at = True

    def dismiss(self) -> None:
        """Record that the standstill that was evaluated is not at the end of the path."""
        self._next_end(None if self.end == self._here else self._here)

    def stays(self) -> None:
        """Record that the target has stood since the last sample, for long enough."""
        self._stood = self.end is not None and self.end == self._here

    @property
    def stood(self) -> bool:
        """True if the standstill that is to be evaluated is, or was, long enough to end a run."""
        here = self.end is not None and self.end == self._here
        return self._stood or (here and self.standstill >= self._long(SOON))

    @property
    def share(self) -> float:
        """Share of the path that has been travelled; 0 as long as the run cannot be over."""
        return self.travelled / self._path.length if self.in_last_part else 0.0

    @property
    def in_last_part(self) -> bool:
        """Whether the beam was broken often enough for the last part to be driven."""
        return self._breaks >= len(self._path.part_lengths) - 1

    def _long(self, at_the_end: float) -> float:
        """Standstill, s, that counts here."""
        return at_the_end if self.share >= NEARLY else END_STANDSTILL

    @limit_to_one_thread  # as what it begins is calibrated, to the last bit
    def look(self, samples: Samples) -> FollowedTrack | PartsDriven | None:
        """Determine whether the samples follow the path, and to its end; None if they do not.

        Parameters
        ----------
        samples : Samples
            All of the run up to a moment, no earlier one than at the last call. They may be in the
            order of their arrival.
        """
        samples = samples.in_order()
        if isinstance(self._path, PartsTrack):
            return self._look_at_parts(samples, self._path)
        try:
            return follow_track(samples, self._path, self._config)
        except InputError:
            return None

    def _look_at_parts(self, samples: Samples, track: PartsTrack) -> PartsDriven | None:
        new = samples.stamp_ns[max(0, self._looked - 1) :]
        self._looked = len(samples)
        if self._driven is None or (np.diff(new) >= BREAK_NS).any():
            self._driven = self._begin_last(samples, track)
        driven = self._driven.up_to(samples)
        if driven < self._worth_comparing:
            return PartsDriven(False)
        known = self._last_part
        if known is None or not known.nearly_whole:
            known = self._last_part = self._compare(samples, track)
            if known is None:
                self._worth_comparing = (1.0 + FURTHER) * driven
                return None
            driven = known.driven
            if not known.nearly_whole:
                self._worth_comparing = PART_DRIVEN * known.length
        off = float(np.linalg.norm(known.pose.apply(samples.xyz[-1:])[0] - known.end))
        there = off < self._config.match_tolerance
        return PartsDriven(there and driven >= LAST_DRIVEN * known.length)

    def _begin_last(self, samples: Samples, track: PartsTrack) -> GrowingLength:
        """Take the samples since the last break for the last part, if all others are driven."""
        self._last_part, self._worth_comparing = None, 0.0
        if self.part < len(track.parts):
            return GrowingLength(0, samples.step)
        last = track.parts[-1]
        nominal = lines_of_part(Sight.of_target(track.machine, last.target), last.positions).run
        self._worth_comparing = PART_DRIVEN * (1.0 - SAME_LENGTH) * float(nominal[-1])
        return GrowingLength(self.starts[-1] if self.starts else 0, samples.step)

    def _compare(self, samples: Samples, track: PartsTrack) -> _LastPart | None:
        """Compare all samples with the path; None if they do not follow it."""
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
    q = position_at(part.positions, along_legs(part.axes, part.positions, TRACK_STEP, TRACK_TURN))
    points = Sight.of_target(track.machine, part.target).nominal(q)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    seconds = seconds_of_legs(track.machine, q, PlannerConfig.feed)
    return np.append(0.0, steps.cumsum()), np.append(0.0, seconds.cumsum())
