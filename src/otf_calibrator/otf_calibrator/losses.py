# SPDX-License-Identifier: Apache-2.0
"""Lost samples of a run by the driver's count of its stream, and the gaps that restarts left.

The driver states how many samples it has published, and the stamp of the last of them. Samples
arrive in their order: once that one or a later one is there, those before it that are not are
lost, however many more are on their way.
"""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.model.observation import SampleBuffer
from otf_core.model.provenance import moment

LATE = 2.0
"""s; samples that have not arrived so long after the end of their stream are lost."""
LOOKED_AT = 500
"""Last samples before a restart whose rate counts."""


@dataclass
class Stream:
    """One stream of the driver as status and samples tell; all zero without any status.

    Attributes
    ----------
    before : int
        Samples published before it was heard of, of which nobody here knows.
    missing : int
        Samples that have not arrived although later ones have.
    """

    name: str = ''
    before: int = 0
    received: int = 0
    announced: int = 0
    missing: int = 0
    finished: bool = False
    ended: bool = False
    ended_at: float = 0.0
    heard: float = 0.0
    told: float = 0.0
    _by_stamp: bool = False
    _stated: tuple[int, int] | None = None

    def announce(self, published: int, last_ns: int) -> None:
        """Process the number of published samples and the stamp of the last, ns; 0: not stated."""
        self.announced, self._by_stamp = published, bool(last_ns)
        self._stated = (published, last_ns) if last_ns else None

    def count(self, newest_ns: int | None) -> None:
        """Count what is missing, given the newest stamp that has arrived, ns."""
        if self._stated and newest_ns is not None and newest_ns >= self._stated[1]:
            of_these = self.received - (newest_ns > self._stated[1])
            self.missing = max(self.missing, self._stated[0] - self.before - of_these)
            self._stated = None

    @property
    def outstanding(self) -> int:
        """Samples that were announced and have not arrived."""
        return max(0, self.announced - self.before - self.received)

    @property
    def gone(self) -> int:
        """Those of them that will not, as far as is known at this moment."""
        return self.missing if self._by_stamp and not self.ended else self.outstanding

    def over(self, now: float) -> bool:
        """Return whether no further sample of this stream is to be expected."""
        late = now - max(self.ended_at, self.heard) > LATE
        return self.ended and (late or not self.outstanding)

    def lost(self, now: float) -> int:
        """Samples that were published and will not arrive."""
        return self.outstanding if self.over(now) else self.missing


class Restarts:
    """Gaps in the stamps where driver or calibrator were restarted during a run.

    Attributes
    ----------
    remarks : list of str
        Each of them in words.
    """

    def __init__(self) -> None:
        self.remarks: list[str] = []
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
        last, step = int(before.stamp_ns.max()), before.in_order().step_ns
        if step and stamp_ns - last > 1.5 * step:
            at = moment(last) or f'stamp {1e-9 * last:.3f} s'
            gap = 1e-9 * (stamp_ns - last)
            self.remarks.append(f'driver or calibrator restarted at {at}: gap of {gap:.2f} s')


def lost_words(count: int) -> str:
    """State how many samples were lost."""
    return f'{count} samples were lost on the way'
