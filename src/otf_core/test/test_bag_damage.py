# SPDX-License-Identifier: Apache-2.0
"""Bags in wrong places, cut off or changed: the right content or one clear error."""

import struct

import numpy as np
import pytest
from bag_cells import CONTENT, MESSAGES, PATH_MESSAGE, assert_same, write_mcap, write_rosbag
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from otf_core.bags import mcap_messages
from otf_core.bags.bag import read_bag, write_bag
from otf_core.errors import ConfigError, InputError
from otf_core.inputs.recordings import read_content

# ---------------------------------------------------------------- wrong places


@pytest.mark.parametrize(
    'name', ['none', 'none.mcap', 'a.txt', 'a.bag', 'bag/metadata.yaml', 'x\0y', 'n' * 300]
)
def test_what_cannot_be_a_bag_is_wrong_usage(bag, name):
    for existing in ('a.txt', 'a.bag'):
        (bag.parent / existing).write_text('hello')
    with pytest.raises(ConfigError) as caught:
        read_bag(bag.parent / name)
    assert caught.value.exit_code == 2


def test_foreign_folders_are_unusable_input(tmp_path):
    with pytest.raises(InputError, match='holds neither'):
        read_bag(tmp_path)
    (tmp_path / 'photo.jpg').touch()
    with pytest.raises(InputError, match='holds neither'):
        read_bag(tmp_path)
    for name in 'ab':
        write_bag(tmp_path / name, CONTENT)
    with pytest.raises(InputError, match=r'holds some \(a, b\); name one'):
        read_bag(tmp_path)


@pytest.mark.parametrize(
    'text',
    [
        '',
        '[' * 5000,
        'a: {',
        'a: 2020-99-99',
        '\0',
        '- 1',
        'rosbag2_bagfile_information: 3',
        'rosbag2_bagfile_information: {relative_file_paths: []}',
        'rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}',
        'rosbag2_bagfile_information: {relative_file_paths: [[]], compression_mode: FILE}',
    ],
)
def test_useless_metadata_is_unusable_input(bag, text):
    (bag / 'metadata.yaml').write_text(text)
    with pytest.raises(InputError):
        read_bag(bag)


# ---------------------------------------------------------------- damage


def cuts(size):
    return [int(size * k / 20) for k in range(20)]


@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.NONE},
        {'compression': CompressionType.LZ4},
        {'compression': CompressionType.ZSTD},
        {'use_chunking': False},
    ],
)
def test_mcap_cut_off_anywhere_is_read_to_its_last_complete_chunk(tmp_path, caplog, options):
    file = write_mcap(tmp_path / 'a.mcap', **options)
    whole = file.read_bytes()
    with file.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    ends = [c.chunk_start_offset + c.chunk_length for c in summary.chunk_indexes]
    total = len(CONTENT.samples)
    for cut in [*cuts(len(whole)), *range(1, 10), len(whole) - 1]:
        caplog.clear()
        file.write_bytes(whole[:cut])
        complete = sum(end <= cut for end in ends)
        if (options.get('use_chunking') is False and cut > 3000) or complete:
            found = read_bag(file)
            count = len(found.samples)
            assert found.samples.xyz.tobytes() == CONTENT.samples.xyz[:count].tobytes()
            assert count == total or count >= total * complete // len(ends or [1]) - 40
            assert complete < len(ends) or not ends or count == total
            assert 'cut off' in caplog.text
            assert found.remarks
        elif not cut or cut < 8:
            with pytest.raises(InputError, match='is empty' if not cut else 'MCAP'):
                read_bag(file)


def test_damage_inside_needs_recover_and_costs_its_chunk_only(tmp_path):
    file = write_mcap(tmp_path / 'a.mcap', compression=CompressionType.NONE)
    data = bytearray(file.read_bytes())
    data[data.index(CONTENT.samples.xyz[60].tobytes())] ^= 1
    file.write_bytes(data)
    with pytest.raises(InputError, match=r'checksum .*recover: true'):
        read_bag(file)
    found = read_bag(file, recover=True)
    lost = set(CONTENT.samples.stamp_ns.tolist()) - set(found.samples.stamp_ns.tolist())
    assert int(CONTENT.samples.stamp_ns[60]) in lost and 0 < len(lost) < 60
    assert 'damaged chunk' in found.remarks[0]


def test_parts_of_one_run_are_joined_whatever_their_order(tmp_path):
    parts = [MESSAGES[101:], [PATH_MESSAGE, *MESSAGES[1:101]]]
    files = [write_mcap(tmp_path / f'{k}.mcap', part) for k, part in enumerate(parts)]
    assert_same(read_content(files))
    with pytest.raises(InputError, match='/planner/path'):
        read_bag(files[0])


@pytest.mark.parametrize(
    ('storage', 'mode'),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
    ],
)
def test_other_storage_cut_off_anywhere_is_unusable_input(tmp_path, storage, mode):
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage)
    (file,) = (p for p in folder.iterdir() if p.name != 'metadata.yaml')
    whole = file.read_bytes()
    for cut in cuts(len(whole)):
        file.write_bytes(whole[:cut])
        with pytest.raises(InputError, match='bag'):
            read_bag(folder)


def result_or_none(path):
    """Content if the bag is usable, None for InputError; anything else fails the test."""
    try:
        return read_bag(path)
    except InputError as error:
        assert error.exit_code == 3
        assert str(error)
        return None


@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.NONE},
        {'compression': CompressionType.LZ4},
        {'compression': CompressionType.ZSTD},
        {'use_chunking': False},
    ],
)
@pytest.mark.parametrize('seed', range(2))
def test_changed_bytes_give_the_right_content_or_an_error(tmp_path, options, seed):
    file = write_mcap(tmp_path / 'a.mcap', enable_data_crcs=True, **options)
    whole = np.fromfile(file, np.uint8)
    rng = np.random.default_rng(seed)
    for _ in range(80):
        broken = whole.copy()
        at = int(rng.integers(0, whole.size))
        broken[at : at + int(rng.choice([1, 1, 8, 200]))] ^= np.uint8(rng.integers(1, 256))
        broken.tofile(file)
        content = result_or_none(file)
        if content is not None:
            assert_same(content)


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('mode', [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_changed_bytes_without_checksums_never_crash(tmp_path, caplog, storage, mode):
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage)
    rng = np.random.default_rng(7)
    for file in sorted(folder.iterdir()):
        whole = np.fromfile(file, np.uint8)
        for _ in range(40):
            broken = whole.copy()
            broken[rng.integers(0, whole.size, 3)] = rng.integers(0, 256, 3)
            broken.tofile(file)
            result_or_none(folder)
        whole.tofile(file)


@pytest.mark.parametrize('fill', ['noise', 'zero', 'ones'])
def test_garbage_is_unusable_input(tmp_path, fill):
    rng = np.random.default_rng(5)
    for size in (1, 7, 8, 16, 17, 1000, 100_000):
        body = {
            'noise': rng.bytes(size),
            'zero': bytes(size),
            'ones': b'\xff' * size,
        }[fill]
        for data in (body, mcap_messages.MAGIC + body + mcap_messages.MAGIC):
            for name in ('a.mcap', 'a.db3'):
                (tmp_path / name).write_bytes(data)
                assert result_or_none(tmp_path / name) is None


def record(opcode, content):
    return struct.pack('<BQ', opcode, len(content)) + content


def chunk(size, compression, data):
    head = struct.pack('<QQQII', 0, 0, size, 0, len(compression)) + compression.encode()
    return record(6, head + struct.pack('<Q', len(data)) + data)


def text(value):
    return struct.pack('<I', len(value)) + value.encode()
