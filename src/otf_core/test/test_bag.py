# SPDX-License-Identifier: Apache-2.0
"""Bags: exact round trips, agreement with rosbags whatever the storage and layout."""

import gzip
import itertools
import re

import numpy as np
import pytest
import yaml
import zstandard
from bag_cells import (
    CONTENT,
    MESSAGES,
    PATH_MESSAGE,
    PATH_TYPE,
    START,
    TF_TYPE,
    assert_same,
    path_cdr,
    point_cdr,
    point_messages,
    read_with_anyreader,
    some_samples,
    write_mcap,
    write_rosbag,
)
from cli_cells import run
from lz4 import frame
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from otf_core.bags.bag import BagContent, read_bag, read_points, write_bag
from otf_core.errors import ConfigError, InputError
from otf_core.model.observation import Samples

# ---------------------------------------------------------------- writing


def test_written_bag_reads_back_exactly(bag):
    assert_same(read_bag(bag))
    assert_same(read_bag(str(bag / 'bag_0.mcap')))
    assert read_points(bag).stamp_ns.tolist() == CONTENT.samples.stamp_ns.tolist()


def test_written_bag_is_what_rosbags_and_mcap_read(bag):
    assert_same(read_with_anyreader(bag))
    with AnyReader([bag]) as reader:  # also compares the type hashes
        first = next(reader.messages())
        assert (first[0].topic, first[1]) == ('/planner/path', CONTENT.samples.stamp_ns[0])
        assert reader.message_count == len(CONTENT.samples) + 1
        path = next(c for c in reader.connections if c.topic == '/planner/path')
        assert path.ext.offered_qos_profiles[0].durability.name == 'TRANSIENT_LOCAL'
    with (bag / 'bag_0.mcap').open('rb') as stream:
        times = [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
    assert times[1:] == CONTENT.samples.stamp_ns.tolist()


def test_existing_bag_is_replaced_only_when_asked(bag):
    with pytest.raises(ConfigError, match='exists already'):
        write_bag(bag, CONTENT)
    other = BagContent(some_samples(7, seed=2), CONTENT.path)
    write_bag(bag, other, overwrite=True)
    assert_same(read_bag(bag), other)
    assert [p.name for p in bag.parent.iterdir()] == ['bag']


@pytest.mark.parametrize(
    ('stamp', 'xyz', 'text'),
    [
        ([], [], 'no points'),
        ([2, 1], np.ones((2, 3)), 'increase strictly'),
        ([1, 1], np.ones((2, 3)), 'increase strictly'),
        ([1, 2], np.full((2, 3), np.nan), 'not finite'),
        ([1, 2**62], np.ones((2, 3)), 'does not fit'),
    ],
)
def test_samples_that_would_not_read_back_are_not_written(tmp_path, stamp, xyz, text):
    samples = Samples(np.array(stamp, np.int64), np.reshape(np.array(xyz, float), (-1, 3)))
    with pytest.raises(InputError, match=text):
        write_bag(tmp_path / 'bag', BagContent(samples, CONTENT.path))
    assert list(tmp_path.iterdir()) == []


def test_stamps_of_any_epoch_read_back_exactly(tmp_path):
    samples = Samples(np.array([-1_500_000_001, -1, 0, 1]), np.ones((4, 3)))
    write_bag(tmp_path / 'bag', BagContent(samples, CONTENT.path))
    assert_same(read_bag(tmp_path / 'bag'), BagContent(samples, CONTENT.path))


# ---------------------------------------------------------------- storages


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('chunked', [True, False])
def test_mcap_of_any_compression_agrees_with_rosbags(tmp_path, compression, chunked):
    file = write_mcap(tmp_path / 'a.mcap', compression=compression, use_chunking=chunked)
    assert_same(read_bag(file))
    assert_same(read_with_anyreader(file))
    assert_same(read_bag(tmp_path))  # a folder without metadata.yaml


@pytest.mark.parametrize('version', [8, 9])
@pytest.mark.parametrize(
    ('storage', 'mode'),
    [
        (storage, mode)
        for storage in StoragePlugin
        for mode in CompressionMode
        if (storage, mode) != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)  # there is none
    ],
)
def test_every_bag_that_rosbags_writes_reads_exactly(tmp_path, storage, mode, version):
    folder = write_rosbag(tmp_path / 'bag', mode=mode, storage=storage, version=version)
    assert_same(read_bag(folder))
    assert_same(read_with_anyreader(folder))


def test_file_without_indexes_and_checksums_reads(tmp_path):
    file = write_mcap(
        tmp_path / 'a.mcap',
        index_types=IndexType.NONE,
        repeat_channels=False,
        repeat_schemas=False,
        use_statistics=False,
        use_summary_offsets=False,
        enable_crcs=False,
    )
    assert_same(read_bag(file))


