# SPDX-License-Identifier: Apache-2.0
"""One stream of the driver: what it has announced, and how much of it has arrived."""

from __future__ import annotations

from dataclasses import dataclass

LATE = 2.0
"""s; samples that have not arrived so long after the end of their stream are lost."""


@dataclass
class Stream:
    """What is known of one stream of the driver; all zero without any status.

    One that was taken over from another has not shown yet whether it goes on with the run; of one
    that is heard of again it is unknown how many of the samples before have arrived.
    """

    name: str = ''
    received: int = 0
    announced: int = 0
    finished: bool = False
    ended: bool = False
    ended_at: float = 0.0
    heard: float = 0.0
    taken_over: bool = False
    unknown: int = 0

    @property
    def lost(self) -> int:
        """Samples that were announced and have not arrived."""
        return max(0, self.announced - self.unknown - self.received)

    def over(self, now: float) -> bool:
        """Tell whether no further sample of this stream will come."""
        silent = now - max(self.ended_at, self.heard)
        return self.ended and (self.received >= self.announced or silent > LATE)
