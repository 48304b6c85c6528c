# SPDX-License-Identifier: Apache-2.0
"""Journal: what arrives is written to disk at once, a bag per run, by a thread of its own."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import DecodedPoints, decode_points, encode_points
from otf_core.bags.mcap_messages import MAGIC, MessageBlock, record_starts
from otf_core.bags.rosbag2_metadata import (
    AXES,
    GAP,
    PATH,
    POINT,
    STATUS,
    Part,
    Topic,
    bag_metadata,
    describe_topics,
    metadata_text,
    start_mcap,
)
from otf_core.errors import ConfigError, InputError
from otf_core.files.output_folder import file_digest
from otf_core.files.strict_yaml import read_yaml

# One MCAP file that grows chunk by chunk and is a whole file after every one of them.
#
# Behind the last chunk stand an end of the data section and a footer without a summary, which the
# next chunk overwrites; so any reader takes the file at any moment, and one that is torn while it
# is written is read to the chunk before. Only when the file is closed its summary is written.


@dataclass(frozen=True)
class Rows:
    """Serialized messages of one topic, of one length in bytes, received at one time, ns."""

    topic: Topic
    data: bytes
    width: int
    log_time: int


def _end_of_file() -> bytes:
    builder = RecordBuilder()
    DataEnd(data_section_crc=0).write(builder)
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    return bytes(builder.end()) + MAGIC  # type: ignore[no-untyped-call]


END = _end_of_file()


def repair(path: Path) -> None:
    """Make a file whole that a crash has torn, up to its last complete chunk; OSError if not."""
    data = np.fromfile(path, np.uint8)
    if bytes(data[-len(MAGIC) :]) == MAGIC:
        return
    starts = record_starts(data, len(MAGIC))
    kept = np.isin(data[starts[:-1]], (Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX))
    end = int(starts[np.append(kept, False).argmin()])
    if end <= len(MAGIC):
        return
    with path.open('r+b') as file:
        file.truncate(end)
        file.seek(end)
        file.write(END)
        file.flush()
        os.fsync(file.fileno())


class _Unwritten(BytesIO):
    """What the writer has made and the disk has not taken yet; ``start`` is where it belongs."""

    start = 0

    def tell(self) -> int:
        """Return where the next byte of the file belongs."""
        return self.start + super().tell()

    def clear(self) -> None:
        """Let go of what the disk has."""
        self.start = self.tell()
        self.seek(0)
        self.truncate()


class JournalFile:
    """A file that is written by this process alone; every failure is an OSError.

    Parameters
    ----------
    path : Path
        Must not exist.
    definitions : mapping of Topic to str
        Message definitions of all topics that may come.

    Attributes
    ----------
    part : Part
        What the file holds.
    """

    def __init__(self, path: Path, definitions: Mapping[Topic, str]) -> None:
        self._path, self._finished = path, False
        self._unwritten = _Unwritten()
        self._writer, self._channels = start_mcap(self._unwritten, definitions)
        self.part = Part(path.name, 0, 0, {})
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        _sync_folder(path.parent)

    @property
    def size(self) -> int:
        """Bytes on the disk, without the end of the file."""
        return self._unwritten.start

    def add(self, rows: Sequence[Rows]) -> None:
        """Take a chunk, which ``write`` writes."""
        counts = Counter(self.part.counts)
        for r in rows:
            for at in range(0, len(r.data), r.width):
                message = r.data[at : at + r.width]
                self._writer.add_message(
                    self._channels[r.topic], r.log_time, message, r.log_time, counts.total()
                )
                counts[r.topic] += 1
        start, end = min(r.log_time for r in rows), max(r.log_time for r in rows)
        first = self.part.start if self.part.counts else start
        self.part = Part(self._path.name, first, max(end, self.part.end), counts)
        self._writer.flush()  # type: ignore[no-untyped-call]

    def write(self, end: bytes = END) -> None:
        """Write what was taken; it is on the disk when this returns, and the file is whole.

        After an OSError the file is as before, or cut off behind its last chunk; what was taken is
        kept, and this may be tried again.
        """
        if self._gone():
            self._restore()
        try:
            _write_all(self._file, self._unwritten.getvalue() + end, self.size)
            os.fdatasync(self._file)
        except OSError:
            with suppress(OSError):  # where the end stood before there is room for it again
                _write_all(self._file, END, self.size)
                os.ftruncate(self._file, self.size + len(END))
            raise
        self._unwritten.clear()

    def close(self) -> None:
        """Write the summary and let go of the file; after an OSError it may be tried again."""
        if not self._finished:
            self._writer.finish()  # type: ignore[no-untyped-call]
        self._finished = True
        self.write(end=b'')
        os.close(self._file)

    def _gone(self) -> bool:
        """Return whether somebody has removed or replaced the file."""
        try:
            return not os.path.samestat(os.stat(self._path), os.fstat(self._file))
        except FileNotFoundError:
            return True

    def _restore(self) -> None:
        """Write the file again: what was removed can still be read by who has it open."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(f'/proc/self/fd/{self._file}', self._path)
        os.close(self._file)
        self._file = os.open(self._path, os.O_RDWR | os.O_CLOEXEC)