def split(tmp_path, cuts):
    folder = tmp_path / 'bag'
    folder.mkdir()
    names = []
    for i, (a, b) in enumerate(itertools.pairwise([1, *cuts, len(MESSAGES)])):
        names.append(f'part_{i}.mcap')
        write_mcap(folder / names[-1], [PATH_MESSAGE, *MESSAGES[a:b]])
    info = {'storage_identifier': 'mcap', 'relative_file_paths': names}
    (folder / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': info}))
    return folder


def test_parts_are_joined_and_the_latched_path_may_repeat(tmp_path):
    assert_same(read_bag(split(tmp_path, [50, 120])))


def test_missing_part_is_named(tmp_path):
    folder = split(tmp_path, [50, 120])
    (folder / 'part_1.mcap').unlink()
    with pytest.raises(InputError, match=r'1 of 3 files .*part_1\.mcap'):
        read_bag(folder)


# ---------------------------------------------------------------- layouts of messages


@pytest.mark.parametrize('compression', [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize('chunked', [True, False])
def test_foreign_topics_between_all_points_do_not_matter(tmp_path, compression, chunked):
    rng = np.random.default_rng(3)
    messages = [PATH_MESSAGE]
    for message in point_messages():
        messages.append(message)
        if rng.random() < 0.9:
            size = int(rng.integers(0, 300))
            messages.append(('/tf', TF_TYPE, message[2], b'\x05' * size))
        if rng.random() < 0.2:
            messages.append(('/log', 'a_msgs/msg/Log', message[2], point_cdr(1, (9, 9, 9))))
    file = write_mcap(tmp_path / 'a.mcap', messages, compression=compression, use_chunking=chunked)
    assert_same(read_bag(file))


def test_big_endian_and_several_publishers_on_one_topic(tmp_path):
    little, big = point_messages(), point_messages(topic='/tracker/point#2', little=False)
    mixed = [pair[i % 3 == 0] for i, pair in enumerate(zip(little, big, strict=True))]
    path = ('/planner/path', PATH_TYPE, START, path_cdr(little=False))
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', [path, *mixed])))


def test_trailing_padding_is_ignored_as_rosbags_does(tmp_path):
    padded = [(a, b, c, d + bytes(i % 4)) for i, (a, b, c, d) in enumerate(MESSAGES)]
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', padded)))
    padded[9] = (*padded[9][:3], padded[9][3] + bytes(4))
    with pytest.raises(InputError, match=r'message 8 .* follow'):
        read_bag(write_mcap(tmp_path / 'a.mcap', padded))


def test_poses_may_leave_their_frame_empty(tmp_path):
    path = (*PATH_MESSAGE[:3], path_cdr(pose_frame=''))
    assert_same(read_bag(write_mcap(tmp_path / 'a.mcap', [path, *MESSAGES[1:]])))


# ---------------------------------------------------------------- as recorders leave them

STORAGES = pytest.mark.parametrize('storage', list(StoragePlugin))


# ---------------------------------------------------------------- metadata.yaml


def changed(folder, change):
    file = folder / 'metadata.yaml'
    data = yaml.safe_load(file.read_text())
    change(data['rosbag2_bagfile_information'])
    file.write_text(yaml.safe_dump(data))
    return folder


def without_counts(info):
    info['message_count'] = 0
    for row in info['topics_with_message_count']:
        row['message_count'] = 0


def without_topics(info):
    info['topics_with_message_count'] = []


@STORAGES
@pytest.mark.parametrize('change', [without_counts, without_topics])
def test_messages_that_metadata_does_not_count_are_read(tmp_path, storage, change):
    assert_same(read_bag(changed(write_rosbag(tmp_path / 'bag', storage=storage), change)))


def test_parts_of_a_database_without_metadata_are_one_bag(tmp_path):
    (tmp_path / 'bag').mkdir()
    half = len(MESSAGES) // 2
    for k, part in enumerate((MESSAGES[:half], MESSAGES[half:])):
        folder = write_rosbag(tmp_path / f'part{k}', part)
        next(folder.glob('*.db3')).rename(tmp_path / 'bag' / f'run_{k}.db3')
    assert_same(read_bag(tmp_path / 'bag'))


def test_what_a_killed_recorder_left_beside_its_database_is_not_lost(tmp_path):
    folder = write_rosbag(tmp_path / 'bag')
    (file,) = folder.glob('*.db3')
    file.with_name(f'{file.name}-wal').write_bytes(b'frames')
    with pytest.raises(InputError, match=r'wal_checkpoint'):
        read_bag(folder)


# ---------------------------------------------------------------- compressed as a whole

PACKED = {
    '.zstd': lambda data: zstandard.ZstdCompressor().compress(data),
    '.zst': lambda data: (
        zstandard.ZstdCompressor().compress(data[:999])
        + zstandard.ZstdCompressor().compress(data[999:])
    ),
    '.lz4': frame.compress,
    '.gz': gzip.compress,
}


@pytest.mark.parametrize('suffix', PACKED)
@pytest.mark.parametrize('storage', ['.mcap', '.db3'])
def test_a_compressed_file_alone(tmp_path, suffix, storage, capsys):
    plain = write_mcap(tmp_path / 'plain.mcap')
    if storage == '.db3':
        (plain,) = write_rosbag(tmp_path / 'bag').glob('*.db3')
    (tmp_path / 'packed').mkdir()
    packed = tmp_path / 'packed' / f'run_0{storage}{suffix}'
    packed.write_bytes(PACKED[suffix](plain.read_bytes()))
    assert_same(read_bag(packed))
    assert_same(read_bag(tmp_path / 'packed'))  # as a folder of one part without metadata.yaml
    assert run('info', packed) == 0
    assert 'recording' in capsys.readouterr().out


def test_a_compressed_file_that_is_cut_off_or_none_is_refused_by_its_name(tmp_path):
    data = write_mcap(tmp_path / 'plain.mcap').read_bytes()
    for name, content in (
        ('cut.mcap.gz', gzip.compress(data)[:-200]),
        ('none.mcap.zstd', data),
        ('inner.mcap.lz4', frame.compress(b'nothing' * 99)),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=re.escape(str(tmp_path / name))):
            read_bag(tmp_path / name)


# ---------------------------------------------------------------- ROS 1
