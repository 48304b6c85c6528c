# SPDX-License-Identifier: Apache-2.0
"""The samples of the present run: where a run begins and ends, and whether all have arrived.

A run begins with the first sample after the stream before it was complete, with a new stream of
the driver, with stamps that jump back, when the target moves on after a calibrated run, or by
request. A path that is published while the target drives is that of the next run. A pause does
not end a run while the driver says that its stream goes on, or the path is not nearly driven.
Samples and status come on different topics, so nothing here depends on which of the two comes
first.

The driver states how many samples it has published, and the stamp of the last of them. Samples
arrive in their order: once that one or a later one is there, those before it that are not are
lost, however many more are on their way.

Stamps that jump back begin a run only if the clock before has fallen silent: single wrong stamps
and a second tracker do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from otf_core.bags.sample_order import Clock, Screening
from otf_core.config import CalibrationConfig
from otf_core.model.axis_path import PartsTrack
from otf_core.model.observation import SampleBuffer, Samples
from otf_core.model.path import NominalPath
from otf_core.model.provenance import moment
from otf_core.tracking.path_watch import NEARLY as DRIVEN
from otf_core.tracking.path_watch import PathWatcher

LATE = 2.0
"""s; samples that have not arrived so long after the end of their stream are lost."""
LOOKED_AT = 500
"""Last samples before a restart whose rate counts."""
SILENT = 0.5
"""s; trackers that stream at once take turns faster: a clock so long unheard has stopped."""
SAME_RUN = 600.0
"""s; a driver that was started again after so long a silence does not go on with the run."""
ALIVE = 2.0
"""s; a driver repeats its status faster: one that is silent for longer has a successor."""
MOTION = 0.01
"""m; travelled by less, the target has not been driven yet."""
MOVED = 5
"""Samples in a row that far from where a calibrated run ended: the target moves on."""
NEARLY = 0.9
"""Share of the path that has to be travelled before silence can end a run; from ``DRIVEN`` on it
does so whatever the driver says."""
BEGUN = 0.05
"""The same before the state speaks of the next run instead of the last result."""


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


class Collector:
    """Buffers the samples of a run without loss and decides when the run is complete.

    Parameters
    ----------
    config : callable
        Returns the present parameters of the method.
    set_aside : callable, optional
        Called with the reason before samples that do not belong to the new run are dropped.

    Attributes
    ----------
    path : NominalPath or None
        Of a machine with rotary axes the track of all parts.
    buffer : SampleBuffer
        Samples of the present run.
    screening : Screening
        Samples that were rejected, by reason.
    remarks : list of str
        What the reader of the result has to know of the run.
    taken : bool
        The run has been calibrated; while the target stands, further samples are ignored.
    run : int
        Number of the run; it changes with every new run and every new path.
    publishers : int
        Number of publishers of samples that the graph knows.
    restarts : Restarts
        What the stamps leave out where driver or calibrator were started again.
    watcher : PathWatcher or None
        Progress along the path; None without a path.
    """

    def __init__(
        self,
        config: Callable[[], CalibrationConfig],
        set_aside: Callable[[str], None] = lambda why: None,
    ) -> None:
        self._config, self._set_aside = config, set_aside
        self.path: NominalPath | None = None
        self.buffer = SampleBuffer()
        self.screening = Screening()
        self.remarks: list[str] = []
        self.taken = False
        self.run = 0
        self.publishers = 1
        self.restarts = Restarts()
        self.watcher: PathWatcher | None = None
        self._stream = Stream()
        self._second = Stream()
        self._lost_before = 0
        self._clock: Clock[tuple[float, float, float]] = Clock(self._off)
        self._held_since = 0.0
        self._heard = 0.0
        self._rest: list[float] | None = None
        self._away = 0
        self._next = False

    @property
    def travelled(self) -> float:
        """Length travelled in this run, m; 0 without a path."""
        return self.watcher.travelled if self.watcher else 0.0

    def resume_run(self) -> None:
        """Continue the run after a restart of the calibrator."""
        self._stream.told = -np.inf
        self._expect_gap()

    def _expect_gap(self) -> None:
        if not self.taken and len(self.buffer):
            self.restarts.expect()

    def count_lost(self, now: float) -> int:
        """Count the samples of the run that are lost, without those that may still arrive."""
        return max(0, self._lost_before + self._stream.lost(now))

    @property
    def published(self) -> int:
        """Samples that the driver has published in its present stream."""
        return self._stream.announced

    @property
    def beginning(self) -> bool:
        """True as long as hardly anything is driven of a run after a calibrated one."""
        length = self.path.length if self.path else 0.0
        return self._next and self.travelled < BEGUN * length

    @property
    def held(self) -> int:
        """Number of the latest samples that are in no run yet; the next samples decide."""
        return len(self._clock.held)

    def undecided(self, now: float) -> bool:
        """Return whether the samples held may still turn out to be another run."""
        return bool(self.held) and now - self._held_since <= SILENT

    @property
    def stream_id(self) -> str:
        """Stream of the samples that arrive, as the driver names it; empty if it does not."""
        return self._stream.name

    @property
    def ended(self) -> bool:
        """True if no sample can be added: the run is calibrated, or the stream has ended."""
        return self.taken or self._stream.ended

    def over(self, now: float) -> bool:
        """Return whether the run can have no further samples."""
        return self.taken or (self._stream.over(now) and not self.undecided(now))

    def stream_over(self, now: float) -> bool:
        """Return whether the driver has finished its stream, and nothing of it is outstanding."""
        return self._stream.finished and self._stream.over(now)

    def goes_on(self, now: float) -> bool:
        """Return whether more samples of the run are to be expected at once."""
        return not self.over(now) and now - self._heard < LATE

    @property
    def driving(self) -> bool:
        """Whether a run is being driven; not yet where the target only moves on after one."""
        return not self.taken and self.travelled > MOTION and not self.beginning

    def set_path(self, path: NominalPath, *, further: bool = False) -> None:
        """Use a path; samples that arrived before the first one are kept.

        Parameters
        ----------
        further : bool
            It continues the one that is known, and the run goes on; otherwise the samples so far
            are set aside.
        """
        if self.path is not None and not further and (self.taken or len(self.buffer)):
            self._next_run('another path was published')
        self.path = path
        self._watch()

    def driven_parts(self) -> tuple[NominalPath, tuple[str, ...]]:
        """Return the path without the parts that were not driven, and a remark on these."""
        path, watcher = self.path, self.watcher
        assert path is not None, 'asked before'
        if not isinstance(path, PartsTrack) or watcher is None:
            return path, ()
        count = len(path.parts)
        if watcher.in_last_part:
            return path, ()
        words = f'{watcher.part} of {count} parts were driven; the others are left out'
        return path.first_parts(watcher.part), (words,)

    def reset(self) -> None:
        """Drop all samples; the stream of the driver continues."""
        self._clock.drop()
        self._forget()

    def add(self, stamp_ns: int, x: float, y: float, z: float, now: float) -> None:
        """Add one sample: stamp in ns, tracker frame in m, time of arrival in s."""
        if self._stream.ended and not self._stream.outstanding:
            self._begin('the previous stream had ended')
        stream, clock = self._stream, self._clock
        self._heard = stream.heard = now
        stream.received += 1
        self._second.received += 1
        if clock.take(stamp_ns, (x, y, z)):
            stream.count(clock.newest_ns)
            self._keep(stamp_ns, x, y, z)
            return
        if self.held == 1:
            self._held_since = now
        self.decide(now)

    def decide(self, now: float) -> None:
        """Assign the samples held to a new run or to the present one, as soon as that is clear."""
        clock = self._clock
        back, known = clock.off_ns < 0, not self.undecided(now)
        if not self.held or not (clock.persists and known if back else clock.persists or known):
            return
        if back:
            self._begin_held(f'the stamps went back by {-1e-9 * clock.off_ns:.1f} s')
        else:
            self._release()

    def announce(
        self,
        name: str,
        published: int,
        streaming: bool,
        finished: bool,
        now: float,
        last_ns: int = 0,
    ) -> None:
        """Process the status of the stream as the driver reports it.

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
        last_ns : int
            Stamp of the last sample published, ns; 0 if the driver does not state it.
        """
        if not name or not self._is_of_the_run(name, published, now):
            return
        stream = self._stream
        stream.name, stream.finished, stream.told = name, finished, now
        stream.announce(published, last_ns)
        stream.count(self._clock.newest_ns)
        if streaming:
            stream.ended = False
        elif not stream.ended:
            stream.ended, stream.ended_at = True, now

    def _is_of_the_run(self, name: str, published: int, now: float) -> bool:
        """Whether a status is of the stream of the run; another one may succeed it.

        That of a second driver does not while the first one repeats its own.
        """
        stream = self._stream
        if stream.name in ('', name):
            self._second = Stream()
            return True
        if stream.ended:
            begin = self._begin_held if self._clock.persists else self._begin
            begin('the driver has begun another stream')
            return True
        if self._second.name != name:  # what arrives from now on may be of it
            self._second = Stream(name, before=published)
            self._expect_gap()
        if now - stream.told < ALIVE:
            return False
        if now - self._heard > SAME_RUN:
            self._begin('the driver was started again much later')
            return True
        stream.received -= self._second.received
        self._lost_before += stream.outstanding
        self._stream, self._second = self._second, Stream()
        return True

    def take_end_to_judge(self) -> Samples | None:
        """Return the samples of a run that may be over, once per standstill; otherwise None."""
        if self.taken or not self.watcher or not self.watcher.worth_judging:
            return None
        self.watcher.judge()
        return self.buffer.snapshot(stop=self.watcher.end)

    def end_run(self) -> None:
        """End the run at the standstill that was evaluated; later samples are dropped."""
        assert self.watcher is not None and self.watcher.end is not None, 'looked at'
        self.buffer.cut(self.watcher.end)

    def reason_to_end(self, now: float, at_stream_end: bool, idle_timeout: float) -> str:
        """Return why the run is complete, in words; empty if it is not."""
        if self.taken or self.path is None or not len(self.buffer) or self.undecided(now):
            return ''
        if at_stream_end and self.stream_over(now):
            return 'the stream has ended'
        idle = now - self._heard
        stream = self._stream
        goes_on = stream.name and not stream.ended and self.publishers
        stopped = stream.ended and not stream.finished
        driven = self.watcher.share if self.watcher else 0.0
        over = driven >= DRIVEN
        if not goes_on and not stopped:
            over |= self.travelled > MOTION and driven > NEARLY
        if idle_timeout and idle > idle_timeout and over:
            return f'no sample for {idle:.0f} s'
        return ''

    def silence(self, now: float) -> float:
        """Seconds since the last sample."""
        return now - self._heard

    def _keep(self, stamp_ns: int, x: float, y: float, z: float) -> None:
        if self.taken and not self._stream.ended and self._moved_on(x, y, z):
            self._next_run('the target moves on')
            self._next = True
        if self.taken:
            return
        if len(self.buffer):
            self.restarts.sample(stamp_ns, self.buffer)
        self.buffer.append(stamp_ns, x, y, z)
        if self.watcher:
            self.watcher.add(stamp_ns, x, y, z)

    def _off(self, stamps_ns: list[int], newest_ns: int) -> None:
        if not self.taken:
            self.screening.off(stamps_ns, newest_ns)

    def _moved_on(self, x: float, y: float, z: float) -> bool:
        if self._rest is None:
            self._rest = self.buffer.snapshot(len(self.buffer) - 1).xyz[0].tolist()
        a, b, c = self._rest
        far = (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 > MOTION * MOTION
        self._away = self._away + 1 if far else 0
        return self._away >= MOVED

    def _begin(self, why: str) -> None:
        """Begin a run with another stream."""
        self._next_run(why)
        self._stream, self._lost_before = Stream(), 0
        self._clock.newest_ns = None

    def _begin_held(self, why: str) -> None:
        """Begin a run with what is held, which is of a stream that may not have been told of."""
        self._set_run_aside(why)
        if self._stream.ended or not self._stream.name:
            self._stream, self._lost_before = Stream(received=self.held), 0
        self._release()

    def _release(self) -> None:
        for stamp_ns, point in self._clock.release():
            if not self.taken:
                self._keep(stamp_ns, *point)

    def _next_run(self, why: str) -> None:
        self._clock.drop()
        self._set_run_aside(why)

    def _set_run_aside(self, why: str) -> None:
        count, lost = len(self.buffer), self.driving
        if count:
            self._set_aside(why)
        self._forget()
        if lost:
            self.remarks.append(f'the {count} samples before this run were set aside: {why}')

    def _forget(self) -> None:
        self.buffer.clear()
        self.screening, self.remarks, self.restarts = Screening(), [], Restarts()
        if not self._stream.name:
            self._stream = Stream()
        self._lost_before = -self._stream.gone
        self.taken = self._next = False
        self._rest, self._away = None, 0
        self._watch()

    def _watch(self) -> None:
        self.run += 1
        self.watcher = PathWatcher(self.path, self._config()) if self.path else None
        if self.watcher is None:
            return
        samples = self.buffer.snapshot()
        for stamp_ns, (x, y, z) in zip(
            samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True
        ):
            self.watcher.add(stamp_ns, x, y, z)
