# SPDX-License-Identifier: Apache-2.0
"""Journal: what arrives is written to disk at once, a bag per run, by a thread of its own."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import threading
import time
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import DecodedPoints, decode_points, encode_points
from otf_core.bags.mcap_messages import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    MessageBlock,
    complete_records,
)
from otf_core.bags.rosbag2_metadata import (
    AXES,
    CREATOR,
    GAP,
    PATH,
    POINT,
    STATUS,
    Part,
    Topic,
    bag_metadata,
    channel_metadata,
    metadata_text,
)
from otf_core.errors import ConfigError, InputError
from otf_core.files.output_folder import file_digest
from otf_core.files.strict_yaml import read_yaml

# One MCAP file that grows chunk by chunk and is a whole file after every one of them.
#
# Behind the last chunk stand an end of the data section and a footer without a summary, which the
# next chunk overwrites; so any reader takes the file at any moment, and one that is torn while it
# is written is read to the chunk before. Only when the file is closed its summary is written.
# Source: mcap.dev/spec; records as mcap 1.6 writes them.


@dataclass(frozen=True)
class Rows:
    """Serialized messages of one topic, one length.

    Attributes
    ----------
    data : ndarray, shape (n,)
        Items of raw bytes, one per message.
    log_time : int
        ns; when they were received.
    """

    topic: Topic
    data: NDArray[np.void]
    log_time: int


def one_message(topic: Topic, data: bytes, log_time: int) -> Rows:
    """Return a single message as rows."""
    return Rows(topic, np.frombuffer(data, f'V{len(data)}'), log_time)


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _tail(*summary: McapRecord, end: int) -> bytes:
    """End of the file behind ``end``: data end, summary if there is one, footer, mark."""
    data_end = _bytes_of(DataEnd(data_section_crc=0))
    start = end + len(data_end) if summary else 0
    footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=0)
    return data_end + _bytes_of(*summary, footer) + MAGIC


def repair(path: Path) -> None:
    """Make a file whole that a crash has torn, up to its last complete chunk.

    Raises
    ------
    OSError, ValueError
        If it cannot be written, or is no such file.
    """
    data = np.fromfile(path, np.uint8)
    starts = complete_records(data, len(MAGIC), data.size)
    opcodes = data[starts[:-1]]
    ends = starts[1:][np.isin(opcodes, [Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE_INDEX])]
    ended = np.flatnonzero(opcodes == Opcode.DATA_END)
    ends = ends[ends <= starts[ended[0]]] if ended.size else ends
    if bytes(data[-len(MAGIC) :]) == MAGIC or not ends.size:
        return
    tail = _tail(end=int(ends[-1]))
    with path.open('r+b') as file:
        file.truncate(int(ends[-1]) + len(tail))
        _write_all(file.fileno(), tail, int(ends[-1]))
        os.fsync(file.fileno())


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
        self._path = path
        self._channel_of = {topic: k for k, topic in enumerate(definitions, start=1)}
        schemas = [
            Schema(k, text.encode(), 'ros2msg', topic.type)
            for (topic, k), text in zip(
                self._channel_of.items(), definitions.values(), strict=True
            )
        ]
        channels = [
            Channel(k, topic.name, 'cdr', channel_metadata(topic), k)
            for topic, k in self._channel_of.items()
        ]
        self._about: list[McapRecord] = [*schemas, *channels]
        self._index: list[ChunkIndex] = []
        self._packer = zstandard.ZstdCompressor(level=1)
        self.part = Part(path.name, 0, 0, {})
        self._sequence = 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._end = 0
        head = MAGIC + _bytes_of(Header('ros2', CREATOR), *self._about)
        self._write(head, _tail(end=len(head)))
        _sync_folder(path.parent)

    def append(self, rows: Sequence[Rows]) -> None:
        """Write a chunk; it is on the disk when this returns, and the file is whole.

        After an OSError the file is as before, or cut off behind its last chunk, and the same
        rows may be given again.
        """
        if self._gone():
            self._restore()
        records, index, starts = self._records(rows)
        start, end = min(r.log_time for r in rows), max(r.log_time for r in rows)
        packed = self._packer.compress(records)
        chunk = _bytes_of(Chunk('zstd', packed, end, start, zlib.crc32(records), len(records)))
        at = self._end
        offsets = {channel: at + len(chunk) + offset for channel, offset in starts.items()}
        self._write(chunk + index, _tail(end=at + len(chunk) + len(index)))
        self._index.append(
            ChunkIndex(
                len(chunk), at, 'zstd', len(packed), end, len(index), offsets, start, len(records)
            )
        )
        counts = Counter(self.part.counts)
        for r in rows:
            counts[r.topic] += len(r.data)
        first = self.part.start if self._sequence else start
        self._sequence += sum(len(r.data) for r in rows)
        self.part = Part(self._path.name, first, max(end, self.part.end), counts)

    def finish(self) -> None:
        """Write the summary; after an OSError it may be tried again."""
        part = self.part
        counts = {self._channel_of[t]: n for t, n in part.counts.items()}
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channel_of),
            channel_message_counts=counts,
            chunk_count=len(self._index),
            message_count=sum(counts.values()),
            message_end_time=part.end,
            message_start_time=part.start,
            metadata_count=0,
            schema_count=len(self._channel_of),
        )
        self._write(b'', _tail(*self._about, statistics, *self._index, end=self._end))

    def release(self) -> None:
        """Let go of the file."""
        os.close(self._file)

    def _records(self, rows: Sequence[Rows]) -> tuple[bytes, bytes, dict[int, int]]:
        """Message records of a chunk, their indexes, and where the index of a channel begins."""
        parts: list[bytes] = []
        entries: dict[int, list[NDArray[np.uint64]]] = {}
        sequence, at = self._sequence, 0
        for r in rows:
            width = MESSAGE_HEAD.itemsize + r.data.itemsize
            head = np.zeros(len(r.data), MESSAGE_HEAD)
            head['opcode'], head['length'] = Opcode.MESSAGE, width - RECORD_HEAD
            head['channel'] = self._channel_of[r.topic]
            head['sequence'] = sequence + np.arange(len(r.data))
            head['log_time'] = head['publish_time'] = r.log_time
            both = np.zeros(len(r.data), [('head', MESSAGE_HEAD), ('data', r.data.dtype)])
            both['head'], both['data'] = head, r.data
            index = np.empty((len(r.data), 2), '<u8')
            index[:, 0], index[:, 1] = r.log_time, at + width * np.arange(len(r.data))
            entries.setdefault(self._channel_of[r.topic], []).append(index)
            parts.append(both.tobytes())
            sequence, at = sequence + len(r.data), at + len(parts[-1])
        indexes, starts = b'', {}
        for channel, listed in entries.items():
            body = b''.join(i.tobytes() for i in listed)
            starts[channel] = len(indexes)
            head_of = struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 6 + len(body), channel, len(body))
            indexes += head_of + body
        return b''.join(parts), indexes, starts

    def _write(self, data: bytes, tail: bytes) -> None:
        """Write behind the last chunk, at once if the system takes it, and wait for the disk."""
        try:
            _write_all(self._file, data + tail, self._end)
            os.fdatasync(self._file)
        except OSError:
            with suppress(OSError):  # where the end stood before there is room for it again
                before = _tail(end=self._end)
                _write_all(self._file, before, self._end)
                os.ftruncate(self._file, self._end + len(before))
            raise
        self._end += len(data)

    def _gone(self) -> bool:
        """Return whether somebody has removed or replaced the file."""
        try:
            return not os.path.samestat(os.stat(self._path), os.fstat(self._file))
        except FileNotFoundError:
            return True

    def _restore(self) -> None:
        """Write the file again: what was removed can still be read by who has it open."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            at = 0
            while block := os.pread(self._file, 1 << 20, at):
                at += os.write(new, block)
        except OSError:
            os.close(new)
            os.unlink(self._path)
            raise
        os.close(self._file)
        self._file = new


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
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in self.texts.items():
            store.register(get_types_from_msg(text, name))
        topics = [t for t in self.all if t.type in store.fielddefs]
        texts = {t: store.generate_msgdef(t.type, ros_version=2)[0] for t in topics}
        return texts, {t: store.hash_rihs01(t.type) for t in topics}


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

    def append(self, rows: Sequence[Rows]) -> None:
        """Write a chunk; it is on the disk when this returns."""
        if self._file is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f'{self.folder.name}_{len(self._parts)}.mcap'
            self._file = JournalFile(path, self._definitions.both[0])
        self._file.append(rows)
        if (
            time.monotonic() - self._updated > METADATA_PERIOD
            or not (self.folder / METADATA).exists()
        ):
            self._update(RECORDING)

    def close(self, state: str = RECORDING) -> None:
        """End the present part, if there is one, and say what became of the run."""
        if self._file is not None:
            self._file.finish()
            self._file.release()
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
    own = {t.name for t in (*TOPICS, GAP)}
    for file in files:
        messages = list(locate(file).messages({t.name: (t.type,) for t in definitions.all}, {}))
        arrived.append(tuple(_in_order([b for b in messages if b.topic in own])))
        if messages:
            times = np.concatenate([b.log_time for b in messages])
            counts: Counter[Topic] = Counter()
            for block in messages:
                counts[_topic(block, definitions.all)] += block.start.size
            parts.append(Part(file.name, int(times.min()), int(times.max()), counts))
        else:
            parts.append(Part(file.name, 0, 0, {}))
    end = max((part.end for part in parts), default=0)
    machine = _about(folder).get(MACHINE, '')
    return JournalContent(JournalRun(folder, definitions, machine, parts), end, tuple(arrived))


