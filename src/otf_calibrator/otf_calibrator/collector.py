# SPDX-License-Identifier: Apache-2.0
"""The samples of the present run: where a run begins and ends, and whether all have arrived.

A run begins with the first sample after the stream before it was over, with a new stream of the
driver, with stamps that jump back, with another path, when the target moves on after a calibrated
run, or by request. A path that is published while the target drives begins one only if the target
turns out to follow it (``OtherPath``). A pause does not end it while the driver says that its
stream goes on, or the path is not nearly driven. Samples and status come on different topics, so
nothing here depends on which of the two comes first.

Stamps that jump back begin a run only if the clock before has fallen silent: single wrong stamps
and a second tracker do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from otf_calibrator.losses import LATE, Restarts, Stream
from otf_core.bags.sample_order import Clock, Screening
from otf_core.calibration.first_sight import TwoPaths, first_legs
from otf_core.config import CalibrationConfig
from otf_core.model.axis_path import PartsTrack
from otf_core.model.observation import SampleBuffer, Samples
from otf_core.model.path import NominalPath
from otf_core.rotary.run_progress import PartsWatcher, watcher_of
from otf_core.tracking.path_watch import NEARLY as DRIVEN
from otf_core.tracking.path_watch import PathWatcher

SILENT = 0.5
"""s; trackers that stream at once take turns faster: a clock so long unheard has stopped."""
SAME_RUN_NS = 600_000_000_000
"""ns; a driver that was started again so much later does not go on with the run."""
STRAY = 10.0
"""s; what a second driver states of its stream counts once the first is silent for so long."""
UNDER_WAY = 0.1
"""s; what was published before a request has arrived so long after it."""
MOTION = 0.01
"""m; travelled by less, the target has not been driven yet."""
MOVED = 5
"""Samples in a row that far from where a calibrated run ended: the target moves on."""
NEARLY = 0.9
"""Share of the path that has to be travelled before silence can end a run; from ``DRIVEN`` on it
does so whatever the driver says."""
BEGUN = 0.05
"""The same before the state speaks of the next run instead of the last result."""
SAME_PATH = 1e-6
"""m; paths that differ by less are the same."""
COMPARED_EVERY = 0.05
"""Share of the path that is driven between two comparisons."""


@dataclass
class OtherPath:
    """A path that the target may turn out to follow.

    Parameters
    ----------
    newer : bool
        It was published after that of the run: it is the one of the next run.
    since : int
        Samples of the run that had come before it.
    message : bytes
        In which it came.
    """

    path: NominalPath
    config: CalibrationConfig
    newer: bool
    since: int = 0
    message: bytes = b''
    watcher: PathWatcher = field(init=False)
    _compared_at: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Begin to follow the target."""
        self.watcher = PathWatcher(self.path, self.config)

    def comparison_due(self, at_the_end: bool) -> bool:
        """Return whether the samples should be compared with both paths.

        That is so again after ``COMPARED_EVERY`` of the path.

        Parameters
        ----------
        at_the_end : bool
            The run is about to be calibrated.
        """
        travelled = self.watcher.travelled
        more = travelled - self._compared_at
        if travelled < first_legs(self.path) or not more:
            return False
        return at_the_end or not self._compared_at or more > COMPARED_EVERY * self.path.length

    def mark_compared(self) -> None:
        """Record that they have been compared."""
        self._compared_at = self.watcher.travelled


