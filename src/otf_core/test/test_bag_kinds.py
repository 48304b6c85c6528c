# SPDX-License-Identifier: Apache-2.0
"""Bags as people have them: cleared paths, metadata that is wrong, compressed files, ROS 1."""

import gzip
import re

import pytest
import yaml
import zstandard
from bag_cells import (
    CORNERS,
    MESSAGES,
    PATH_MESSAGE,
    PATH_TYPE,
    assert_same,
    path_cdr,
    write_mcap,
    write_rosbag,
)
from cli_cells import run
from lz4 import frame
from mcap.writer import Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from otf_core.bags.bag import read_bag
from otf_core.errors import InputError

EMPTY = (*PATH_MESSAGE[:3], path_cdr(points=[]))
STORAGES = pytest.mark.parametrize('storage', list(StoragePlugin))


@pytest.mark.parametrize(
    'messages',
    [[EMPTY, *MESSAGES], [*MESSAGES, EMPTY], [*MESSAGES, EMPTY, PATH_MESSAGE, EMPTY]],
    ids=['before', 'after', 'between and after'],
)
def test_a_path_that_is_cleared_is_left_out(tmp_path, messages):
    content = read_bag(write_mcap(tmp_path / 'a.mcap', messages))
    assert_same(content)
    count = sum(m is EMPTY for m in messages)
    assert content.remarks[0].startswith(f'{count} messages of /planner/path have no points')


def test_another_path_after_a_cleared_one_is_still_another_path(tmp_path):
    other = (*PATH_MESSAGE[:3], path_cdr(points=CORNERS[::-1]))
    file = write_mcap(
        tmp_path / 'a.mcap', [*MESSAGES, EMPTY, (*other[:2], MESSAGES[-1][2], other[3])]
    )
    with pytest.raises(InputError, match=r'2 different paths .*: --path FILE \(plan.json'):
        read_bag(file)


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
@pytest.mark.parametrize('value', ['', None, 'rocksdb'])
def test_a_storage_that_is_not_stated_is_that_of_the_files(tmp_path, storage, value):
    folder = write_rosbag(tmp_path / 'bag', storage=storage)
    assert_same(read_bag(changed(folder, lambda info: info.update(storage_identifier=value))))


@pytest.mark.parametrize('value', ['', None, 'sqlite3'])
def test_a_compressed_bag_is_read_whatever_its_storage_is_stated_to_be(tmp_path, value):
    folder = write_rosbag(tmp_path / 'bag', mode=CompressionMode.FILE)
    assert_same(read_bag(changed(folder, lambda info: info.update(storage_identifier=value))))


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
    with pytest.raises(InputError, match=r'were not merged .* sqlite3 .*wal_checkpoint'):
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


def test_a_compressed_file_that_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr('otf_core.bags.bag_source.MOST_UNPACKED', 1 << 20)
    (tmp_path / 'a.mcap.zst').write_bytes(zstandard.ZstdCompressor().compress(bytes(1 << 22)))
    with pytest.raises(InputError, match='unpacks to more than 1 MB'):
        read_bag(tmp_path / 'a.mcap.zst')


# ---------------------------------------------------------------- ROS 1

ROS1 = get_typestore(Stores.ROS1_NOETIC)


def ros1_file(file, topics):
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros1')
        for name, kind, data in topics:
            schema = writer.register_schema(kind.replace('/msg/', '/'), 'ros1msg', b'')
            channel = writer.register_channel(name, 'ros1', schema)
            writer.add_message(channel, 1, data, 1)
        writer.finish()
    return file


@pytest.mark.parametrize(
    'topics',
    [[('/tracker/point', 'geometry_msgs/msg/PointStamped')], [('/planner/path', PATH_TYPE)]],
    ids=['points', 'path'],
)
@pytest.mark.parametrize('verb', ['info', 'check'])
def test_ros_1_in_mcap_is_named_with_its_cure(tmp_path, topics, verb, capsys):
    file = ros1_file(tmp_path / 'a.mcap', [(*topic, bytes(60)) for topic in topics])
    assert run(verb, file) == 3
    said = ''.join(capsys.readouterr())
    assert 'ROS 1' in said and 'rosbags-convert --src RUN.bag --dst RUN' in said


def test_ros_1_beside_ros_2_on_other_topics_does_not_disturb(tmp_path):
    with (tmp_path / 'a.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        odd = writer.register_channel(
            '/odd', 'ros1', writer.register_schema('a/B', 'ros1msg', b'')
        )
        writer.add_message(odd, 1, b'123', 1)
        for name, kind in (('/planner/path', PATH_TYPE), ('/tracker/point', MESSAGES[1][1])):
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(name, 'cdr', schema)
            for topic, _, time, data in MESSAGES:
                if topic == name:
                    writer.add_message(channel, time, data, time)
        writer.finish()
    assert_same(read_bag(tmp_path / 'a.mcap'))
