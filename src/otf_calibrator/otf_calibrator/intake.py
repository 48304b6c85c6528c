# SPDX-License-Identifier: Apache-2.0
"""Incoming samples and messages: screened, journalled, collected, and resumed after a crash."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from otf_calibrator.collector import Collector, PathTaken
from otf_calibrator.losses import lost_words
from otf_calibrator.parts import PartReception, PartsCollector
from otf_calibrator.publishers import Choice, SequenceWatch
from otf_calibrator.request import Request
from otf_core.bags.bag_signals import MIN_MESSAGES, read_signals, signal_of, topic_of
from otf_core.bags.cdr import DecodedPoints, decode_axes, decode_path
from otf_core.bags.journal import Journal
from otf_core.bags.rosbag2_metadata import AXES, GAP, OTHER_POINT, PATH, POINT, STATUS
from otf_core.bags.sample_order import screen_points
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath, PartsTrack, nominal_track
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.machine import TOOL, Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal

A = TypeVar('A')
RESUMED_WITHIN = 600.0
"""s; a run that was written longer ago is not the running measurement."""
MOST_VALUES = 200_000
"""Values of each signal that are kept."""
BEFORE, AFTER = 1800 * 10**9, 10 * 10**9
"""ns; what was measured so long before and after the samples is theirs: what warms up follows
its temperature with a lag."""


@dataclass(frozen=True)
class Status:
    """What a driver states of its stream: samples published, and the stamp of the last one, ns."""

    name: str
    published: int
    streaming: bool
    finished: bool
    last_ns: int = 0


@dataclass(frozen=True)
class Batch:
    """Samples of one publisher that arrived together.

    Attributes
    ----------
    points : mapping of frame to (stamps, points)
        ndarray of int64, shape (n,), ns, and ndarray, shape (n, 3), m.
    missed : int
        Samples of the same publisher that the transport lost among them.
    """

    points: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
    missed: int = 0


class SignalBuffer:
    """Values of declared signals as they arrive, given out for a run."""

    def __init__(self, specs: Sequence[SignalSpec] = ()) -> None:
        self.specs = tuple(specs)
        self._values: dict[SignalSpec, deque[tuple[int, float]]] = {
            spec: deque(maxlen=MOST_VALUES) for spec in self.specs
        }

    def add(self, spec: SignalSpec, stamp_ns: int, value: float) -> None:
        """Take one value; what is not a number is left out."""
        if math.isfinite(value):
            self._values[spec].append((stamp_ns, value))

    def of(self, samples: Samples) -> dict[SignalSpec, Signal]:
        """Signals around the time of samples, those with enough values."""
        if not len(samples):
            return {}
        first, last = int(samples.stamp_ns.min()) - BEFORE, int(samples.stamp_ns.max()) + AFTER
        near = {
            spec: {s: v for s, v in tuple(own) if first <= s <= last}
            for spec, own in self._values.items()
        }
        return {
            spec: signal_of(spec.wanted, list(own.items()))
            for spec, own in near.items()
            if len(own) >= MIN_MESSAGES
        }


class Intake:
    """Between the topics and the collector.

    Parameters
    ----------
    warn : callable
        Takes messages for the user.
    publishers : callable
        Returns how many publishers of samples the graph knows at this moment.

    Attributes
    ----------
    machine : Machine or None
        As described when the last part arrived, or at the start.
    """

    def __init__(
        self,
        collector: Collector,
        warn: Callable[[str], None],
        publishers: Callable[[], int] = lambda: 1,
    ) -> None:
        self._collector, self._warn = collector, warn
        self.journal: Journal | None = None
        self.signals = SignalBuffer()
        self.machine: Machine | None = None
        self._parts = PartsCollector()
        self._sequence, self._choice = SequenceWatch(publishers), Choice()
        self._apart = 0
        self._gaps: set[bytes] = set()
        self._stamp_ns, self._xyz = np.zeros(0, np.int64), np.zeros((0, 3))  # in no run yet
        self._size = np.zeros(0, np.int64)  # of the run with each of them
        self._at = self._held_at = 0

    def take_path(self, path: NominalPath, message: bytes) -> PathTaken:
        """Use a path; its message goes to the journal if it is that of the run."""
        fate = self._collector.set_path(path, message)
        if fate == PathTaken.USED and self.journal:
            self.journal.message(PATH, message)
        return fate

    def take_part(
        self, part: AxisPath, machine: Machine, message: bytes, stamp_ns: int
    ) -> PartReception:
        """Use a part of a run of a machine with rotary axes.

        Raises
        ------
        InputError
            If the part is not of this machine.
        """
        part.of(machine)
        collector, now = self._collector, time.monotonic()
        self.machine = machine
        heard = self._parts.take(part, message, stamp_ns, now, collector.driving)
        if heard in (PartReception.ADDED, PartReception.NEW):
            self._use_parts(further=heard == PartReception.ADDED)
        return heard

    def _use_parts(self, *, further: bool) -> None:
        """Use the parts of the plan for the run."""
        self._collector.set_parts(self._track(), further=further)
        if self.journal:
            self.journal.message(AXES, *self._parts.plan.messages)

    def _track(self) -> PartsTrack:
        """Track of the parts of the plan."""
        assert self.machine is not None, 'of which the parts are'
        return nominal_track(self.machine, self._parts.plan.parts)

    def follow_the_other_path(self) -> None:
        """Begin a run with the samples since another path was published: they follow that one."""
        self._write_known()
        if self.journal and not (self._collector.other and self._collector.other.since):
            self.journal.end(
                'set aside: its samples belong to the next run, with the path that was driven'
            )
        rest = self._collector.follow_the_other()
        self._warn('the target follows the other path; its samples form a run along that path')
        if self.journal:
            self.journal.message(PATH, self._collector.path_message)
        self._take_again(rest)

    def _take_again(self, samples: Samples) -> None:
        """Count and journal the first samples of a run that follows one set aside."""
        if len(samples):
            self._collector.screening.good(samples.stamp_ns, samples.xyz)
            if self.journal:
                self.journal.points(samples.stamp_ns, samples.xyz, POINT.frame)

    def take_gap(self, stream: str, published: int, message: bytes) -> None:
        """Record a gap of the stream that the driver reports; it repeats it after a restart.

        Parameters
        ----------
        stream : str
            Of a driver that was killed before this one; empty where none was.
        published : int
            Samples that it had published.
        """
        if message in self._gaps:
            return
        self._gaps.add(message)
        if stream:
            self._collector.count_published_before(stream, published)
        if self.journal:
            self.journal.event(GAP, message)

    def separate_publishers(
        self, messages: Sequence[A], numbers: Sequence[int | None]
    ) -> tuple[list[A], int, list[A]]:
        """Separate the samples of the run from those of a second publisher.

        Parameters
        ----------
        messages : sequence
            May be empty: what was held is decided on then.
        numbers : sequence of int or None
            Numbers that the publishers gave them, where the transport tells.

        Returns
        -------
        used : list
        missed : int
            Samples of the same publisher that are missing among them.
        beside : list
            Samples of another publisher.
        """
        publishers = self._sequence.publishers(numbers)
        used, beside = self._choice.take(publishers, messages, time.monotonic())
        return [message for message, _ in used], sum(missed for _, missed in used), beside

    @property
    def waiting(self) -> bool:
        """Whether samples are held of a publisher that may be the successor of the one before."""
        return self._choice.waiting

    def release_held(self) -> list[Any]:
        """Return the samples held; for the end of the node."""
        return self._choice.release_held()

    def keep_apart(self, batch: Batch) -> None:
        """Journal samples of a second publisher apart from the run."""
        for frame, (stamp_ns, xyz) in batch.points.items():
            self._apart += 0 if self._collector.taken else len(stamp_ns)
            if self.journal and self.journal.folder:
                self.journal.points(stamp_ns, xyz, frame, OTHER_POINT)

    def take_status(self, status: Status, message: bytes) -> None:
        """Process a status of the driver."""
        now = time.monotonic()
        self._collector.announce(
            status.name, status.published, status.streaming, status.finished, now, status.last_ns
        )
        if self.journal:
            self.journal.message(STATUS, message)

    def take_signal(self, spec: SignalSpec, stamp_ns: int, value: float, message: bytes) -> None:
        """Record a value of a signal."""
        self.signals.add(spec, stamp_ns, value)
        if self.journal:
            self.journal.message(topic_of(spec), message)

    def take_samples(self, batch: Batch, may_end: bool = True) -> None:
        """Collect samples; those of other frames are only counted.

        Parameters
        ----------
        may_end : bool
            Samples after a standstill are held back until it is known whether the run ends there.
        """
        collector = self._collector
        collector.missed += batch.missed
        for frame, (stamp_ns, xyz) in batch.points.items():
            if frame == POINT.frame:
                self._take(stamp_ns, xyz)
                self._write_known(may_end)
            elif not collector.taken:
                collector.screening.foreign(Counter({frame: len(stamp_ns)}))
                if self.journal:
                    self.journal.points(stamp_ns, xyz, frame)

    def set_aside(self, why: str) -> None:
        """End the run in the journal; the collector calls this before it drops its samples."""
        collector = self._collector
        self._write_known()
        state = 'complete' if collector.taken else f'set aside: {why}'
        folder = self.journal.end(state) if self.journal else None
        self._apart = 0
        if collector.use_newest_path() and self.journal:
            self.journal.message(PATH, collector.path_message)
        if self._parts.use_next_plan():
            collector.path = self._track()
            if self.journal:
                self.journal.message(AXES, *self._parts.plan.messages)
        if not collector.taken:
            place = f'; they are in {folder}' if folder else ''
            self._warn(f'{len(collector.buffer)} samples set aside, {why}{place}')

    def set_aside_until(self, until_ns: int, why: str) -> None:
        """Set samples up to a stamp aside: they belong to the run of another machine."""
        rest = self._collector.set_aside_until(until_ns, why)
        if rest is not None:
            self._take_again(rest)

    def decide(self, may_end: bool = True) -> None:
        """Assign the latest samples to a run if it is known by now to which."""
        self._collector.decide(time.monotonic())
        self._write_known(may_end)

    def end_run(self) -> None:
        """End the run at the standstill that was evaluated; later samples are dropped."""
        self._write_known(may_end=True)
        self._collector.end_run()
        self._stamp_ns, self._xyz, self._size = self._stamp_ns[:0], self._xyz[:0], self._size[:0]
        self._at = self._held_at = 0

    def forget(self) -> str:
        """Drop the run; return where its samples are kept, in words."""
        self._write(self._at)
        folder = self.journal.end('set aside: reset') if self.journal else None
        self._collector.reset()
        self._apart = 0
        if self._parts.use_next_plan():
            self._use_parts(further=False)
        return f' here; they stay in {folder}' if folder else ''

    def settle(self, request: Request, results: Path | None) -> None:
        """Record in the journal that a run was calibrated, unless it continues."""
        if self.journal and request.journal and request.final:
            self.journal.settle(request.journal, f'calibrated: {results or "no files"}')

    def journal_words(self) -> str:
        """State where the samples of the present run are."""
        folder = self.journal.folder if self.journal else None
        return f'; the samples are in {folder}' if folder else ''

    def remarks(self) -> tuple[str, ...]:
        """Remarks on the samples for the reader of a result, except on rejected ones."""
        said = self._collector.restarts.remarks
        if not self._apart:
            return tuple(said)
        place = f' on {OTHER_POINT.name} of the journal' if self.journal else ' not kept'
        return (
            *said,
            f'{self._apart} samples of a second publisher on {POINT.name} are not part of the '
            f'run; they are{place}: end that publisher',
        )

    def troubles(self) -> list[str]:
        """Present problems of samples and journal, in words."""
        said = [self.journal.trouble] if self.journal and self.journal.trouble else []
        collector = self._collector
        if collector.missed:
            said.append(lost_words(collector.missed, collector.restarts.uncounted))
        return [*said, *self.remarks(), *collector.remarks, *collector.screening.remarks()]

    def close(self) -> None:
        """Write all samples received to the journal and close it."""
        self._write(self._at)
        if self.journal:
            self.journal.close()

    def resume_run(
        self, status: Callable[[bytes], Status], gap: Callable[[bytes], tuple[str, int]]
    ) -> str:
        """Continue the run of a calibrator that ended early; return what was found, in words.

        Parameters
        ----------
        status, gap : callable
            Read a message of the driver's status; of a gap, the stream before it and its samples.
        """
        if self.journal is None:
            return ''
        try:
            recorded, others = self.journal.take_up(RESUMED_WITHIN)
        except InputError as error:
            return f'an unfinished run cannot be resumed: {error}'
        said = [f'{p}: a run without a result; otf calibrate reads it' for p in others]
        if recorded:
            journal, self.journal = self.journal, None  # all of it is there already
            wrong = ''
            for part in recorded.parts:
                for topic, content in part:
                    if isinstance(content, DecodedPoints):
                        if content.foreign:
                            self._collector.screening.foreign(content.foreign)
                        self._take(content.stamp_ns, content.xyz)
                        self._write_known()
                    elif topic == PATH:
                        path = NominalPath(decode_path(content, PATH.frame))
                        self._collector.set_path(path, content)
                        journal.message(PATH, content)
                    elif topic == AXES:
                        wrong = wrong or self._restore_part(content)
                        journal.keep(AXES, *self._parts.plan.messages)
                    elif topic == GAP:
                        self.take_gap(*gap(content), content)
                    else:
                        self.take_status(status(content), content)
                self._collector.resume_run()
            self.journal = journal
            watcher, count = self._collector.watcher, len(self._collector.buffer)
            if watcher is not None and watcher.end == count:
                watcher.stays()  # the journal of a run that was over holds no more
            for spec, signal in self._signals_in(recorded.run.folder).items():
                for stamp, value in zip(signal.stamp_ns, signal.value, strict=True):
                    self.signals.add(spec, int(stamp), float(value))
            said.append(f'{recorded.run.folder}: continues with {count} samples of it')
            said += [f'its parts are not of this machine: {wrong}'] if wrong else []
        return '; '.join(said)

    def _restore_part(self, message: bytes) -> str:
        """Restore a part of a resumed run; return what is wrong with it, empty if nothing."""
        frame, names, positions = decode_axes(message)
        part = AxisPath(names, positions, frame or TOOL)
        try:
            assert self.machine is not None, 'known at the start'
            part.of(self.machine)
        except InputError as error:
            return str(error)
        self._parts.restore(part, message, time.monotonic())
        self._collector.set_parts(self._track(), further=True)
        return ''

    def _signals_in(self, folder: Path) -> dict[SignalSpec, Signal]:
        """Signals of a resumed run."""
        signals = read_signals(folder, (), self.signals.specs)
        return {s: signals[s.name] for s in self.signals.specs if s.name in signals}

    def _take(self, stamp_ns: NDArray[np.int64], xyz: NDArray[np.float64]) -> None:
        collector, now, wrong = self._collector, time.monotonic(), screen_points(xyz).tolist()
        rows = zip(stamp_ns.tolist(), xyz.tolist(), wrong, strict=True)
        self._stamp_ns = np.concatenate([self._stamp_ns, stamp_ns])
        self._xyz = np.concatenate([self._xyz, xyz])
        self._size = np.concatenate([self._size, np.zeros(len(stamp_ns), np.int64)])
        for stamp, (x, y, z), bad in rows:
            if not bad:
                collector.add(stamp, x, y, z, now)
                if collector.held == 1:
                    self._held_at = self._at
            self._size[self._at] = len(collector.buffer)
            self._at += 1

    def _write_known(self, may_end: bool = False) -> None:
        """Count and journal the samples of which it is known that they are of the present run."""
        watcher = self._collector.watcher
        known = self._held_at if self._collector.held else self._at
        if may_end and watcher is not None and watcher.end is not None:
            known = min(known, int(np.searchsorted(self._size[: self._at], watcher.end, 'right')))
        self._write(known)

    def _write(self, count: int) -> None:
        """Count and journal so many samples as of the present run."""
        stamp_ns, xyz = self._stamp_ns[:count], self._xyz[:count]
        self._stamp_ns, self._xyz = self._stamp_ns[count:], self._xyz[count:]
        self._size = self._size[count:]
        self._at, self._held_at = self._at - count, self._held_at - count
        if self._collector.taken or not count:
            return
        self._collector.screening.good(stamp_ns, xyz)
        if self.journal:
            self.journal.points(stamp_ns, xyz, POINT.frame)


def journal_place(directory: str, output: str, namespace: str) -> Path | None:
    """Where the journal is kept by the parameters; None if there is to be none."""
    if directory == 'none':
        return None
    given = Path(directory).expanduser().absolute() if directory else None
    base = Path(output).expanduser().absolute() / 'journal'
    return given or base.joinpath(*namespace.strip('/').split('/'))
