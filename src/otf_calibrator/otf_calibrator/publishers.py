# SPDX-License-Identifier: Apache-2.0
"""Who published a sample, what of it was lost on the way, and whose samples make up a run.

Messages have the numbers that their publishers gave them; gaps in these are losses. A run has the
samples of one publisher; another one's are kept apart. A driver that was killed comes back as
another publisher while the graph still knows the dead one, so nothing is decided before it is
known whether the first one goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

PUBLISHERS = 4
"""Publishers whose numbers are remembered: those before have ended."""
GAP = 1000
"""Messages in a row that a publisher may lose while there is another one: with more it cannot be
told from that one."""
GONE = 1.0
"""s; a publisher that was silent for so long may have ended, and another one is its successor."""
GONE_BESIDE = 10.0
"""s; the same where the other one has been heard beside it."""


Sent = tuple[Any, int]
"""A message, and how many of its publisher are missing before it."""


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
        counts: list[tuple[Publisher, int]] = []
        for number in sequence:
            if number is None:
                self._known = []
                counts.append((self._unnumbered, 0))
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
            counts.append((publisher, missed))
        return counts

    def _goes_on(self, number: int) -> Publisher | None:
        """The publisher whose numbers this one goes on with; None: another one."""
        before = max(
            (p for p in self._known if p.last < number), key=lambda p: p.last, default=None
        )
        if before is None or number - before.last <= GAP or self._present() < 2:
            return before
        return None


class Choice:
    """Which publisher's messages are used."""

    def __init__(self) -> None:
        self._own: Publisher | None = None
        self._heard = 0.0
        self._others: list[Publisher] = []
        self._held: list[tuple[Publisher, Sent]] = []

    def take(
        self, publishers: Iterable[tuple[Publisher, int]], messages: Iterable[Any], now: float
    ) -> tuple[list[Sent], list[Any]]:
        """Return the messages that are of the run, and those of another publisher.

        Parameters
        ----------
        publishers : iterable of (Publisher, int)
            Of every message, and how many are missing before it.
        messages : iterable
            May be empty: what was held is decided on then.
        now : float
            s
        """
        used: list[Sent] = []
        beside: list[Any] = []
        for (publisher, missed), message in zip(publishers, messages, strict=True):
            if self._own is None or publisher is self._own:
                self._own, self._heard = publisher, now
                if self._held:
                    beside += self._goes_on()
                used.append((message, missed))
            elif _among(publisher, self._others) and now - self._heard < GONE_BESIDE:
                beside.append(message)
            else:
                self._held.append((publisher, (message, missed)))
        if self._held and now - self._heard >= GONE:
            used += self._succeed(now)
        return used, beside

    @property
    def waiting(self) -> bool:
        """Whether messages are held."""
        return bool(self._held)

    def release_held(self) -> list[Any]:
        """Return what is held, at the end."""
        held, self._held = self._held, []
        return [message for _, (message, _) in held]

    def _goes_on(self) -> list[Any]:
        """The publisher of the run goes on, so the others are beside it; return their messages."""
        for publisher, _ in self._held:
            if not _among(publisher, self._others):
                self._others.append(publisher)
        del self._others[:-PUBLISHERS]
        return self.release_held()

    def _succeed(self, now: float) -> list[Sent]:
        """The publisher held longest is the successor of the one before; return its messages."""
        self._own, self._heard = self._held[0][0], now
        self._others = [other for other in self._others if other is not self._own]
        sent = [sent for publisher, sent in self._held if publisher is self._own]
        self._held = [held for held in self._held if held[0] is not self._own]
        return sent


def _among(publisher: Publisher, known: Iterable[Publisher]) -> bool:
    return any(publisher is other for other in known)
