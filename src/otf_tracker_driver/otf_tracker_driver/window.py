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
UNHEARD = 10
"""Looks at the graph, one each second, that show a calibrator of which no state was heard: it is
not waited for until it states where it is."""


@dataclass
class _Place:
    """Where a calibrator is in the stream: samples taken, or lost to it."""

    passed: int
    acknowledged: bool = False
    heard: bool = False
    untaken: int = 0
    unheard: int = 0


class Window:
    """Which samples of one stream may be published by now.

    Parameters
    ----------
    calibrators : collection of str
        Who listens at its beginning, and so takes the first sample; the others begin with those
        that are published after they were seen first.
    """

    def __init__(self, calibrators: Collection[str] = ()) -> None:
        self._places = {calibrator: _Place(0) for calibrator in calibrators}

    def hear(self, calibrator: str, taken: int, published: int) -> None:
        """Process a state of a calibrator.

        Parameters
        ----------
        taken : int
            Samples of the stream up to the last one taken; 0 if it has taken none.
        published : int
            Samples of the stream that are published.
        """
        place = self._places.setdefault(calibrator, _Place(published))
        place.heard = True
        if taken > place.passed:
            place.passed, place.acknowledged, place.untaken = taken, True, 0
        elif taken == 0 and place.acknowledged:  # it was started again
            place.passed, place.acknowledged, place.untaken = published, False, 0
        elif published > place.passed:
            place.untaken += 1
            if place.untaken >= UNTAKEN:
                place.passed, place.untaken = published, 0

    def see(self, calibrators: Collection[str], published: int) -> None:
        """Process a look at the graph: wait for these calibrators alone; the others are gone."""
        for gone in self._places.keys() - set(calibrators):
            del self._places[gone]
        for calibrator in calibrators:
            place = self._places.setdefault(calibrator, _Place(published))
            place.unheard += not place.heard

    @property
    def allowed(self) -> int | None:
        """Samples of the stream that may be published; None if no calibrator is waited for."""
        waited_for = [p for p in self._places.values() if p.heard or p.unheard < UNHEARD]
        return min(p.passed for p in waited_for) + AHEAD if waited_for else None