class PathTaken(Enum):
    """What becomes of a path that arrives."""

    KNOWN = 'it is known already'
    USED = 'from now on the samples are compared with it'
    WAITS = (
        'the run continues along the previous path unless the target turns out to follow this one'
    )


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
    path_message : bytes
        The path as it was received.
    other : OtherPath or None
        Another path, which the target may turn out to follow.
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
    missed : int
        Samples of the run that the transport lost by its own count.
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
        self.path_message = b''
        self.other: OtherPath | None = None
        self.buffer = SampleBuffer()
        self.screening = Screening()
        self.remarks: list[str] = []
        self.taken = False
        self.run = 0
        self.publishers = 1
        self.missed = 0
        self.restarts = Restarts()
        self._resumed = False
        self._lap_taken, self._parts_taken = False, 0
        self.watcher: PathWatcher | None = None
        self._stream = Stream()
        self._lost_before = 0
        self._left: dict[str, int] = {}
        self._ended: dict[str, int] = {}
        self._counted: set[str] = set()
        self._strays: set[str] = set()
        self._told = 0.0
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

    @property
    def lost(self) -> int:
        """Samples that were published and have not arrived."""
        unsaid = 0 if self._stream.name else self.restarts.samples
        return max(0, self._lost_before + self._stream.lost, self.missed, unsaid)

    def resume_run(self) -> None:
        """Continue the run of a calibrator that ended before it was complete."""
        self._resumed = True
        if len(self.buffer):
            self.restarts.expect()

    def count_surely_lost(self, now: float) -> int:
        """Count the samples that are lost, without those that may still arrive."""
        if self._stream.over(now) or not self._stream.name:
            return self.lost
        return max(0, self._lost_before + (self._stream.missing or 0), self.missed)

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

    def goes_on(self, now: float) -> bool:
        """Return whether more samples of the run are on their way."""
        return not self.taken and not self._stream.ended and now - self._heard < LATE

    def on_the_way(self, now: float, since: float) -> bool:
        """Return whether samples that were measured until ``since`` may still arrive."""
        if self.taken:
            return False
        if self.undecided(now):
            return True
        if self._stream.ended:
            return not self._stream.over(now)
        return self._heard > since - UNDER_WAY and now - since < UNDER_WAY

    def set_path(self, path: NominalPath, message: bytes = b'') -> PathTaken:
        """Use a path; samples that arrived before the first path are kept."""
        before, config = self.path, self._config()
        if before is not None and _same(path, before):
            return PathTaken.KNOWN
        if before is not None and self.driving:
            if self.other is not None and _same(path, self.other.path):
                return PathTaken.KNOWN
            self.other = OtherPath(path, config, True, len(self.buffer), message)
            return PathTaken.WAITS
        if before is not None:
            self.other = OtherPath(before, config, False, message=self.path_message)
            if self.taken or len(self.buffer):
                self._next_run('another path was published')
        self.path, self.path_message = path, message
        self._watch()
        return PathTaken.USED

    def set_parts(self, path: PartsTrack, *, further: bool) -> None:
        """Use the parts of a machine with rotary axes; samples that arrived before are kept.

        Parameters
        ----------
        further : bool
            They continue the parts that are known, and the run goes on; otherwise the samples so
            far are set aside.
        """
        self.other = None
        if self.path is not None and not further and (self.taken or len(self.buffer)):
            self._next_run('other parts were published')
        self.path = path
        self._watch()

    def driven_parts(self) -> tuple[NominalPath, tuple[str, ...]]:
        """Return the path without the parts that were not driven, and a remark on these."""
        path, watcher = self.path, self.watcher
        assert path is not None, 'asked before'
        if not isinstance(path, PartsTrack) or not isinstance(watcher, PartsWatcher):
            return path, ()
        count = len(path.parts)
        if watcher.in_last_part:
            return path, ()
        words = f'{watcher.part} of {count} parts were driven; the others are left out'
        return path.first_parts(watcher.part), (words,)

    @property
    def driving(self) -> bool:
        """Whether a run is being driven."""
        return not self.taken and self.travelled > MOTION

    def paths_to_compare(self, at_the_end: bool) -> TwoPaths | None:
        """Return the samples and both paths if a comparison is due, once; otherwise None."""
        other, path = self.other, self.path
        if path is None or other is None or self.taken or not other.comparison_due(at_the_end):
            return None
        other.mark_compared()
        samples, since = self.buffer.snapshot(), other.watcher.travelled
        return TwoPaths(samples, other.since, path, other.path, self.travelled, since)

    def follow_the_other(self) -> Samples:
        """Begin a run along the other path; return its samples, those since it was published."""
        other = self.other
        assert other is not None, 'asked before'
        rest = self.buffer.snapshot(other.since)
        self.buffer.cut(other.since)
        self._next_run('the target follows the path that was published later' if other.newer
                       else 'the target follows the path that was published before')  # fmt: skip
        self._exchange()
        self._take_again(rest)
        return rest

    def use_newest_path(self) -> bool:
        """Use the newest path for the next run; return whether it is another one."""
        if not self.taken or self.other is None or not self.other.newer:
            return False
        self._exchange()
        return True

    def _exchange(self) -> None:
        """Exchange both paths; the previous one may still be the one that is driven."""
        other, path = self.other, self.path
        assert other is not None and path is not None, 'asked before'
        self.other = OtherPath(path, self._config(), False, message=self.path_message)
        self.path, self.path_message = other.path, other.message

    def set_aside_until(self, until_ns: int, why: str) -> Samples | None:
        """Set samples up to a stamp aside; return the rest, None if there were none."""
        samples = self.buffer.snapshot()
        if self.taken or not len(samples) or samples.stamp_ns[0] > until_ns:
            return None
        rest = samples.part(
            int(np.searchsorted(samples.stamp_ns, until_ns, 'right')), len(samples)
        )
        self._next_run(why)
        self.remarks.clear()  # nothing of this machine's was set aside
        self._take_again(rest)
        return rest

    def _take_again(self, samples: Samples) -> None:
        """Add samples to the new run."""
        rows = zip(samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True)
        for stamp_ns, (x, y, z) in rows:
            self.buffer.append(stamp_ns, x, y, z)
        self._watch()

    def reset(self) -> None:
        """Drop all samples; the stream of the driver continues."""
        self._clock.drop()
        self._forget()

    def add(self, stamp_ns: int, x: float, y: float, z: float, now: float) -> None:
        """Add one sample: stamp in ns, tracker frame in m, time of arrival in s."""
        stream, clock = self._stream, self._clock
        # who is held up gets the last samples late: their stamps go on
        late = clock.newest_ns is not None and 0 < stamp_ns - clock.newest_ns < LATE * 1e9
        if stream.over(now) and (stream.received >= stream.announced or not late):
            self._begin('the previous stream had ended')
            stream = self._stream
        self._heard = stream.heard = now
        stream.arrive(stamp_ns)
        if clock.take(stamp_ns, (x, y, z), *((0,) if stream.taken_over else ())):
            stream.taken_over = False
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
        elif self._stream.taken_over and clock.persists and clock.off_ns > SAME_RUN_NS:
            self._begin_held('the driver was started again much later')
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
        if not name or (name in self._strays and now - self._told < STRAY):
            return
        before, self._told = self._stream, now
        self._strays.discard(name)
        if self._resumed and before.name and name != before.name and not before.ended:
            self.restarts.uncounted = before.name not in self._counted
        self._resumed = False
        if name in self._left:  # the one before goes on: what is lost of which is unknown
            self._lost_before -= self._left.pop(name)
            self._left[before.name] = 0
            self._strays.add(before.name)
            self._stream = Stream(unknown=published)
        elif before.name and name != before.name and before.ended:
            begin = self._begin_held if self._clock.persists else self._begin
            begin('the driver has begun another stream')
        elif before.name and name != before.name:
            # it was started again: the first sample tells whether the run goes on
            self._left[before.name] = before.lost
            self._ended[before.name] = before.unknown + before.received
            self._lost_before += before.lost
            self._stream = Stream(received=self.held, taken_over=True)
            if not self.taken and len(self.buffer):
                self.restarts.expect()
        stream = self._stream
        stream.name, stream.finished = name, finished
        stream.announce(published, last_ns)
        if streaming:
            stream.ended = False
        elif not stream.ended:
            stream.ended, stream.ended_at = True, now

    def count_published_before(self, name: str, published: int) -> None:
        """Count what a driver that was killed had published, as its successor reports it.

        Parameters
        ----------
        name : str
            Of that stream.
        published : int
            Samples that it had published.
        """
        if name == self._stream.name:
            self._stream.announced = max(self._stream.announced, published)
            self._counted.add(name)
        elif name in self._ended and name in self._left:
            lost = max(0, published - self._ended[name])
            self._lost_before += lost - self._left[name]
            self._left[name] = lost
            self.restarts.uncounted = False
        elif self.restarts.uncounted and name not in self._counted:
            self._lost_before += published  # nobody here has ever heard of it
            self._counted.add(name)

    def take_first_lap(self) -> tuple[Samples, NominalPath] | None:
        """Return samples and path of the first lap, once it is driven and only once.

        Of a run of several parts: those so far, after each part but the last.
        """
        if self.taken or self.path is None:
            return None
        if isinstance(self.path, PartsTrack):
            return self._parts_so_far(self.path)
        if self._lap_taken:
            return None
        lap = self.path.first_lap
        if self.travelled < lap.length + MOTION:
            return None
        self._lap_taken = True
        return self.buffer.snapshot(), lap

    def _parts_so_far(self, path: PartsTrack) -> tuple[Samples, NominalPath] | None:
        assert isinstance(self.watcher, PartsWatcher), 'of such a path'
        finished = len(self.watcher.starts)
        if finished <= self._parts_taken:
            return None
        self._parts_taken = finished
        return self.buffer.snapshot(stop=self.watcher.starts[-1]), path.first_parts(finished)

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
        if at_stream_end and self._stream.finished and self._stream.over(now):
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
        if self.taken and self._moved_on(x, y, z):
            self._next_run('the target moves on')
            self._next = True
        if self.taken:
            return
        if len(self.buffer):
            self.restarts.sample(stamp_ns, self.buffer)
        self.buffer.append(stamp_ns, x, y, z)
        if self.watcher:
            self.watcher.add(stamp_ns, x, y, z)
        if self.other:
            self.other.watcher.add(stamp_ns, x, y, z)

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
        self._stream, self._lost_before, self._left = Stream(), 0, {}
        self._clock.newest_ns = None

    def _begin_held(self, why: str) -> None:
        """Begin a run with what is held; of the stream taken over, or of one not told of yet."""
        stream = self._stream
        self._set_run_aside(why)
        self._lost_before = 0
        if not stream.taken_over:
            self._left[stream.name] = 0
            self._stream = Stream(received=self.held)
        self._release()

    def _release(self) -> None:
        self._stream.taken_over = False
        for stamp_ns, point in self._clock.release():
            if not self.taken:
                self._keep(stamp_ns, *point)

    def _next_run(self, why: str) -> None:
        self._clock.drop()
        self._set_run_aside(why)

    def _set_run_aside(self, why: str) -> None:
        count, lost = len(self.buffer), not self.taken and self.travelled > MOTION
        if count:
            self._set_aside(why)
        self._forget()
        if lost:
            self.remarks.append(f'the {count} samples before this run were set aside: {why}')

    def _forget(self) -> None:
        self.buffer.clear()
        self.screening, self.remarks, self.missed = Screening(), [], 0
        self.restarts = Restarts()
        if not self._stream.name:
            self._stream = Stream()
        stream = self._stream
        self._lost_before = -(stream.lost if stream.missing is None else stream.missing)
        self._left = dict.fromkeys(self._left, 0)
        self.taken = self._next = False
        self._rest, self._away = None, 0
        self._watch()

    def _watch(self) -> None:
        self.run += 1
        self._lap_taken, self._parts_taken = False, 0
        self.watcher = watcher_of(self.path, self._config()) if self.path else None
        watchers = [self.watcher] if self.watcher else []
        if self.other:
            other = self.other
            self.other = OtherPath(other.path, self._config(), other.newer, 0, other.message)
            watchers.append(self.other.watcher)
        samples = self.buffer.snapshot()
        for stamp_ns, (x, y, z) in zip(
            samples.stamp_ns.tolist(), samples.xyz.tolist(), strict=True
        ):
            for watcher in watchers:
                watcher.add(stamp_ns, x, y, z)


def _same(a: NominalPath, b: NominalPath) -> bool:
    shape = a.points.shape == b.points.shape
    return shape and bool(np.max(np.abs(a.points - b.points)) < SAME_PATH)
