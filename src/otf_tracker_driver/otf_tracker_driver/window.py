# SPDX-License-Identifier: Apache-2.0
"""How far a source that can wait may run ahead of the calibrators that take its samples.

A calibrator states the stamp of the last sample that it has taken. Samples arrive in their order,
so all before that one have arrived or are lost.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

AHEAD = 4000
"""Samples on their way: a fifth of what the queues hold, and less than a recorder's 5000."""
UNTAKEN = 10
"""States of a calibrator, one each half second, without a sample taken: what was published before
is lost. It was published before the calibrator could hear it, or to the one before."""


@dataclass
class _Place:
    """Where a calibrator is in the stream: samples taken, or lost to it."""

    passed: int
    acknowledged: bool = False
    untaken: int = 0


class Window:
    """Which samples of one stream may be published by now.

    Parameters
    ----------
    calibrators : collection of str
        Who listens at its beginning, and so takes the first sample; the others begin with those
        that are published after they were heard first.
    """

    def __init__(self, calibrators: Collection[str] = ()) -> None:
        self._from_the_first = set(calibrators)
        self._places: dict[str, _Place] = {}

    def hear(self, calibrator: str, taken: int, published: int) -> None:
        """Process a state of a calibrator.

        Parameters
        ----------
        taken : int
            Samples of the stream up to the last one taken; 0 if it has taken none.
        published : int
            Samples of the stream that are published.
        """
        first = 0 if calibrator in self._from_the_first else published
        place = self._places.setdefault(calibrator, _Place(first))
        if taken > place.passed:
            self._places[calibrator] = _Place(taken, acknowledged=True)
        elif taken == 0 and place.acknowledged:  # it was started again
            self._places[calibrator] = _Place(published)
        elif published > place.passed:
            place.untaken += 1
            if place.untaken >= UNTAKEN:
                place.passed, place.untaken = published, 0

    def keep(self, calibrators: Collection[str]) -> None:
        """Wait no more for calibrators that are not among these: they are gone."""
        self._from_the_first &= set(calibrators)
        for gone in self._places.keys() - set(calibrators):
            del self._places[gone]

    @property
    def allowed(self) -> int | None:
        """Samples of the stream that may be published; None if no calibrator is heard: all."""
        passed = [place.passed for place in self._places.values()]
        return min(passed) + AHEAD if passed else None
