# SPDX-License-Identifier: Apache-2.0
"""Samples that are known beforehand, handed out as fast as they were measured (or faster)."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from otf_core.config import Parameters
from otf_core.model.observation import Samples
from otf_tracker_driver.backends.base import (
    NO_SAMPLES,
    Backend,
    Beam,
    CommonConfig,
    Flow,
    Gap,
    Health,
    Hindrance,
)

BROKEN = 1.9
"""s; so long a beam is broken where a reflector is moved by hand; shorter gaps are losses."""
_LONGEST_STEP = 0.1
"""s; after a longer pause of the process the stream goes on late instead of in one burst."""
_LOOKS, _BETWEEN_LOOKS = 10, 0.5
"""Of them, so many s apart, the oldest and the newest give the pace."""


class PacedBackend(Backend):
    """Base of backends that hold the whole stream in memory.

    They publish no faster than the calibrators take: nothing is lost on a slow computer, the
    stream takes longer.

    Parameters
    ----------
    clock : callable, optional
        Monotonic seconds.

    Attributes
    ----------
    time_scale : float
        So many times as fast as they were measured the samples come, at most.
    of_now : bool
        True if the stamps are moved, all by the same, so that they are those of now: the first
        sample is stamped with the moment of its start, or, if samples come faster than they were
        measured, the last one with the moment at which it comes. No stamp is of the future.
    """

    of_now: ClassVar[bool] = False

    def __init__(
        self,
        common: CommonConfig,
        own: Parameters,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(common, own)
        self._clock = clock
        self._samples, self._due = NO_SAMPLES, np.empty(0)
        self._next, self._elapsed, self._last = 0, 0.0, 0.0
        self.time_scale = common.time_scale
        self.remark = f'at most {self.time_scale:.3g} times as fast as measured'
        self._breaks = np.empty(0, np.int64)
        self._begun = 0.0
        self._looks = deque([(0.0, 0.0)], _LOOKS)

    def load(self, samples: Samples) -> None:
        """Take the samples of the whole stream."""
        self._samples, self.expected = samples, len(samples)
        self._due = samples.time
        span = float(self._due[-1]) if len(samples) > 1 else 0.0
        self.rate = (len(samples) - 1) / span if span > 0 else 0.0
        self._next = 0
        self._breaks = np.flatnonzero(np.diff(self._due) >= BROKEN) + 1

    @property
    def _broken(self) -> int | None:
        """Number of the break that there is now; None outside of one."""
        at = int(np.searchsorted(self._breaks, self._next))
        return at if at < len(self._breaks) and self._breaks[at] == self._next else None

    def moved(self, number: int) -> str:
        """Say what happens in a break of the beam."""
        return f'the beam was broken here for {self._broken_for(number):.1f} s'

    def _broken_for(self, number: int) -> float:
        at = self._breaks[number]
        return float(self._due[at] - self._due[at - 1])

    @property
    def hindrance(self) -> Hindrance | None:
        """A broken beam."""
        number = self._broken
        if number is None:
            return None
        since = (self._elapsed - float(self._due[self._next - 1])) / self.time_scale
        return Hindrance(Flow.BEAM_BROKEN, self.moved(number), self._clock() - since)

    @property
    def trouble(self) -> str:
        """None: a break of the beam is part of what was measured."""
        return ''

    @property
    def health(self) -> Health:
        """Beam, and the breaks that are over."""
        over = int(np.searchsorted(self._breaks, self._next))
        stamp_ns = self._samples.stamp_ns
        gaps = [
            Gap(int(stamp_ns[at - 1]), int(stamp_ns[at]), self.moved(k))
            for k, at in enumerate(self._breaks[:over].tolist())
        ]
        beam = Beam.ON_TARGET if self._broken is None else Beam.LOST
        return Health(beam=beam, interruptions=over, gaps=tuple(gaps))

    def start(self) -> None:
        """Start from the first sample, which is due at once."""
        self._next, self._elapsed, self._last = 0, 0.0, self._clock()
        self._begun = self._last
        self._looks.clear()
        self._looks.append((self._last, 0.0))
        if self.of_now and len(self._samples):
            stamp_ns = self._samples.stamp_ns
            span_ns = int(stamp_ns[-1] - stamp_ns[0])
            ahead_ns = max(0, span_ns - round(span_ns / self.time_scale))
            shift_ns = self.now_ns() - ahead_ns - int(stamp_ns[0])
            self._samples = Samples(stamp_ns + shift_ns, self._samples.xyz)

    def poll(self) -> Samples:
        """Return the samples that have become due, as far as they are allowed."""
        now = self._clock()
        self._elapsed += min(now - self._last, _LONGEST_STEP) * self.time_scale
        self._last = now
        first, due = self._next, int(np.searchsorted(self._due, self._elapsed, side='right'))
        if self.allowed is not None and due > max(first, self.allowed):
            due = max(first, self.allowed)
            self._elapsed = float(self._due[due])  # no flood once it is allowed
        self._next = due
        if now - self._looks[-1][0] >= _BETWEEN_LOOKS:
            self._looks.append((now, self._elapsed))
        return self._samples.part(first, due)

    def count_until(self, stamp_ns: int) -> int:
        """Samples of the stream up to a stamp."""
        return int(np.searchsorted(self._samples.stamp_ns, stamp_ns, side='right'))

    @property
    def real_time_factor(self) -> float:
        """Of the last seconds, or of a stream that is over."""
        if self.finished:
            begun, before, now, elapsed = self._begun, 0.0, self._last, self._elapsed
        else:
            (begun, before), (now, elapsed) = self._looks[0], self._looks[-1]
        return (elapsed - before) / (now - begun) if now > begun else 0.0

    @property
    def pace_words(self) -> str:
        """How fast the stream was, when it is over."""
        return f', {self.real_time_factor:.3g} times as fast as measured'

    @property
    def finished(self) -> bool:
        """True once all samples have been handed out."""
        return self._next >= self.expected

    def disconnect(self) -> None:
        """Free the memory."""
        self.load(NO_SAMPLES)
