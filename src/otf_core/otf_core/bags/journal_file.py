# SPDX-License-Identifier: Apache-2.0
"""One MCAP file that grows chunk by chunk and is a whole file after every one of them.

Behind the last chunk stand an end of the data section and a footer without a summary, which the
next chunk overwrites; so any reader takes the file at any moment, and one that is torn while it is
written is read to the chunk before. Only when the file is closed its summary is written.
Source: mcap.dev/spec; records as mcap 1.6 writes them.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
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

from otf_core.bags.mcap_messages import MAGIC, MESSAGE_HEAD
from otf_core.bags.mcap_records import RECORD_HEAD, complete_records
from otf_core.bags.rosbag2_metadata import CREATOR, Part, channel_metadata
from otf_core.bags.topics import Topic


@dataclass(frozen=True)
class Rows:
    """Serialized messages of one topic, one length.

    Attributes
    ----------
    topic : Topic
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

    @property
    def chunk_end(self) -> int:
        """Byte behind the last chunk."""
        last = self._index[-1]
        return last.chunk_start_offset + last.chunk_length

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
        """Tell whether somebody has removed or replaced the file."""
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
    left = memoryview(data)
    while left:
        written = os.pwrite(file, left, at)
        left, at = left[written:], at + written


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
