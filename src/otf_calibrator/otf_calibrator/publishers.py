# SPDX-License-Identifier: Apache-2.0
"""Whose samples make up a run: those of one publisher; another one's are kept apart.

A driver that was killed comes back as another publisher while the graph still knows the dead one.
So nothing is decided before it is known whether the first one goes on.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from otf_calibrator.losses import PUBLISHERS, Publisher

GONE = 1.0
"""s; a publisher that was silent for so long may have ended, and another one is its successor."""
GONE_BESIDE = 10.0
"""s; the same where the other one has been heard beside it."""


Sent = tuple[Any, int]
"""A message, and how many of its publisher are missing before it."""


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

    def rest(self) -> list[Any]:
        """Return what is held, at the end."""
        held, self._held = self._held, []
        return [message for _, (message, _) in held]

    def _goes_on(self) -> list[Any]:
        """The publisher of the run goes on, so the others are beside it; return their messages."""
        for publisher, _ in self._held:
            if not _among(publisher, self._others):
                self._others.append(publisher)
        del self._others[:-PUBLISHERS]
        return self.rest()

    def _succeed(self, now: float) -> list[Sent]:
        """The publisher held longest is the successor of the one before; return its messages."""
        self._own, self._heard = self._held[0][0], now
        self._others = [other for other in self._others if other is not self._own]
        sent = [sent for publisher, sent in self._held if publisher is self._own]
        self._held = [held for held in self._held if held[0] is not self._own]
        return sent


def _among(publisher: Publisher, known: Iterable[Publisher]) -> bool:
    return any(publisher is other for other in known)
