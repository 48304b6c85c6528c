# SPDX-License-Identifier: Apache-2.0
"""Bags as people have them: cleared paths, metadata that is wrong, compressed files, ROS 1."""

import gzip
import re

import pytest
import yaml
import zstandard
from bag_cells import (
    MESSAGES,
    assert_same,
    write_mcap,
    write_rosbag,
)
from cli_cells import run
from lz4 import frame
from rosbags.rosbag2 import StoragePlugin

from otf_core.bags.bag import read_bag
from otf_core.errors import InputError

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


# ---------------------------------------------------------------- ROS 1
