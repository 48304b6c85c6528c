# SPDX-License-Identifier: Apache-2.0
"""Lost samples of a run: by the driver's count of its stream, and by the stamps over restarts.

The driver states how many samples it has published, and the stamp of the last of them. Samples
arrive in their order: once one with a later stamp is there, those up to this stamp that are not
are lost, however many more are on their way.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import takewhile

from otf_core.model.observation import SampleBuffer

REMEMBERED = 10_000
"""Stamps of the last samples; a status is not later than so many of them."""
LATE = 2.0
"""s; samples that have not arrived so long after the end of their stream are lost."""
LOOKED_AT = 500
"""Last samples before a restart whose rate counts."""


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
    missing: int | None = None
    """Samples that have not arrived although later ones have; None: not known."""
    _stamps: deque[int] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    _stated: tuple[int, int] | None = None

    def arrive(self, stamp_ns: int) -> None:
        """Count a sample that has arrived."""
        if self._stated and stamp_ns > self._stated[1]:
            self._count(self._stated[0], self.received)
        self.received += 1
        self._stamps.append(stamp_ns)

    def announce(self, published: int, last_ns: int) -> None:
        """Process the number of published samples and the stamp of the last, ns; 0: not stated."""
        self.announced, self._stated = published, None
        later = sum(1 for _ in takewhile(lambda stamp: stamp > last_ns, reversed(self._stamps)))
        if last_ns and later < len(self._stamps):
            if later or self._stamps[-1] == last_ns:
                self._count(published, self.received - later)
            else:
                self._stated = published, last_ns

    def _count(self, published: int, received: int) -> None:
        """Update the number of missing samples."""
        self.missing, self._stated = max(0, published - self.unknown - received), None

    @property
    def lost(self) -> int:
        """Samples that were announced and have not arrived."""
        return max(0, self.announced - self.unknown - self.received)

    def over(self, now: float) -> bool:
        """Return whether no further sample of this stream will come."""
        silent = now - max(self.ended_at, self.heard)
        return self.ended and (self.received >= self.announced or silent > LATE)


class Restarts:
    """Gaps in the stamps where driver or calibrator were restarted during a run.

    Attributes
    ----------
    samples : int
        As many as there would have been at the rate before.
    uncounted : bool
        Driver and calibrator were away together: nobody knows how many of them were published.
    """

    def __init__(self) -> None:
        self.seconds, self.samples, self.uncounted = 0.0, 0, False
        self._expected = False

    def expect(self) -> None:
        """Expect a gap before the next sample, which is the first after a restart."""
        self._expected = True

    def sample(self, stamp_ns: int, buffer: SampleBuffer) -> None:
        """Measure the gap between a sample with stamp in ns and the samples before it."""
        if not self._expected:
            return
        self._expected = False
        before = buffer.snapshot(max(0, len(buffer) - LOOKED_AT))
        step = before.in_order().step_ns
        left_out = stamp_ns - int(before.stamp_ns.max()) - step if step else 0.0
        if left_out > 0.5 * step:
            self.seconds += 1e-9 * left_out
            self.samples += round(left_out / step)

    @property
    def remarks(self) -> list[str]:
        """In words."""
        if not self.samples:
            return []
        rate = self.samples / self.seconds
        return [
            f'{self.seconds:.2f} s of the run ({self.samples} samples at {rate:.0f} Hz) are '
            f'missing because driver or calibrator restarted'
        ]


def lost_words(count: int, at_least: bool) -> str:
    """State how many samples were lost."""
    return f'{"at least " if at_least else ""}{count} samples were lost on the way'
