# SPDX-License-Identifier: Apache-2.0
"""Bags are read in bulk: the same records as one by one, and little memory beside the samples."""

import random
import struct
import tracemalloc

import numpy as np
import pytest
from bag_cells import CORNERS, some_samples

from otf_core.bags import bag_reading, mcap_messages
from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.bags.mcap_messages import record_starts
from otf_core.model.path import NominalPath


def walk(buffer, begin, end):
    """Positions of records found one by one, or None if they do not lead to the end."""
    data, starts, at = bytes(buffer), [], begin
    while at + 9 <= end:
        opcode, length = struct.unpack_from('<BQ', data, at)
        if not opcode:
            return None
        starts.append(at)
        at += 9 + length
    return [*starts, end] if at == end else None


def records(rng):
    """Bytes of some streams of records, each stream of one head, with little variety of bytes."""
    parts = []
    for _ in range(rng.randrange(8)):
        opcode, length = rng.choice([5, 5, 1, 4, 7]), rng.choice([0, 1, 22, rng.randrange(200)])
        for _ in range(rng.choice([1, 2, 15, 16, 17, 18, 60, 700])):
            content = bytes(rng.choices([0, 0, 1, 5], k=length))
            parts.append(struct.pack('<BQ', opcode, length) + content)
    return bytearray(b''.join(parts))


def damaged(rng, data):
    """The same with some bytes changed, or cut off."""
    for _ in range(rng.randrange(4) if data else 0):
        data[rng.randrange(len(data))] = rng.choice([0, 1, 5, 99, 255])
    return data[: rng.randrange(len(data) + 1)] if rng.random() < 0.2 else data


@pytest.mark.parametrize('look', [1, 3, 256])
@pytest.mark.parametrize('seed', range(8))
def test_records_found_together_are_those_found_one_by_one(seed, look, monkeypatch):
    monkeypatch.setattr(mcap_messages, 'FIRST_BLOCK', look)
    rng = random.Random(seed)
    outcomes = set()
    for _ in range(40):
        data = np.frombuffer(bytes(damaged(rng, records(rng))), np.uint8)
        expected = walk(data, 0, data.size)
        try:
            found = record_starts(data, 0, data.size).tolist()
        except ValueError:
            found = None
        assert found == expected
        outcomes.add(found is None)
    assert outcomes == {True, False}


def test_records_that_fill_a_chunk_to_the_last_byte_are_cut_off_with_one_byte_less():
    data = np.frombuffer(1000 * (struct.pack('<BQ', 5, 91) + bytes(91)), np.uint8)
    np.testing.assert_array_equal(record_starts(data, 0, data.size), np.arange(0, 100_001, 100))
    with pytest.raises(ValueError, match='the record at byte 99900 is cut off'):
        record_starts(data[:-1], 0, data.size - 1)
    with pytest.raises(ValueError, match='the record at byte 99900 is cut off'):
        record_starts(data, 0, data.size - 91)


@pytest.mark.parametrize('block', [500, 1 << 18])
def test_reading_takes_little_memory_beside_the_samples(tmp_path, monkeypatch, block):
    monkeypatch.setattr(bag_reading, 'BLOCK_ROWS', block)
    samples = some_samples(150_000)
    write_bag(tmp_path / 'bag', BagContent(samples, NominalPath(CORNERS)))
    tracemalloc.start()
    try:
        found = read_bag(tmp_path / 'bag').samples
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.xyz.tobytes() == samples.xyz.tobytes()
    assert np.array_equal(found.stamp_ns, samples.stamp_ns)
    chunk = 3 << 20  # packed, unpacked, and the numbers made of it
    assert peak - chunk < 2 * (found.stamp_ns.nbytes + found.xyz.nbytes)