def _write_all(file: int, data: bytes, at: int) -> None:
    remainder = memoryview(data)
    while remainder:
        written = os.pwrite(file, remainder, at)
        remainder, at = remainder[written:], at + written


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# One run of a journal: a rosbag2 folder that grows, and is taken up again after a crash.
#
# Its state stands in metadata.yaml (``custom_data``): ``recording`` as long as samples may be
# added, then what became of the run. A run that is taken up goes on in a further part.

TOPICS = (PATH, AXES, STATUS, POINT)
"""Of which a run consists, and what it is taken up from."""
RECORDING = 'recording'
"""State of a run to which samples may be added."""
STATE, MACHINE, METADATA = 'otf_state', 'otf_machine_sha256', 'metadata.yaml'
METADATA_PERIOD = 1.0
"""s; metadata.yaml is written anew at most so often while the run is recorded."""


@dataclass(frozen=True)
class Definitions:
    """Message definitions of the topics of a journal; ``texts`` of types that rosbags lacks.

    ``beside`` are further topics than ``TOPICS``.
    """

    texts: Mapping[str, str]
    beside: tuple[Topic, ...] = ()

    @property
    def all(self) -> tuple[Topic, ...]:
        """Topics of a journal."""
        return (*TOPICS, GAP, *self.beside)

    @cached_property
    def both(self) -> tuple[dict[Topic, str], dict[Topic, str]]:
        """Definition and hash of every topic."""
        return describe_topics(self.all, self.texts)


class JournalRun:
    """A run that is written; every failure is an OSError.

    Parameters
    ----------
    folder : Path
        Made with the first rows.
    machine : str
        SHA-256 of the machine description that it is recorded with; empty: not known.
    parts : sequence of Part
        Parts that are there already.
    """

    def __init__(
        self, folder: Path, definitions: Definitions, machine: str, parts: Sequence[Part] = ()
    ) -> None:
        self.folder, self._machine = folder, machine
        self._definitions, self._parts = definitions, list(parts)
        self._file: JournalFile | None = None
        self._updated = 0.0

    def add(self, rows: Sequence[Rows]) -> None:
        """Take a chunk, which ``write`` writes."""
        if self._file is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f'{self.folder.name}_{len(self._parts)}.mcap'
            self._file = JournalFile(path, self._definitions.both[0])
        self._file.add(rows)

    def write(self) -> None:
        """Write what was taken; it is on the disk when this returns."""
        if self._file is None:
            return
        self._file.write()
        since = time.monotonic() - self._updated
        if since > METADATA_PERIOD or not (self.folder / METADATA).exists():
            self._update(RECORDING)

    def close(self, state: str = RECORDING) -> None:
        """End the present part, if there is one, and say what became of the run."""
        if self._file is not None:
            self._file.close()
            self._parts.append(self._file.part)
            self._file = None
        if self._parts:
            self._update(state)

    def _update(self, state: str) -> None:
        present = [self._file.part] if self._file else []
        hashes = self._definitions.both[1]
        about = {STATE: state, MACHINE: self._machine}
        data = bag_metadata([*self._parts, *present], hashes, about)
        _replace_text(self.folder / METADATA, metadata_text(data))
        self._updated = time.monotonic()


