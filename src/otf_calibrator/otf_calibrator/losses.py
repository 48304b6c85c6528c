# SPDX-License-Identifier: Apache-2.0
"""Who published a sample, and what was lost on the way: by the numbers that publishers give."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from otf_core.model.observation import SampleBuffer

PUBLISHERS = 4
"""Publishers whose numbers are remembered: those before have ended."""
GAP = 1000
"""Messages in a row that a publisher may lose while there is another one: with more it cannot be
told from that one."""

LOOKED_AT = 500
"""Last samples before a restart whose rate counts."""


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


class Restarts:
    """What the stamps leave out where driver or calibrator were started again in a run.

    Attributes
    ----------
    seconds : float
    samples : int
        As many as there would have been at the rate before.
    uncounted : bool
        Driver and calibrator were away together: nobody knows how many of them were published.
    """

    def __init__(self) -> None:
        self.seconds, self.samples, self.uncounted = 0.0, 0, False
        self._expected = False

    def expect(self) -> None:
        """The next sample is the first after a restart."""
        self._expected = True

    def sample(self, stamp_ns: int, buffer: SampleBuffer) -> None:
        """Take the stamp of a sample, ns, and the samples before it."""
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
            f'restarts of driver or calibrator leave out {self.seconds:.2f} s of the run '
            f'({self.samples} samples at {rate:.0f} Hz)'
        ]


def lost_words(count: int, at_least: bool) -> str:
    """Say how many samples were lost."""
    return f'{"at least " if at_least else ""}{count} samples were lost on the way'
