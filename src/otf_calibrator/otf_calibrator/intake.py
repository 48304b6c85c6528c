# SPDX-License-Identifier: Apache-2.0
"""Incoming samples and messages: screened, journalled, collected, and resumed after a crash."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from otf_calibrator.plans import Item, Plans, Reception
from otf_calibrator.run import Collector, lost_words
from otf_calibrator.worker import Request
from otf_core.bags.bag_signals import MIN_MESSAGES, read_signals, signal_of, topic_of
from otf_core.bags.cdr import DecodedPoints, decode_axes, decode_path
from otf_core.bags.journal import Journal
from otf_core.bags.rosbag2_metadata import AXES, GAP, PATH, POINT, STATUS, Topic
from otf_core.bags.sample_order import screen_points
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import TOOL, Machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.sections import SignalSpec
from otf_core.model.signals import Signal

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


Batch = Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
"""Samples that arrived together by frame: stamps, shape (n,), ns, and points, shape (n, 3), m."""


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

    Attributes
    ----------
    machine : Machine or None
        As described when the last path or part arrived, or at the start.
    """

    def __init__(self, collector: Collector, warn: Callable[[str], None]) -> None:
        self._collector, self._warn = collector, warn
        self.journal: Journal | None = None
        self.signals = SignalBuffer()
        self.machine: Machine | None = None
        self._plans = Plans()
        self._left_out, self._second = 0, ''
        self._gaps: set[bytes] = set()
        self._stamp_ns, self._xyz = np.zeros(0, np.int64), np.zeros((0, 3))  # in no run yet
        self._size = np.zeros(0, np.int64)  # of the run with each of them
        self._at = self._held_at = 0

    def take_path(self, item: Item, message: bytes, stamp_ns: int = 0) -> Reception:
        """Use a path, or a part of a run of a machine with rotary axes.

        Raises
        ------
        InputError
            If a part is not of this machine.
        """
        if isinstance(item, AxisPath):
            assert self.machine is not None, 'known at the start'
            item.of(self.machine)
        now, driving = time.monotonic(), self._collector.driving
        heard = self._plans.take(item, message, stamp_ns, now, driving)
        if heard in (Reception.ADDED, Reception.NEW):
            self._collector.set_path(self._track(), further=heard == Reception.ADDED)
            self._journal_plan()
        return heard

    def _journal_plan(self) -> None:
        if self.journal:
            self.journal.message(self._plans.plan.topic, *self._plans.plan.messages)

    def _track(self) -> NominalPath:
        return self._plans.plan.track(cast('Machine', self.machine))  # asked of parts alone

    def take_gap(self, message: bytes) -> None:
        """Journal a gap of the stream that the driver reports; it repeats it after a restart."""
        if self.journal and message not in self._gaps:
            self._gaps.add(message)
            self.journal.event(GAP, message)

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
        for frame, (stamp_ns, xyz) in batch.items():
            if frame == POINT.frame:
                self._take(stamp_ns, xyz)
                self._write_known(may_end)
            elif not collector.taken:
                collector.screening.foreign(Counter({frame: len(stamp_ns)}))
                if self.journal:
                    self.journal.points(stamp_ns, xyz, frame)

    def leave_out(self, count: int, sender: str) -> None:
        """Count samples of a second publisher, with the name of its node."""
        self._left_out += 0 if self._collector.taken else count
        self._second = sender

    def set_aside(self, why: str) -> None:
        """End the run in the journal; the collector calls this before it drops its samples."""
        collector = self._collector
        self._write_known()
        state = 'complete' if collector.taken else f'set aside: {why}'
        folder = self.journal.end(state) if self.journal else None
        self._prepare_next()
        if not collector.taken:
            place = f'; they are in {folder}' if folder else ''
            self._warn(f'{len(collector.buffer)} samples set aside, {why}{place}')

    def _prepare_next(self) -> None:
        """Use the plan that was published during the run, if one was."""
        self._left_out = 0
        if self._plans.use_next():
            self._collector.path = self._track()
            self._journal_plan()

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
        self._prepare_next()
        self._collector.reset()
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
        said = (*self._collector.remarks, *self._collector.restarts.remarks)
        if not self._left_out:
            return said
        return (
            *said,
            f'{self._left_out} samples of a second publisher on {POINT.name}, {self._second}, are '
            f'left out; end it',
        )

    def troubles(self) -> list[str]:
        """Present problems of samples and journal, in words."""
        said = [self.journal.trouble] if self.journal and self.journal.trouble else []
        if lost := self._collector.count_lost(time.monotonic()):
            said.append(lost_words(lost))
        return [*said, *self.remarks(), *self._collector.screening.remarks()]

    def close(self) -> None:
        """Write all samples received to the journal and close it."""
        self._write(self._at)
        if self.journal:
            self.journal.close()

    def resume_run(self, status: Callable[[bytes], Status]) -> str:
        """Continue the run of a calibrator that ended early; return what was found, in words.

        Parameters
        ----------
        status : callable
            Reads a message of the driver's status.
        """
        if self.journal is None:
            return ''
        try:
            recorded, others = self.journal.take_up(RESUMED_WITHIN)
        except InputError as error:
            self._collector.remarks.append(f'an unfinished run is not continued: {error}')
            return self._collector.remarks[-1]
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
                    elif topic in (PATH, AXES):
                        wrong = wrong or self._restore(topic, content)
                        journal.keep(topic, *self._plans.plan.messages)
                    elif topic == GAP:
                        self._gaps.add(content)
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

    def _restore(self, topic: Topic, message: bytes) -> str:
        """Restore a path or part of a resumed run; return what is wrong with it, if anything."""
        item: Item
        if topic == PATH:
            item = NominalPath(decode_path(message, PATH.frame))
        else:
            frame, names, positions = decode_axes(message)
            item = AxisPath(names, positions, frame or TOOL)
            try:
                item.of(cast('Machine', self.machine))
            except InputError as error:
                return str(error)
        self._plans.restore(item, message, time.monotonic())
        self._collector.set_path(self._track(), further=topic == AXES)
        return ''

    def _signals_in(self, folder: Path) -> dict[SignalSpec, Signal]:
        """Signals of a resumed run."""
        signals = read_signals(folder, self.signals.specs)
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