def _topic(block: MessageBlock, topics: Sequence[Topic] = (*TOPICS, GAP)) -> Topic:
    return next(t for t in topics if t.name == block.topic)


def _in_order(blocks: Sequence[MessageBlock]) -> Iterator[tuple[Topic, DecodedPoints | bytes]]:
    """Yield points and other messages in the order in which they were received."""
    others = sorted(
        (int(t), k, i)
        for k, block in enumerate(blocks)
        if block.topic != POINT.name
        for i, t in enumerate(block.log_time)
    )
    points = [b for b in blocks if b.topic == POINT.name]
    for block in points:
        while others and others[0][0] <= block.log_time[0]:
            yield _message(blocks, others.pop(0))
        cuts = [int(np.searchsorted(block.log_time, t)) for t, _, _ in others]
        at = 0
        for cut in (c for c in cuts if c < block.start.size):
            yield from _points(block, at, cut)
            yield _message(blocks, others.pop(0))
            at = cut
        yield from _points(block, at, block.start.size)
    for other in others:
        yield _message(blocks, other)


def _message(blocks: Sequence[MessageBlock], at: tuple[int, int, int]) -> tuple[Topic, bytes]:
    block = blocks[at[1]]
    start, size = int(block.start[at[2]]), int(block.size[at[2]])
    return _topic(block), bytes(block.buffer[start : start + size])


