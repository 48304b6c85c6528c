# SPDX-License-Identifier: Apache-2.0
"""Has the machine finished the path? Judged from tracker samples as they come in."""

from __future__ import annotations

from otf_core.config import CalibrationConfig
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.threads import limit_to_one_thread
from otf_core.tracking.alignment import FollowedTrack, follow_track
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


class PathWatcher:
    """Follows the travelled length and recognises standstill at the end point.

    Travel and standstill are counted sample by sample; only a standstill after enough travel is
    compared with the path (by ``look``, which aligns and takes a fraction of a second). Samples
    that arrive after later ones are left out of both: they would count as ways there and back.

    Which samples a run has follows from stamps and points alone, not from when somebody looks.

    Attributes
    ----------
    travelled : float
        m
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

    def add(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        """Take one sample: stamp in ns, tracker frame, m."""
        self._count += 1
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
        """Share of the driving time that is over, as that of the length travelled."""
        return min(1.0, self.travelled / self._path.length)

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
        return self.travelled / self._path.length

    def _long(self, at_the_end: float) -> float:
        """Standstill, s, that counts here."""
        return at_the_end if self.share >= NEARLY else END_STANDSTILL

    @limit_to_one_thread  # as what it begins is calibrated, to the last bit
    def look(self, samples: Samples) -> FollowedTrack | None:
        """Determine how the samples follow the path, and whether to its end; None if they do not.

        They may be in the order of their arrival.
        """
        try:
            return follow_track(samples.in_order(), self._path, self._config)
        except InputError:
            return None
