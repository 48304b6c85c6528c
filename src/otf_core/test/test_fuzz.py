# SPDX-License-Identifier: Apache-2.0
"""Files from anywhere: read, or refused with one message of bounded length, in bounded memory.

The long version is ``bench/fuzz_readers.py``.
"""

import resource
import struct

import mutations
import pytest
import yaml
import zstandard
from bag_cells import write_rosbag
from rosbags.rosbag2 import CompressionMode

from otf_core.bags import bag_source
from otf_core.bags.bag import read_bag
from otf_core.bags.mcap_messages import MAGIC
from otf_core.errors import InputError
from otf_core.model.machine import load_machine


def record(opcode, content):
    """A record of an MCAP file."""
    return struct.pack('<BQ', opcode, len(content)) + content


COUNTS = {'machine.yaml': 20, 'effects.yaml': 20, 'program.nc': 40, 'points.csv': 40}
COUNT = 200
KINDS = (
    'machine.yaml', 'effects.yaml', 'points.csv', 'error_tables.json', 'noise.json', 'plan.json',
    'program.nc', 'program.h', 'zstd.mcap', 'recovered plain.mcap', 'unchunked.mcap',
)  # fmt: skip


@pytest.fixture(scope='module')
def readers(tmp_path_factory):
    return mutations.readers(tmp_path_factory.mktemp('good'))


@pytest.mark.parametrize('name', KINDS)
def test_mutated_files_are_read_or_refused_in_order(readers, tmp_path, name):
    good, read = readers[name]
    file = tmp_path / f'x.{name.rpartition(".")[2]}'
    file.write_bytes(good)
    read(file)  # the mutations are those of something that is read
    assert mutations.look_for_trouble(readers[name], file, COUNTS.get(name, COUNT), 8) is None


@pytest.mark.parametrize('depth', [4, 9, 40])
def test_aliases_cost_neither_memory_nor_a_long_message(tmp_path, depth):
    text = mutations.aliases(depth)
    lists = b'\n'.join(line for line in text.split(b'\n') if not line.startswith(b'm'))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for data in (text, lists):
        assert mutations.trouble(load_machine, tmp_path / 'machine.yaml', data) == ''
    whole = lists + yaml.safe_dump(mutations.MACHINE).encode()
    assert mutations.trouble(load_machine, tmp_path / 'machine.yaml', whole) == ''
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 50_000  # kB


def test_small_chunk_that_unpacks_to_a_gigabyte_is_refused_unread(tmp_path):
    size = 1 << 30
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    packed = b''.join(packer.compress(bytes(1 << 24)) for _ in range(size >> 24)) + packer.flush()
    assert len(packed) < 100_000
    head = struct.pack('<QQQII4sQ', 0, 0, size, 0, 4, b'zstd', len(packed))
    body = record(6, head + packed)
    file = tmp_path / 'a.mcap'
    end = record(15, bytes(4)) + record(2, bytes(20))
    file.write_bytes(MAGIC + record(1, bytes(8)) + body + end + MAGIC)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=f'a chunk states {size} bytes'):
        read_bag(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_packed_file_that_unpacks_to_far_too_much_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_source, 'MOST_UNPACKED', 1 << 22)
    folder = write_rosbag(tmp_path / 'bag', mode=CompressionMode.FILE)
    (file,) = folder.glob('*.zstd')
    assert len(read_bag(folder).samples) == 200
    file.write_bytes(zstandard.ZstdCompressor().compress(bytes(1 << 26)))
    with pytest.raises(InputError, match='4 MB'):
        read_bag(folder)
