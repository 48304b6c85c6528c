# SPDX-License-Identifier: Apache-2.0
"""Who published a sample, and what was lost on the way: by the numbers that publishers give."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

PUBLISHERS = 4
"""Publishers whose numbers are remembered: those before have ended."""
GAP = 1000
"""Messages in a row that a publisher may lose while there is another one: with more it cannot be
told from that one."""


@dataclass
class Publisher:
    """One publisher: the number of its last message."""

    last: int


class SequenceWatch:
    """Tells publishers apart, and counts gaps in the numbers of each.

    Fast DDS hands over the number of every message; where the middleware does not (None), only
    the driver's own count is left, and all messages count as of one publisher. rclpy does not say
    who sent a message. A number goes on with the nearest one before it, unless the graph knows
    several publishers and the gap is large.

    Parameters
    ----------
    present : callable
        Returns how many publishers the graph knows at this moment.

    """

    def __init__(self, present: Callable[[], int] = lambda: 1) -> None:
        self._present = present
        self._known: list[Publisher] = []
        self._unnumbered = Publisher(0)

    def publishers(self, sequence: Iterable[int | None]) -> list[tuple[Publisher, int]]:
        """Return the publisher of every message, and how many of its messages are missing before.

        Parameters
        ----------
        sequence : iterable of int or None
            Numbers of messages in the order of their arrival.
        """
        found: list[tuple[Publisher, int]] = []
        for number in sequence:
            if number is None:
                self._known = []
                found.append((self._unnumbered, 0))
                continue
            publisher, missed = self._goes_on(number), 0
            if publisher is None:
                publisher = Publisher(number)
                self._known.append(publisher)
            else:
                missed = number - publisher.last - 1
                publisher.last = number
                self._known.remove(publisher)  # the one heard last stays longest
                self._known.append(publisher)
            del self._known[:-PUBLISHERS]
            found.append((publisher, missed))
        return found

    def _goes_on(self, number: int) -> Publisher | None:
        """The publisher whose numbers this one goes on with; None: another one."""
        before = max(
            (p for p in self._known if p.last < number), key=lambda p: p.last, default=None
        )
        if before is None or number - before.last <= GAP or self._present() < 2:
            return before
        return None
