# SPDX-License-Identifier: Apache-2.0
"""The samples of the present run: where a run begins and ends, and whether all have arrived.

A run begins with the first sample after the stream before it was over, with a new stream of the
driver, with stamps that jump back, or by request. Samples and status come on different topics, so
nothing here depends on which of the two comes first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from otf_core.config import CalibrationConfig
from otf_core.model.observation import SampleBuffer, Samples
from otf_core.model.path import NominalPath
from otf_core.tracking.path_watch import PathWatcher

JUMP_BACK_NS = 1_000_000_000
"""ns; stamps that go back by more belong to another recording."""
LATE = 2.0
"""s; samples that have not arrived so long after the end of their stream are lost."""
MOTION = 0.01
"""m; travelled by less, the target has not been driven yet."""


@dataclass
class Stream:
    """What is known of one stream of the driver; all zero without any status."""

    name: str = ''
    received: int = 0
    announced: int = 0
    finished: bool = False
    ended: bool = False
    ended_at: float = 0.0

    def over(self, now: float) -> bool:
        """Tell whether no further sample of this stream will come."""
        return self.ended and (self.received >= self.announced or now - self.ended_at > LATE)


class Collector:
    """Buffers samples without loss and tells when a run is complete.

    Parameters
    ----------
    config : callable
        Returns the present parameters of the method.

    Attributes
    ----------
    path : NominalPath or None
    buffer : SampleBuffer
        Samples of the present run.
    taken : bool
        The run has been calibrated; further samples of its stream are ignored.
    run : int
        Changes with every new run and new path.
    """

    def __init__(self, config: Callable[[], CalibrationConfig]) -> None:
        self._config = config
        self.path: NominalPath | None = None
        self.buffer = SampleBuffer()
        self.taken = False
        self.run = 0
        self._lap_taken = False
        self._watcher: PathWatcher | None = None
        self._stream = Stream()
        self._last_ns: int | None = None
        self._heard = 0.0

    @property
    def travelled(self) -> float:
        """Length travelled in this run, m; 0 without a path."""
        return self._watcher.travelled if self._watcher else 0.0

    @property
    def lost(self) -> int:
        """Samples that the driver has announced and that have not arrived."""
        return max(0, self._stream.announced - self._stream.received)

    def set_path(self, path: NominalPath) -> bool:
        """Take a path; samples that came before it are kept. False if it is the present one."""
        if self.path is not None and np.array_equal(path.points, self.path.points):
            return False
        self.path = path
        if self.taken:
            self.reset()
        self._watch()
        return True

    def reset(self) -> None:
        """Forget the samples; a stream that the driver has told of goes on."""
        self.buffer.clear()
        if not self._stream.name:
            self._stream = Stream()
        self.taken = False
        self._watch()

    def add(self, stamp_ns: int, x: float, y: float, z: float, now: float) -> None:
        """Take one sample: stamp in ns, tracker frame in m, time of arrival in s."""
        jump = self._last_ns is not None and stamp_ns < self._last_ns - JUMP_BACK_NS
        if jump or self._stream.over(now):
            self._begin()
        self._last_ns, self._heard = stamp_ns, now
        self._stream.received += 1
        if self.taken:
            return
        self.buffer.append(stamp_ns, x, y, z)
        if self._watcher:
            self._watcher.add(stamp_ns, x, y, z)

    def announce(
        self, name: str, published: int, streaming: bool, finished: bool, now: float
    ) -> None:
        """Take what the driver says about its stream.

        Parameters
        ----------
        name : str
            Differs for every stream; empty before the first.
        published : int
            Samples of the stream published so far.
        streaming, finished : bool
            More will come; all have been published. Neither: the stream was stopped.
        now : float
            s, monotonic.
        """
        if not name:
            return
        if self._stream.name and name != self._stream.name:
            self._begin()
        stream = self._stream
        stream.name, stream.announced, stream.finished = name, published, finished
        if not streaming and not stream.ended:
            stream.ended, stream.ended_at = True, now

    def first_lap(self) -> tuple[Samples, NominalPath] | None:
        """Return the samples so far, and the part of the path they are of, after one lap; once."""
        if self.taken or self.path is None or self._lap_taken:
            return None
        lap = self.path.first_lap
        if self.travelled < lap.length + MOTION:
            return None
        self._lap_taken = True
        return self.buffer.snapshot(), lap

    def end_to_judge(self) -> Samples | None:
        """Return all samples if ``at_end`` should be asked about them now, once a standstill."""
        if self.taken or not self._watcher or not self._watcher.worth_judging():
            return None
        return self.buffer.snapshot()

    def at_end(self, samples: Samples) -> bool:
        """Tell whether the samples end at the end of the path; may take a second."""
        return self._watcher is not None and self._watcher.at_end(samples)

    def complete(self, now: float, at_stream_end: bool, idle_timeout: float) -> str:
        """Say why the run is complete; empty if it is not."""
        if self.taken or self.path is None or not len(self.buffer):
            return ''
        stopped = self._stream.ended and not self._stream.finished
        if at_stream_end and self._stream.finished and self._stream.over(now):
            return 'the stream has ended'
        idle = now - self._heard
        if idle_timeout and idle > idle_timeout and self.travelled > MOTION and not stopped:
            return f'no sample for {idle:.0f} s'
        return ''

    def _begin(self) -> None:
        self._stream, self._last_ns = Stream(), None
        self.reset()

    def _watch(self) -> None:
        self.run += 1
        self._lap_taken = False
        self._watcher = PathWatcher(self.path, self._config()) if self.path else None
        samples = self.buffer.snapshot()
        if self._watcher:
            rows = zip(samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True)
            for stamp_ns, (x, y, z) in rows:
                self._watcher.add(stamp_ns, x, y, z)
