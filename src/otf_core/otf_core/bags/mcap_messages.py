# SPDX-License-Identifier: Apache-2.0
"""Messages of one MCAP file as blocks of positions, without a Python object per message."""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NoReturn

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

# Where the records of an MCAP file or of a decompressed chunk begin.
#
# Every record is opcode (1 byte), length (uint64), content; so the positions of all records follow
# from the lengths alone. Records of one head (opcode and length) that follow each other stand one
# length apart: whole streams of them are checked at once, the rest is walked one by one.

RECORD_HEAD = 9
WALKED_RECORDS = 16
"""Records walked before those behind them are looked at together."""
FIRST_BLOCK = 256
"""Records looked at together at first; twice as many each time that all are alike."""
LISTED_POSITIONS = 1 << 16
"""Positions held as Python numbers at most, which take five times the memory."""


def record_starts(buffer: Bytes, begin: int, end: int) -> Index:
    """Positions of all records from begin on, and ``end`` as the last item.

    Raises
    ------
    ValueError
        If the lengths do not lead exactly to the end.
    """
    starts = complete_records(buffer, begin, end)
    if starts[-1] != end:
        raise ValueError(f'the record at byte {starts[-1]} is cut off')
    return starts


def complete_records(buffer: Bytes, begin: int, end: int) -> Index:
    """Positions of the records that are whole before ``end``, and where the last of them ends.

    Zeros up to the end, which a crash may leave of a file, count as cut off.

    Raises
    ------
    ValueError
        If something that is not a record begins where one should.
    """
    unpack = struct.Struct('<BQ').unpack_from
    view, at, last, last_head = buffer.data, begin, begin, end - RECORD_HEAD
    parts: list[Index] = []
    walked: list[int] = []
    whole = True
    while whole and at <= last_head:
        for _ in range(WALKED_RECORDS):
            opcode, length = unpack(view, at)
            if not opcode and buffer[at:end].any():
                raise ValueError(f'no record at byte {at}')
            whole = bool(opcode) and length <= end - at - RECORD_HEAD
            if not whole:
                break
            walked.append(at)
            last, at = at, at + RECORD_HEAD + length
            if at > last_head:
                break
        alike = len(walked) > 2 and at - last == last - walked[-2] == walked[-2] - walked[-3]
        repeats = whole and alike
        if repeats or len(walked) > LISTED_POSITIONS:
            parts.append(np.array(walked, np.int64))
            walked = []
        if repeats:
            more = _alike(buffer, last, end, opcode, length)
            parts.append(more[1:])
            last = int(more[-1])
            at = last + RECORD_HEAD + length
            if at > end:  # the last of them is cut off
                parts[-1], at, whole = parts[-1][:-1], last, False
    return np.concatenate([*parts, np.array([*walked, at], np.int64)])


