# SPDX-License-Identifier: Apache-2.0
"""Write a rosbag2 folder as rosbag2 itself lays it out: metadata.yaml version 9 and one MCAP file.

Message definitions and type hashes come from rosbags' type store, the container from mcap. Offered
quality of service is stored, so that ``ros2 bag play`` latches the path.
"""

from __future__ import annotations

import os
import shutil
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from otf_core.bags.cdr import SECOND_NS, encode_path, encode_points
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

FILE_NAME = 'bag_0.mcap'
"""The same in every bag, so that equal content gives equal bytes."""
CREATOR = 'otf_core'
FOREVER = {'sec': 9223372036, 'nsec': 854775807}


def write_recording(folder: Path, samples: Samples, path: NominalPath, overwrite: bool) -> None:
    """Write points and path; see ``bag.write_bag``."""
    folder = Path(os.path.abspath(folder))
    for stamp in (samples.stamp_ns[0], samples.stamp_ns[-1]):
        if not -(2**31) <= stamp // SECOND_NS < 2**31:
            raise InputError(f'{folder}: stamp {stamp} ns does not fit into a ROS time')
    try:
        _check_target(folder, overwrite)
        folder.parent.mkdir(parents=True, exist_ok=True)
        new = folder.parent / f'.{folder.name}.{uuid.uuid4().hex}.new'
        new.mkdir()
        try:
            _write_files(new, samples, path)
            _replace(new, folder)
        finally:
            shutil.rmtree(new, ignore_errors=True)
    except OSError as error:
        raise ConfigError(f'{folder}: cannot be written ({error.strerror or error})') from None


def _check_target(folder: Path, overwrite: bool) -> None:
    if not os.path.lexists(folder):
        return
    if not overwrite:
        raise ConfigError(f'{folder}: exists already; choose another name or remove it')
    replaceable = folder.is_dir() and not folder.is_symlink()
    if not replaceable or not ((folder / 'metadata.yaml').is_file() or not any(folder.iterdir())):
        raise ConfigError(f'{folder}: is no bag and is not overwritten; choose another name')


def _replace(new: Path, folder: Path) -> None:
    """Give the new folder its final name, moving one that is there out of the way."""
    if not folder.exists():
        new.rename(folder)
        return
    old = new.with_suffix('.old')
    folder.rename(old)
    try:
        new.rename(folder)
    except OSError:
        old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _write_files(folder: Path, samples: Samples, path: NominalPath) -> None:
    from mcap.writer import CompressionType, Writer  # with rosbags: 0.2 s only writers pay
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    # a log time is unsigned; stamps may have any epoch
    log_time = np.maximum(samples.stamp_ns, 0).tolist()
    hashes = {topic: store.hash_rihs01(topic.type) for topic in (PATH, POINT)}
    metadata = _metadata(log_time[0], log_time[-1], len(samples), hashes)
    with (folder / FILE_NAME).open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile='ros2', library=CREATOR)
        channels = []
        for topic in (PATH, POINT):
            text, _ = store.generate_msgdef(topic.type, ros_version=2)
            schema = writer.register_schema(topic.type, 'ros2msg', text.encode())
            qos = {'offered_qos_profiles': yaml.safe_dump([_qos(topic)], sort_keys=False)}
            channels.append(writer.register_channel(topic.name, 'cdr', schema, qos))
        first = encode_path(path.points, int(samples.stamp_ns[0]), PATH.frame)
        writer.add_message(channels[0], log_time[0], first, log_time[0])
        rows = encode_points(samples.stamp_ns, samples.xyz, POINT.frame)
        data, width = rows.tobytes(), rows.dtype.itemsize
        for i, time in enumerate(log_time):
            writer.add_message(channels[1], time, data[i * width : (i + 1) * width], time)
        inner = yaml.safe_dump(metadata, sort_keys=False)
        writer.add_metadata('rosbag2', {'serialized_metadata': inner})
        writer.finish()  # type: ignore[no-untyped-call]
    outer = yaml.safe_dump({'rosbag2_bagfile_information': metadata}, sort_keys=False)
    (folder / 'metadata.yaml').write_text(outer, encoding='utf-8')


def _qos(topic: Topic) -> dict[str, Any]:
    return {
        'history': 'keep_last',
        'depth': topic.depth,
        'reliability': 'reliable',
        'durability': topic.durability,
        'deadline': dict(FOREVER),
        'lifespan': dict(FOREVER),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(FOREVER),
        'avoid_ros_namespace_conventions': False,
    }


def _metadata(start: int, end: int, points: int, hashes: dict[Topic, str]) -> dict[str, Any]:
    """Return the content of metadata.yaml, version 9."""
    counts = {PATH: 1, POINT: points}

    def span() -> dict[str, Any]:
        return {
            'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': sum(counts.values()),
        }

    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **span(),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [_qos(topic)],
                    'type_description_hash': hashes[topic],
                },
                'message_count': count,
            }
            for topic, count in counts.items()
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [FILE_NAME],
        'files': [{'path': FILE_NAME, **span()}],
        'custom_data': None,
        'ros_distro': CREATOR,
    }
