# SPDX-License-Identifier: Apache-2.0
"""A run has the samples of one publisher: those of a second one are left out and counted.

rclpy does not say who sent a message, but Fast DDS numbers the messages of each publisher. While
the graph knows a second one, a message whose number does not go on with the run is not of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

A = TypeVar('A')
GAP = 1000
"""Messages in a row that the publisher of the run may lose while there is another one."""
GONE, GONE_BESIDE = 1.0, 10.0
"""s; a publisher that was silent for so long has a successor, as a driver that was restarted; the
same where both have been heard at the same time."""


class PublisherOfRun:
    """The publisher that was heard first.

    Parameters
    ----------
    present : callable
        Returns how many publishers the graph knows at this moment.

    Attributes
    ----------
    missed : int
        Its messages that the numbers leave out among those selected last.
    """

    def __init__(self, present: Callable[[], int]) -> None:
        self._present = present
        self._last: int | None = None
        self._other: int | None = None
        self._beside = False
        self._heard = 0.0
        self.missed = 0

    def select(self, messages: Sequence[A], numbers: Sequence[int | None], now: float) -> list[A]:
        """Return the messages of the run.

        Parameters
        ----------
        numbers : sequence of int or None
            As the publishers gave them; None where the middleware does not tell: then all count.
        now : float
            s, monotonic.
        """
        self.missed = 0
        own = [m for m, n in zip(messages, numbers, strict=True) if self._take(n)]
        if not own and now - self._heard > (GONE_BESIDE if self._beside else GONE):
            self._last, self._other, self._beside = numbers[-1], None, False
            own = list(messages)
        if own:
            self._heard = now
        return own

    def _take(self, number: int | None) -> bool:
        """Whether a message is of the publisher of the run."""
        if number is None:
            return True
        step = GAP + 1 if self._last is None else number - self._last
        other = 0 if self._other is None else number - self._other
        goes_on = 0 < step <= GAP and not 0 < other < step
        if not goes_on and self._last is not None and self._present() > 1:
            self._other = number
            return False
        if not goes_on:
            self._other, self._beside = None, False
        self.missed += step - 1 if self._last is not None and step > 0 else 0
        self._last, self._beside = number, self._beside or self._other is not None
        return True