def _alike(buffer: Bytes, at: int, end: int, opcode: int, length: int) -> Index:
    """Positions of the record at ``at`` and of those behind it that have the same head."""
    step = RECORD_HEAD + length
    count, look = 1, FIRST_BLOCK
    while look:
        first = at + count * step
        look = min(look, (end - RECORD_HEAD - first) // step + 1)
        if look <= 0:
            break
        opcodes = np.ndarray((look,), 'u1', buffer, first, (step,))
        lengths = np.ndarray((look,), '<u8', buffer, first + 1, (step,))
        other = (opcodes != opcode) | (lengths != length)
        same = int(other.argmax()) if other.any() else look
        count += same
        look = 2 * look if same == look else 0
    return at + step * np.arange(count)


# Messages of one MCAP file as blocks of positions, without a Python object per message.
#
# The positions of all records follow from their lengths alone, in the file as in a decompressed
# chunk (``mcap_records``). Everything else is numpy. The file is mapped, and what was read of it
# is given back chunk by chunk; no length it states is believed before it was checked. A file
# without its end (cut off, or still being recorded) is read to its last complete chunk, which is
# said. Source: mcap.dev/spec as implemented by mcap 1.6 (records.py, stream_reader.py).

MAGIC = b'\x89MCAP0\r\n'
MAX_CHUNK = 1 << 30
"""Bytes; a chunk that claims to unpack to more is taken for damaged."""
SMALL_CHUNK, MAX_RATIO = 1 << 25, 200
"""Bytes; a larger chunk that claims to unpack to so many times its size is taken for damaged:
points and paths shrink to a tenth at best."""
BATCH = 100_000
"""Messages of one block at most: a file without chunks is one buffer."""
CRC_BLOCK = 1 << 24
"""Bytes that are mapped at once for the checksum of the data section."""
MESSAGE_HEAD = np.dtype(
    [
        ('opcode', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
Wanted = Mapping[str, tuple[str, ...]]
"""Topics with the types that they may have; the first is the usual one."""
RECOVER = (
    "--recover reads the rest without it, as 'mcap recover IN.mcap -o OUT.mcap' does for any tool"
)


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


class _Damaged(InputError):
    """Bytes are not what they should be."""


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
        self._file = file
        self._wanted = wanted
        self._topics = topics
        self._remarks = [] if remarks is None else remarks
        self._recover = recover
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, str] = {}
        self._count = 0
        self._left_out = 0
        self._overtaken = False

    def __iter__(self) -> Iterator[MessageBlock]:
        """Yield blocks in file order; InputError if the file is damaged."""
        data = self._map()
        whole = data.size >= 2 * len(MAGIC) and bytes(data[-len(MAGIC) :]) == MAGIC
        starts = self._starts_of_file(data, whole)
        opcodes = data[starts[:-1]]
        if whole and (not np.any(opcodes == Opcode.DATA_END) or opcodes[-1] != Opcode.FOOTER):
            self._damaged_end('the data section or the footer is missing')
        stated = None
        bulk = np.isin(opcodes, [Opcode.MESSAGE, Opcode.MESSAGE_INDEX])
        for i in np.flatnonzero(~bulk):
            opcode, at, end = opcodes[i], int(starts[i]), int(starts[i + 1])
            record = data[at + RECORD_HEAD : end]
            if opcode == Opcode.CHUNK:
                last = not np.any(opcodes[i + 1 :] == Opcode.CHUNK)
                cut = last and (self._overtaken or not whole)
                yield from self._chunk_or_nothing(record, at, cut)
                self._give_back()
            elif opcode == Opcode.DATA_END:
                self._check_data_crc(data, at, self._parse(DataEnd, record).data_section_crc)
            elif opcode == Opcode.STATISTICS:
                stated = self._parse(Statistics, record).message_count
            else:
                self._register(opcode, record)
        yield from self._messages(data, starts)
        if stated not in (None, self._count) and not self._left_out:
            self._damaged_end(f'it states {stated} messages but holds {self._count}')
        if not self._overtaken:
            self._tell(data.size, int(starts[-1]), whole)

    def _starts_of_file(self, data: Bytes, whole: bool) -> Index:
        """Positions of the records; without its end those that are complete."""
        begin = len(MAGIC)
        if whole and not self._recover and not self._grown():
            return self._starts(data, begin, data.size - len(MAGIC))
        try:
            return complete_records(data, begin, data.size - len(MAGIC) * whole)
        except ValueError as error:
            if not self._recover and not self._grown():
                self._damaged(str(error))
            return complete_records(data, begin, int(str(error).rpartition(' ')[2]))

    def _chunk_or_nothing(self, record: Bytes, at: int, cut: bool) -> Iterator[MessageBlock]:
        """Yield the messages of a chunk; none of one that may be left out."""
        count, name = self._count, self._file.name
        try:
            yield from self._chunk(self._parse(Chunk, record))
        except _Damaged:
            if not (cut or self._recover) or self._count > count:
                raise
            self._left_out += 1
            if self._recover and not cut:
                self._remarks.append(f'the damaged chunk at byte {at} of {name} is left out')

    def _tell(self, size: int, end: int, whole: bool) -> None:
        """State what is missing of a file without its end."""
        name = self._file.name
        if whole and end == size - len(MAGIC):
            return
        if whole:
            self._remarks.append(f'{name}: what follows the damage at byte {end} is left out')
            return
        torn = ' and its last chunk, which is incomplete,' if self._left_out else ''
        self._remarks.append(
            f'{name} has no end (cut off, or still being recorded); read to its last '
            f'complete chunk: {self._count} messages, {size - end} of {size} bytes{torn} '
            f'are left out'
        )

    def _map(self) -> Bytes:
        try:
            if not self._file.stat().st_size:
                raise InputError(f'{self._file}: is empty; nothing was recorded')
            with self._file.open('rb') as file:
                self._pages = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            self._size = len(self._pages)
        except OSError as error:
            raise InputError(f'{self._file}: cannot be read ({error.strerror})') from None
        data = np.frombuffer(self._pages, np.uint8)
        if bytes(data[: len(MAGIC)]) != MAGIC:
            raise InputError(
                f'{self._file}: is not an MCAP file (it does not begin with the MCAP magic)'
            )
        return data

    def _give_back(self) -> None:
        """Let go of the pages of the file that were read; what is needed again is read again."""
        if hasattr(mmap, 'MADV_DONTNEED'):  # not on Windows
            self._pages.madvise(mmap.MADV_DONTNEED)

    def _grown(self) -> bool:
        """Return whether the file is being written: its end was then where more stands now."""
        with suppress(OSError):  # removed meanwhile: what was opened can still be read
            return self._file.stat().st_size != self._size
        return False

    def _damaged(self, what: str) -> NoReturn:
        raise _Damaged(f'{self._file}: is damaged, {what}; copy it again, or {RECOVER}')

    def _damaged_end(self, what: str) -> None:
        """Refuse a file of which something is missing, or say so where that is wanted."""
        if self._grown():
            self._remarks.append(
                f'{self._file.name} is being recorded; read up to its current end'
            )
            self._overtaken = True
            return
        if not self._recover:
            self._damaged(what)
        self._remarks.append(f'{self._file.name}: {what}')

    def _starts(self, buffer: Bytes, begin: int, end: int) -> Index:
        try:
            return record_starts(buffer, begin, end)
        except ValueError as error:
            self._damaged(str(error))

    def _parse(self, kind: Any, record: Bytes) -> Any:
        try:
            return kind.read(ReadDataStream(BytesIO(record.tobytes())))
        except (McapError, struct.error, UnicodeDecodeError, OverflowError):
            # OverflowError: mcap asks for as many bytes as a damaged length states
            self._damaged(f'a {kind.__name__} record cannot be decoded')

    def _check_data_crc(self, data: Bytes, end: int, stated: int) -> None:
        if not stated:
            return
        checksum = 0
        for at in range(0, end, CRC_BLOCK):
            checksum = zlib.crc32(data[at : min(at + CRC_BLOCK, end)].data, checksum)
            self._give_back()
        if checksum != stated:
            self._damaged_end('the checksum of the data section is wrong')

    def _register(self, opcode: int, record: Bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = self._parse(Schema, record)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self._register_channel(self._parse(Channel, record))

    def _register_channel(self, channel: Channel) -> None:
        topic, kind = channel.topic, self._schemas.get(channel.schema_id, '')
        if self._channels.setdefault(channel.id, topic) != topic:
            self._damaged(f'channel {channel.id} is defined twice, differently')
        self._topics.setdefault(topic, kind)
        check_type(self._file, topic, kind, channel.message_encoding, self._wanted)

    def _chunk(self, chunk: Chunk) -> Iterator[MessageBlock]:
        data = np.frombuffer(self._unpack(chunk), np.uint8)
        starts = self._starts(data, 0, data.size)
        opcodes = data[starts[:-1]]
        for i in np.flatnonzero(opcodes != Opcode.MESSAGE):
            self._register(opcodes[i], data[starts[i] + RECORD_HEAD : starts[i + 1]])
        yield from self._messages(data, starts)

    def _unpack(self, chunk: Chunk) -> bytes:
        """Decompress a chunk and check its size and checksum."""
        size, how = chunk.uncompressed_size, chunk.compression
        if how not in ('', 'lz4', 'zstd'):
            raise InputError(
                f"{self._file}: chunk compression '{how}' is not supported; rewrite the bag "
                f"with 'mcap compress'"
            )
        try:
            if how == 'zstd':
                known = zstandard.get_frame_parameters(chunk.data).content_size
                if known not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                    size = -1
            bomb = size > SMALL_CHUNK and size > MAX_RATIO * len(chunk.data)
            if not 0 <= size <= MAX_CHUNK or bomb:
                self._damaged(f'a chunk states {chunk.uncompressed_size} bytes')
            stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        except CRCValidationError:
            self._damaged('the checksum of a chunk is wrong')
        except (McapError, zstandard.ZstdError, RuntimeError, ValueError, MemoryError) as error:
            # RuntimeError is what lz4 raises
            self._damaged(f'a chunk cannot be decompressed ({error})')
        if length != size:
            self._damaged(f'a chunk has {length} bytes instead of {size}')
        return stream.read(length)

    def _messages(self, buffer: Bytes, starts: Index) -> Iterator[MessageBlock]:
        """Yield the wanted messages among the records of one buffer, topic by topic."""
        chosen = buffer[starts[:-1]] == Opcode.MESSAGE
        at = starts[:-1][chosen]
        size = np.diff(starts)[chosen] - MESSAGE_HEAD.itemsize
        if np.any(size < 0):
            self._damaged(f'the message at byte {at[size < 0][0]} is too short')
        for first in range(0, at.size, BATCH):
            batch = slice(first, first + BATCH)
            yield from self._batch(buffer, at[batch], size[batch])

    def _batch(self, buffer: Bytes, at: Index, size: Index) -> Iterator[MessageBlock]:
        head = gather(buffer, at, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)
        self._count += at.size
        present = set(np.unique(head['channel']).tolist())
        if not present <= self._channels.keys():
            self._damaged(f'channel {min(present - self._channels.keys())} is not described')
        for topic in self._wanted:
            ids = [i for i in present if self._channels[i] == topic]
            if ids:
                alone = len(ids) == len(present)
                pick = slice(None) if alone else np.isin(head['channel'], ids)
                log_time = head['log_time'][pick].astype(np.int64)
                start = at[pick] + MESSAGE_HEAD.itemsize
                yield MessageBlock(topic, buffer, start, size[pick], log_time)


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
