# SPDX-License-Identifier: Apache-2.0
"""When to look at a run before its first lap is over: until the place of the tracker is known."""

from __future__ import annotations

from otf_calibrator.collector import Collector
from otf_core.calibration.first_sight import first_legs

EVERY = 30.0
"""s of driving between two looks."""
SHARE = 0.05
"""Share of the path that is driven between two looks, if that is sooner."""
MOST = 4
"""Looks at a run; after that the first lap will tell."""
PATIENT = 1
"""Looks that may fail unsaid: the first legs often do not determine anything yet."""


class Glances:
    """Counts the looks at a run."""

    def __init__(self) -> None:
        self._run = -1
        self._began = 0.0
        self._looks = 0
        self._least = 0.0
        self._found = False

    @property
    def patient(self) -> bool:
        """Whether a look that shows nothing is nothing to worry about yet."""
        return not self._found and self._looks <= PATIENT

    def found(self) -> None:
        """The place of the tracker is known, or soon will be: no further look at this run."""
        self._found = True

    def due(self, collector: Collector, now: float) -> bool:
        """Tell whether to look now, a time in s; counts it then."""
        if collector.path is None or collector.taken or not collector.travelled:
            return False
        if collector.run != self._run:
            self._run, self._began, self._looks, self._found = collector.run, now, 0, False
            self._least = first_legs(collector.path)
        if self._found or self._looks >= MOST or collector.travelled < self._least:
            return False
        driven = collector.travelled / (SHARE * collector.path.length)
        if max(driven, (now - self._began) / EVERY) < self._looks + 1:
            return False
        self._looks += 1
        return True
