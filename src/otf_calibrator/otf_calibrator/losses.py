# SPDX-License-Identifier: Apache-2.0
"""Samples lost on the way, by the numbers that publishers give their messages."""

from __future__ import annotations

from collections.abc import Iterable

PUBLISHERS = 4
"""Publishers whose numbers are remembered: those before have ended."""


class SequenceWatch:
    """Counts gaps in the numbers of publishers.

    Fast DDS hands over the number of every message; where the middleware does not (None), only
    the driver's own count is left. Numbers that start again are another publisher, no loss; as it
    may stream beside the first, every number goes on with the nearest one before it.
    """

    def __init__(self) -> None:
        self._last: list[int] = []

    def missed(self, sequence: Iterable[int | None]) -> int:
        """Return how many messages are missing up to the last of these.

        Parameters
        ----------
        sequence : iterable of int or None
            Numbers of messages in the order of their arrival.
        """
        count = 0
        for number in sequence:
            if number is None:
                self._last = []
                continue
            before = max((n for n in self._last if n < number), default=None)
            if before is not None:
                count += number - before - 1
                self._last.remove(before)
            self._last = [*self._last[1 - PUBLISHERS :], number]
        return count