def _points(block: MessageBlock, start: int, stop: int) -> Iterator[tuple[Topic, DecodedPoints]]:
    if stop > start:
        rows = slice(start, stop)
        yield POINT, decode_points(block.buffer, block.start[rows], block.size[rows], POINT.frame)


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
        self._put(run, Rows(POINT, encode_points(stamp_ns, xyz, frame), self._now()))

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
                self._put(self._run, one_message(topic, one, self._now()))

    def keep(self, topic: Topic, *data: bytes) -> None:
        """Take messages as ``message`` does that the present run has already."""
        self._latched[topic] = data

    def event(self, topic: Topic, data: bytes) -> None:
        """Take a serialized message of what has happened: it is part of this run only."""
        if self._run:
            self._put(self._run, one_message(topic, data, self._now()))

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
                self._put(run, one_message(topic, data, self._now()))
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

    def _put(self, run: JournalRun, rows: Rows) -> None:
        if self._pending > MAX_PENDING_BYTES:
            self._missed += len(rows.data)
            return
        self._append((run, rows))

    def _append(self, item: tuple[JournalRun, Rows] | _End) -> None:
        with self._wake:
            self._items.append(item)
            if not isinstance(item, _End):
                self._pending += item[1].data.nbytes

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
            self._check_room(sum(r.data.nbytes for r in rows))
            run.append(rows)
            del waiting[: len(rows)]
            with self._wake:
                self._pending -= sum(r.data.nbytes for r in rows)

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
