# SPDX-License-Identifier: Apache-2.0
"""Samples lost on the way, by the numbers that a publisher gives its messages."""

from __future__ import annotations

from collections.abc import Iterable


class SequenceWatch:
    """Counts gaps in the numbers of one publisher.

    Fast DDS hands over the number of every message; where the middleware does not (None), only
    the driver's own count is left. Numbers that start again are another publisher, no loss.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def missed(self, sequence: Iterable[int | None]) -> int:
        """Return how many messages are missing up to the last of these.

        Parameters
        ----------
        sequence : iterable of int or None
            Numbers of messages in the order of their arrival.
        """
        count = 0
        for number in sequence:
            if number is not None and self._last is not None and number > self._last + 1:
                count += number - self._last - 1
            self._last = number
        return count