def _replace_text(path: Path, text: str) -> None:
    partial = path.with_name(f'.{path.name}.new')
    with partial.open('w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def _about(folder: Path) -> dict[str, str]:
    """What metadata.yaml says of a run of a journal; empty if the folder is none."""
    try:
        return dict(read_yaml(folder / METADATA)['rosbag2_bagfile_information']['custom_data'])
    except (ConfigError, TypeError, KeyError, ValueError):
        return {}


def state_of(folder: Path) -> str:
    """Return the state of a run; empty if the folder is no run of a journal."""
    return str(_about(folder).get(STATE, ''))


def set_state(folder: Path, state: str) -> None:
    """Record what became of a run that is not written any more; OSError if that fails."""
    path = folder / METADATA
    try:
        data = read_yaml(path)
        data['rosbag2_bagfile_information']['custom_data'] = {**_about(folder), STATE: state}
    except (ConfigError, TypeError, KeyError) as error:
        raise OSError(f'{path}: {error}') from None
    _replace_text(path, metadata_text(data['rosbag2_bagfile_information']))


def unfinished_runs(directory: Path) -> list[Path]:
    """Runs that are still to be calibrated, the newest last."""
    runs = [p for p in sorted(directory.iterdir()) if any(p.glob('*_0.mcap'))]
    return [p for p in runs if state_of(p) == RECORDING or not (p / METADATA).exists()]


@dataclass(frozen=True)
class JournalContent:
    """What a run holds, and the run to go on with.

    Attributes
    ----------
    end_ns : int
        When the last message was received.
    parts : tuple of tuple
        Points, and messages of ``TOPICS`` and of gaps as they were received, in their order; each
        part by another process than the one before.
    """

    run: JournalRun
    end_ns: int
    parts: tuple[tuple[tuple[Topic, DecodedPoints | bytes], ...], ...]


def resume_run(folder: Path, definitions: Definitions) -> JournalContent:
    """Read an unfinished run, so that it goes on.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    files = sorted(folder.glob('*.mcap'), key=lambda p: int(p.stem.rpartition('_')[2]))
    try:
        repair(files[-1])
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f'{folder}: cannot be resumed ({error})') from None
    parts: list[Part] = []
    arrived = []
    topics = {t.name: t for t in definitions.all}
    for file in files:
        blocks = list(locate(file).messages({t.name: (t.type,) for t in topics.values()}, {}))
        counts: Counter[Topic] = Counter()
        for block in blocks:
            counts[topics[block.topic]] += block.start.size
        times = [int(t) for b in blocks for t in (b.log_time.min(), b.log_time.max())] or [0]
        parts.append(Part(file.name, min(times), max(times), counts))
        arrived.append(tuple(_in_order(blocks)))
    end = max((part.end for part in parts), default=0)
    machine = _about(folder).get(MACHINE, '')
    return JournalContent(JournalRun(folder, definitions, machine, parts), end, tuple(arrived))


def _in_order(blocks: Sequence[MessageBlock]) -> Iterator[tuple[Topic, DecodedPoints | bytes]]:
    """Yield points and messages of ``TOPICS`` and gaps in the order in which they came."""
    topics = {t.name: t for t in (*TOPICS, GAP)}
    others = deque(
        sorted(
            (time, k, i, data)
            for k, block in enumerate(blocks)
            if block.topic in topics and block.topic != POINT.name
            for i, (time, data) in enumerate(block)
        )
    )
    for block in (b for b in blocks if b.topic == POINT.name):
        cuts, at = np.append(block.log_time, np.iinfo(np.int64).max), 0
        while at < block.start.size:
            cut = int(np.searchsorted(cuts, others[0][0])) if others else block.start.size
            cut = min(max(cut, at), block.start.size)
            if cut > at:
                start, size = block.start[at:cut], block.size[at:cut]
                yield POINT, decode_points(block.buffer, start, size, POINT.frame)
            if cut < block.start.size:
                _, k, _, data = others.popleft()
                yield topics[blocks[k].topic], data
            at = cut
    for _, k, _, data in others:
        yield topics[blocks[k].topic], data


# Journal: what arrives is written to disk at once, a bag per run, by a thread of its own.
#
# A chunk is written and synchronised (fdatasync) every 0.2 s, so a killed process or a power cut
# costs what came since: 0.2 s and the time the disk takes for one chunk. While the disk refuses,
# what has come is kept and tried again; nothing here ever waits for the disk but the thread.

CHUNK_PERIOD = 0.2
"""s; a chunk is written so often."""
MAX_PENDING_BYTES = 1 << 26
"""Bytes kept while the disk refuses; what comes beyond is not journalled, and counted."""
LOCK = '.lock'
KEPT_FREE = 1 << 22
"""Bytes of the disk that the journal leaves free for the results, but no more than half of it."""


@dataclass(frozen=True)
class _End:
    """A run ends with a state; ``run`` is None where it was ended before."""

    folder: Path
    run: JournalRun | None
    state: str


class Journal:
    """Runs below one directory, written one after another.

    Parameters
    ----------
    directory : Path
        Made if it is not there.
    texts : mapping of str to str
        Message definitions of types that are not part of ROS 2 itself.
    beside : sequence of Topic
        Further topics.
    machine_file : Path, optional
        A run that was recorded with another one is not taken up.

    Attributes
    ----------
    trouble : str
        Why what arrives is not on the disk at present; empty if it is.

    Raises
    ------
    ConfigError
        If the directory cannot be written, or another journal is kept there.
    """

    def __init__(
        self,
        directory: Path,
        texts: Mapping[str, str],
        beside: Sequence[Topic] = (),
        machine_file: Path | None = None,
    ) -> None:
        self.directory, self._machine_file = directory, machine_file
        self._lock = _locked(directory)
        self._definitions = Definitions(texts, tuple(beside))
        self._run: JournalRun | None = None
        self._refused: JournalRun | None = None
        self._latched: dict[Topic, tuple[bytes, ...]] = {}
        self._items: list[tuple[JournalRun, Rows] | _End] = []
        self._pending, self._missed = 0, 0
        self._clock = time.time_ns() - time.monotonic_ns()
        self._wake, self._closing = threading.Condition(), False
        self.trouble = ''
        self._thread = threading.Thread(target=self._work, name='journal', daemon=True)
        self._thread.start()

    @property
    def folder(self) -> Path | None:
        """Folder of the present run; None before its first sample."""
        return self._run.folder if self._run else None

    def points(self, stamp_ns: NDArray[np.int64], xyz: NDArray[np.float64], frame: str) -> None:
        """Take points of one frame as they arrived; the first begin a run.

        Parameters
        ----------
        stamp_ns : ndarray of int64, shape (n,), ns
        xyz : ndarray of float64, shape (n, 3), m
        """
        run = self._run or self._begin()
        rows = encode_points(stamp_ns, xyz, frame)
        self._put(run, POINT, rows.tobytes(), rows.dtype.itemsize)

    def message(self, topic: Topic, *data: bytes) -> None:
        """Take serialized messages that stay valid: they are part of every run from now on.

        They take the place of those of the same topic; what these begin with alike is not written
        again.
        """
        before = self._latched.get(topic, ())
        self._latched[topic] = data
        goes_on = len(data) > len(before) and data[: len(before)] == before
        if self._run:
            for one in data[len(before) :] if goes_on else data:
                self._put(self._run, topic, one)

    def keep(self, topic: Topic, *data: bytes) -> None:
        """Take messages as ``message`` does that the present run has already."""
        self._latched[topic] = data

    def event(self, topic: Topic, data: bytes) -> None:
        """Take a serialized message of what has happened: it is part of this run only."""
        if self._run:
            self._put(self._run, topic, data)

    def end(self, state: str) -> Path | None:
        """End the present run, if there is one, and say what became of it; return its folder."""
        run, self._run = self._run, None
        if run is None:
            return None
        self._append(_End(run.folder, run, state))
        return run.folder

    def settle(self, folder: Path, state: str) -> None:
        """Record what became of a run, which ends if it is the present one."""
        if self._run and self._run.folder == folder:
            self.end(state)
        else:
            self._append(_End(folder, None, state))

    def take_up(self, within: float) -> tuple[JournalContent | None, list[Path]]:
        """Go on with the newest unfinished run, if it was written lately.

        Parameters
        ----------
        within : float
            s; longer ago it is not the running measurement.

        Returns
        -------
        left : list of Path
            Other unfinished runs.

        Raises
        ------
        InputError
            If it cannot be read, or was recorded with another machine description, which ends it.
        """
        folders = unfinished_runs(self.directory)
        if not folders:
            return None, []
        newest = max(p.stat().st_mtime for p in folders[-1].iterdir())
        if time.time() - newest > within:
            return None, folders
        before, machine = _about(folders[-1]).get(MACHINE, ''), self._machine()
        if before and machine and before != machine:
            self._append(_End(folders[-1], None, f'set aside: {self._machine_file} has changed'))
            raise InputError(
                f'{folders[-1]}: {self._machine_file} has changed since this run was recorded '
                f'(SHA-256 {before[:8]}..., now {machine[:8]}...); the run stays there: calibrate '
                f'it with the file of that time, ./otf calibrate {folders[-1]} --machine '
                f'MACHINE.yaml --out DIR'
            )
        recorded = resume_run(folders[-1], self._definitions)
        self._run = recorded.run
        self._clock = max(self._clock, recorded.end_ns + 1 - time.monotonic_ns())
        return recorded, folders[:-1]

    def close(self) -> None:
        """Write what has come; a run that has not ended can be taken up."""
        if self._run:
            self.end(RECORDING)
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        os.close(self._lock)

    def _begin(self) -> JournalRun:
        name = f'{datetime.now(timezone.utc):%Y%m%dT%H%M%S.%fZ}'
        self._run = run = JournalRun(self.directory / name, self._definitions, self._machine())
        for topic, messages in self._latched.items():
            for data in messages:
                self._put(run, topic, data)
        return run

    def _machine(self) -> str:
        """SHA-256 of the machine description; empty where there is none."""
        try:
            return file_digest(self._machine_file) if self._machine_file else ''
        except OSError:  # whoever calibrates says so
            return ''

    def _now(self) -> int:
        """Time of arrival, ns: the clock of the system, but never back."""
        return self._clock + time.monotonic_ns()

    def _put(self, run: JournalRun, topic: Topic, data: bytes, width: int = 0) -> None:
        rows = Rows(topic, data, width or len(data), self._now())
        if self._pending > MAX_PENDING_BYTES:
            self._missed += len(data) // rows.width
            return
        self._append((run, rows))

    def _append(self, item: tuple[JournalRun, Rows] | _End) -> None:
        with self._wake:
            self._items.append(item)
            if not isinstance(item, _End):
                self._pending += len(item[1].data)

    def _work(self) -> None:
        waiting: list[tuple[JournalRun, Rows] | _End] = []
        closing = False
        while not closing:
            with self._wake:
                self._wake.wait_for(lambda: self._closing, CHUNK_PERIOD)
                closing, items, self._items = self._closing, self._items, []
            waiting += items
            try:
                self._write(waiting)
                self.trouble = ''
            except OSError as error:
                self.trouble = (
                    f'{self.directory}: the journal cannot be written '
                    f'({error.strerror or error}); the samples are in memory'
                )
            if self._missed:
                self.trouble += f'; {self._missed} messages are not in the journal'

    def _write(self, waiting: list[tuple[JournalRun, Rows] | _End]) -> None:
        """Write what waits, run by run, and take it off the list."""
        if self._refused:
            self._refused.write()
        self._refused = None
        while waiting:
            first = waiting[0]
            if isinstance(first, _End):
                if first.run:
                    first.run.close(first.state)
                else:
                    with suppress(FileNotFoundError):  # removed by somebody
                        set_state(first.folder, first.state)
                del waiting[0]
                continue
            run, rows = first[0], []
            for item in waiting:
                if isinstance(item, _End) or item[0] is not run:
                    break
                rows.append(item[1])
            size = sum(len(r.data) for r in rows)
            self._check_room(size)
            run.add(rows)
            self._refused = run  # what it has taken it writes, now or later
            del waiting[: len(rows)]
            with self._wake:
                self._pending -= size
            run.write()
            self._refused = None

    def _check_room(self, size: int) -> None:
        """OSError if so many bytes more would leave too little of the disk for the results."""
        try:
            disk = os.statvfs(self.directory)
        except FileNotFoundError:  # removed by somebody; made again with the run
            return
        reserve = min(KEPT_FREE, disk.f_blocks * disk.f_frsize // 2)
        if disk.f_bavail * disk.f_frsize - size < reserve:
            raise OSError(
                errno.ENOSPC,
                f'disk full except for {reserve / 1e6:.1f} MB reserved for the results',
            )


def _locked(directory: Path) -> int:
    """Open the lock of a directory; ConfigError if another process holds it."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise ConfigError(
            f'{directory}: the journal cannot be kept there ({error.strerror}); '
            f'correct output_directory or journal_directory'
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(lock, 20, 0).decode(errors='replace').strip()
        os.close(lock)
        raise ConfigError(
            f'{directory}: another calibrator (process {holder or "unknown"}) keeps its journal '
            f'there; give this one another journal_directory or output_directory'
        ) from None
    os.ftruncate(lock, 0)
    os.pwrite(lock, f'{os.getpid()}\n'.encode(), 0)
    return lock
