# SPDX-License-Identifier: Apache-2.0
"""Where the records of an MCAP file or of a decompressed chunk begin.

Every record is opcode (1 byte), length (uint64), content; so the positions of all records follow
from the lengths alone. Records of one head (opcode and length) that follow each other stand one
length apart: whole streams of them are checked at once, the rest is walked one by one.
"""

from __future__ import annotations

import struct
from array import array

import numpy as np

from otf_core.bags.cdr import Bytes, Index

RECORD_HEAD = 9
ALIKE = 16
"""Records of one head in a row from which on the next are checked together."""
FIRST_LOOK = 256
"""Records checked together at first; twice as many each time that all are alike."""


def record_starts(buffer: Bytes, begin: int, end: int) -> Index:
    """Positions of all records from begin on, and ``end`` as the last item.

    Raises
    ------
    ValueError
        If the lengths do not lead exactly to the end.
    """
    unpack = struct.Struct('<BQ').unpack_from
    view, at, last, last_head = buffer.data, begin, begin, end - RECORD_HEAD
    parts: list[Index] = []
    walked = array('q')
    before, alike = (0, 0), 0
    while at <= last_head:
        head = unpack(view, at)
        if not head[0]:
            raise ValueError(f'no record at byte {at}')
        walked.append(at)
        last = at
        alike = alike + 1 if head == before else 0
        before = head
        if alike == ALIKE:
            more = _alike(buffer, at, end, *head)
            parts += [np.frombuffer(walked, np.int64), more[1:]]
            walked, alike = array('q'), 0
            last = int(more[-1])
        at = last + RECORD_HEAD + head[1]
    if at != end:
        raise ValueError(f'the record at byte {last} is cut off')
    walked.append(end)
    return np.concatenate([*parts, np.frombuffer(walked, np.int64)])


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
