# SPDX-License-Identifier: Apache-2.0
"""Messages of one MCAP file as blocks of positions, without a Python object per message.

``mcap`` reads the records of the file; chunks are taken whole, and numpy takes the messages out of
them. A file without its end (cut off, or still being recorded) is read to its last complete chunk,
which is said. Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Schema, Statistics
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from otf_core.arrays import Index
from otf_core.bags.cdr import Bytes, gather
from otf_core.errors import InputError

T = TypeVar('T')
MAGIC = b'\x89MCAP0\r\n'
MAX_CHUNK = 1 << 30
"""Bytes; a chunk that claims to unpack to more is taken for damaged."""
SMALL_CHUNK, MAX_RATIO = 1 << 25, 200
"""Bytes; a larger chunk that claims to unpack to so many times its size is taken for damaged:
points and paths shrink to a tenth at best."""
BATCH = 50_000
"""Messages of one block at most, outside of chunks."""
ALIKE = 16
"""Records of one head in a row from which on those behind them are looked at together."""
RECORD_HEAD = np.dtype([('opcode', 'u1'), ('length', '<u8')])
MESSAGE_HEAD = np.dtype(
    [
        *RECORD_HEAD.descr,
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
Wanted = Mapping[str, tuple[str, ...]]
"""Topics with the types that they may have; the first is the usual one."""
RECOVER = (
    "recover: true in --config reads the rest without it, as 'mcap recover IN.mcap -o OUT.mcap' "
    'does for any tool'
)
DAMAGE = (
    McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError, OverflowError,
    MemoryError,
)  # fmt: skip
"""What mcap, zstandard and lz4 raise on what is not as it should be; they ask for as many bytes as
a damaged length states."""


@dataclass(frozen=True)
class MessageBlock:
    """Messages of one topic inside one buffer.

    Attributes
    ----------
    buffer : ndarray of uint8
    start, size : ndarray of int64, shape (n,)
        Where each serialized message begins in the buffer, and its bytes.
    log_time : ndarray of int64, shape (n,), ns
        When it was received.
    """

    topic: str
    buffer: Bytes
    start: Index
    size: Index
    log_time: Index

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        """Yield log time, ns, and bytes of every message."""
        rows = zip(self.start.tolist(), self.size.tolist(), self.log_time.tolist(), strict=True)
        return ((time, bytes(self.buffer[at : at + size])) for at, size, time in rows)


def join_messages(topic: str, messages: Iterator[tuple[int, bytes]]) -> Iterator[MessageBlock]:
    """Join messages, log time in ns and bytes each, to blocks."""
    while batch := list(islice(messages, BATCH)):
        size = np.array([len(data) for _, data in batch], np.int64)
        buffer = np.frombuffer(b''.join(data for _, data in batch), np.uint8)
        log_time = np.array([time for time, _ in batch], np.uint64).astype(np.int64)
        yield MessageBlock(topic, buffer, np.cumsum(size) - size, size, log_time)


def record_starts(data: Bytes, begin: int = 0) -> Index:
    """Positions of the whole records from ``begin`` on, and where the last of them ends."""
    unpack, view = struct.Struct('<BQ').unpack_from, data.data
    starts: list[int] = []
    at, alike, last, last_head = begin, 0, 0, data.size - RECORD_HEAD.itemsize
    while at <= last_head:
        opcode, length = unpack(view, at)
        if not opcode or length > last_head - at:  # zeros may be what a crash leaves of a file
            break
        starts.append(at)
        step = RECORD_HEAD.itemsize + length
        alike = alike + 1 if step == last else 0
        if alike == ALIKE:
            heads = np.ndarray(((data.size - at) // step,), RECORD_HEAD, data, at, (step,))
            other = (heads['opcode'] != opcode) | (heads['length'] != length)
            count, alike = int(other.argmax()) if other.any() else heads.size, 0
            starts.extend(range(at + step, at + count * step, step))
            at += (count - 1) * step
        at, last = at + step, step
    return np.array([*starts, at], np.int64)


class McapMessages:
    """One pass over an MCAP file.

    Parameters
    ----------
    wanted : mapping of topic to message types
        Topics to read; one that is in the file with another type is an InputError.
    topics : dict of topic to message type
        Filled with all topics that are in the file.
    remarks : list of str
        Filled with what had to be left out.
    recover : bool
        Leave out damaged chunks instead of refusing the file.
    """

    def __init__(
        self,
        file: Path,
        wanted: Wanted,
        topics: dict[str, str],
        remarks: list[str] | None = None,
        *,
        recover: bool = False,
    ) -> None:
        self._file, self._wanted, self._topics, self._recover = file, wanted, topics, recover
        self._remarks = [] if remarks is None else remarks
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, str] = {}
        self._count = self._left_out = self._size = 0
        self._whole, self._torn = False, ''

    def __iter__(self) -> Iterator[MessageBlock]:
        """Yield blocks in file order; InputError if the file is damaged."""
        try:
            self._size = self._file.stat().st_size
            if not self._size:
                raise InputError(f'{self._file}: is empty; nothing was recorded')
            data = np.memmap(self._file, np.uint8, 'r', shape=(self._size,)).view(np.ndarray)
        except OSError as error:
            raise InputError(f'{self._file}: cannot be read ({error.strerror})') from None
        if bytes(data[: len(MAGIC)]) != MAGIC:
            raise InputError(
                f'{self._file}: is not an MCAP file (it does not begin with the MCAP magic)'
            )
        self._whole = data.size >= 2 * len(MAGIC) and bytes(data[-len(MAGIC) :]) == MAGIC
        try:
            yield from self._records(data[: -len(MAGIC)] if self._whole else data)
        except DAMAGE as error:
            raise InputError(
                f'{self._file}: is damaged, {error}; copy it again, or {RECOVER}'
            ) from None

    def _records(self, data: Bytes) -> Iterator[MessageBlock]:
        starts = record_starts(data, len(MAGIC))
        opcodes, stated = data[starts[:-1]], None
        bulk = np.isin(opcodes, (Opcode.MESSAGE, Opcode.MESSAGE_INDEX))
        end = int(starts[-1])
        if self._whole and end < data.size:
            self._damaged_end(f'the record at byte {end} is cut off')
        elif self._whole and (Opcode.DATA_END not in opcodes or opcodes[-1] != Opcode.FOOTER):
            self._damaged_end('the data section or the footer is missing')
        for i in np.flatnonzero(~bulk).tolist():
            at, record = int(starts[i]), data[starts[i] + RECORD_HEAD.itemsize : starts[i + 1]]
            if opcodes[i] == Opcode.CHUNK:
                yield from self._chunk_or_nothing(record, at)
            elif opcodes[i] == Opcode.DATA_END:
                checksum = _parsed(DataEnd, record).data_section_crc
                if checksum not in (0, zlib.crc32(data[:at].data)):
                    self._damaged_end('the checksum of the data section is wrong')
            elif opcodes[i] == Opcode.STATISTICS:
                stated = _parsed(Statistics, record).message_count
            else:
                self._register(opcodes[i], record)
        for first in range(0, starts.size, BATCH):
            yield from self._blocks(data, starts[first : first + BATCH + 1])
        if stated not in (None, self._count) and not self._left_out:
            self._damaged_end(f'it states {stated} messages but holds {self._count}')
        if not self._whole and not self._grown():
            torn = ' and its last chunk, which is incomplete,' if self._torn else ''
            self._remarks.append(
                f'{self._file.name} has no end (cut off, or still being recorded); read to its '
                f'last complete chunk: {self._count} messages, {data.size - end} of {data.size} '
                f'bytes{torn} are left out'
            )

    def _grown(self) -> bool:
        """Return whether the file is being written: its end was then where more stands now."""
        with suppress(OSError):  # removed meanwhile: what was opened can still be read
            return self._file.stat().st_size != self._size
        return False

    def _damaged_end(self, what: str) -> None:
        """Refuse a file of which something is missing, or say so where that is wanted."""
        if self._grown():
            what = 'is being recorded; read up to its current end'
        elif not self._recover:
            raise ValueError(what)
        self._remarks.append(f'{self._file.name}: {what}')

    def _register(self, opcode: int, record: Bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = _parsed(Schema, record)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = _parsed(Channel, record)
            topic, kind = channel.topic, self._schemas.get(channel.schema_id, '')
            if self._channels.setdefault(channel.id, topic) != topic:
                raise ValueError(f'channel {channel.id} is defined twice, differently')
            self._topics.setdefault(topic, kind)
            check_type(self._file, topic, kind, channel.message_encoding, self._wanted)

    def _topic(self, channel: int) -> str:
        if channel not in self._channels:
            raise ValueError(f'channel {channel} is not described')
        return self._channels[channel]

    def _chunk_or_nothing(self, record: Bytes, at: int) -> Iterator[MessageBlock]:
        """Yield the messages of a chunk; none of one that may be left out.

        The last chunk of a file without its end may be torn.
        """
        if self._torn:
            raise ValueError(self._torn)
        try:
            data = self._unpack(_parsed(Chunk, record))
            starts = record_starts(data)
            if starts[-1] != data.size:
                raise ValueError(f'the record at byte {starts[-1]} of a chunk is cut off')
            for i in np.flatnonzero(data[starts[:-1]] != Opcode.MESSAGE).tolist():
                content = data[starts[i] + RECORD_HEAD.itemsize : starts[i + 1]]
                self._register(data[starts[i]], content)
            blocks = list(self._blocks(data, starts))
        except DAMAGE as error:
            what = str(error)
            if isinstance(error, CRCValidationError):
                what = 'the checksum of a chunk is wrong'
            if self._recover:
                where = f'at byte {at} of {self._file.name}'
                self._remarks.append(f'the damaged chunk {where} is left out ({what})')
            elif self._whole and not self._grown():
                raise ValueError(what) from None
            else:
                self._torn = what
            self._left_out += 1
            return
        yield from blocks

    def _unpack(self, chunk: Chunk) -> Bytes:
        """Decompress a chunk and check its size and checksum."""
        stated, how = chunk.uncompressed_size, chunk.compression
        if how not in ('', 'lz4', 'zstd'):
            raise InputError(
                f"{self._file}: chunk compression '{how}' is not supported; rewrite the bag "
                f"with 'mcap compress'"
            )
        sizes = {stated}
        if how == 'zstd':
            sizes.add(zstandard.get_frame_parameters(chunk.data).content_size)
        sizes.discard(zstandard.CONTENTSIZE_UNKNOWN)
        largest = max(SMALL_CHUNK, MAX_RATIO * len(chunk.data))
        if len(sizes) > 1 or stated > min(largest, MAX_CHUNK):
            raise ValueError(f'a chunk states {stated} bytes')
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        if length != stated:
            raise ValueError(f'a chunk has {length} bytes instead of {stated}')
        return np.frombuffer(stream.read(length), np.uint8)

    def _blocks(self, buffer: Bytes, starts: Index) -> Iterator[MessageBlock]:
        """Yield the wanted messages among records, topic by topic."""
        chosen = buffer[starts[:-1]] == Opcode.MESSAGE
        at, size = starts[:-1][chosen], np.diff(starts)[chosen] - MESSAGE_HEAD.itemsize
        if np.any(size < 0):
            raise ValueError(f'the message at byte {at[size < 0][0]} is too short')
        head = gather(buffer, at, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)
        present = {i: self._topic(i) for i in np.unique(head['channel']).tolist()}
        self._count += at.size
        for topic in self._wanted.keys() & set(present.values()):
            ids = [i for i, name in present.items() if name == topic]
            pick = slice(None) if len(ids) == len(present) else np.isin(head['channel'], ids)
            log_time = head['log_time'][pick].astype(np.int64)
            start = at[pick] + MESSAGE_HEAD.itemsize
            yield MessageBlock(topic, buffer, start, size[pick], log_time)


def _parsed(kind: type[T], record: Bytes) -> T:
    """Return a record as mcap reads it; ValueError if it cannot."""
    try:
        read: T = kind.read(ReadDataStream(BytesIO(record.tobytes())))  # type: ignore[attr-defined]
    except DAMAGE as error:
        raise ValueError(f'a {kind.__name__} record cannot be decoded ({error})') from None
    return read


def check_type(where: Path, topic: str, kind: str, encoding: str, wanted: Wanted) -> None:
    """Raise InputError if a wanted topic has another message type or is not CDR."""
    if topic in wanted and (encoding == 'ros1' or kind in map(_name_in_ros1, wanted[topic])):
        raise InputError(
            f'{where}: holds messages of ROS 1 ({topic}, {kind}), but only ROS 2 is supported; '
            f'convert the '
            f"ROS 1 bag it was made of: 'rosbags-convert --src RUN.bag --dst RUN'"
        )
    if topic in wanted and kind not in wanted[topic]:
        raise InputError(
            f"{where}: topic {topic} has type '{kind}', expected "
            f'{" or ".join(map(repr, wanted[topic]))}; record one of these or name another topic'
        )
    if topic in wanted and encoding != 'cdr':
        raise InputError(f"{where}: topic {topic} is encoded as '{encoding}', expected 'cdr'")


def _name_in_ros1(kind: str) -> str:
    """Name of a message type as ROS 1 has it: without msg."""
    return kind.replace('/msg/', '/')
