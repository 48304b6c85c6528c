# SPDX-License-Identifier: Apache-2.0
"""Where the records of an MCAP file or of a decompressed chunk begin.

Every record is opcode (1 byte), length (uint64), content; so the positions of all records follow
from the lengths alone. Records of one head (opcode and length) that follow each other stand one
length apart: whole streams of them are checked at once, the rest is walked one by one.
"""

from __future__ import annotations

import struct

import numpy as np

from otf_core.arrays import Index
from otf_core.bags.cdr import Bytes

RECORD_HEAD = 9
WALK = 16
"""Records walked before those behind them are looked at together."""
FIRST_LOOK = 256
"""Records looked at together at first; twice as many each time that all are alike."""
LISTED = 1 << 16
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
        If something that is no record begins where one should.
    """
    unpack = struct.Struct('<BQ').unpack_from
    view, at, last, last_head = buffer.data, begin, begin, end - RECORD_HEAD
    parts: list[Index] = []
    walked: list[int] = []
    whole = True
    while whole and at <= last_head:
        for _ in range(WALK):
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
        if repeats or len(walked) > LISTED:
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
    count, look = 1, FIRST_LOOK
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
