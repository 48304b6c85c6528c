# SPDX-License-Identifier: Apache-2.0
"""How far a run of several parts is, from tracker samples as they come in; whether it is over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.axis_path import PartsTrack
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.rotary.curve_matching import BREAK, apply_location_errors, match, sight_at
from otf_core.rotary.track import Curve, Track
from otf_core.threads import limit_to_one_thread
from otf_core.tracking.path_watch import PathWatcher

BREAK_NS = int(BREAK * 1e9)
PART_DRIVEN = 0.9
"""Share of a part after which a broken beam is taken for the move to the next one."""
LAST_DRIVEN = 0.985
"""Share of the length of the last part that has to be driven at the end of a run."""


@dataclass(frozen=True)
class PartsDriven:
    """How far the parts of a run are driven; ``to_the_end``: the last one to its end."""

    to_the_end: bool


class PartsWatcher(PathWatcher):
    """Follows a run of several parts; the beam is broken between them.

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
        self._reach = [0.0, *path.reach]
        self._breaks = 0
        self._start = 0.0
        self._at_break = False
        self.part = 1
        self.starts: list[int] = []

    def add(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Take one sample: stamp in ns, tracker frame, m."""
        broken = self._last is not None and stamp_ns - self._newest_ns >= BREAK_NS
        if broken:
            self._breaks += 1
            length = self._reach[self.part] - self._reach[self.part - 1]
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
    def in_last_part(self) -> bool:
        """Whether the beam was broken often enough for the last part to be driven."""
        return self._breaks >= len(self._track.parts) - 1

    @limit_to_one_thread
    def look(self, samples: Samples) -> PartsDriven | None:  # type: ignore[override]
        """Tell whether the samples follow all parts to the end of the last; None if they do not.

        They may be in the order of their arrival.
        """
        samples, track = samples.in_order(), self._track
        try:
            matched = match(samples, track.machine, track.parts, quick=True)
        except InputError:
            return None
        last = matched.parts[-1]
        actual = apply_location_errors(track.machine, matched.location)
        sight = sight_at(actual, last.path.target, matched.places)
        curve = Curve.of(sight, last.path.positions)
        driven = Track.of(samples, last.first, last.last).length
        off = matched.pose.apply(samples.xyz[last.last - 1 : last.last])[0] - curve.points[-1]
        near = float(np.linalg.norm(off)) < self._tolerance
        return PartsDriven(near and driven >= LAST_DRIVEN * curve.length)


def watcher_of(path: NominalPath, config: CalibrationConfig) -> PathWatcher:
    """Watcher of a run along a path."""
    if isinstance(path, PartsTrack):
        return PartsWatcher(path, config)
    return PathWatcher(path, config)
