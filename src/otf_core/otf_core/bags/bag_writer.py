# SPDX-License-Identifier: Apache-2.0
"""Write a rosbag2 folder as rosbag2 itself lays it out: metadata.yaml and one MCAP file.

Message definitions and type hashes come from rosbags' type store, the container from mcap. Offered
quality of service is stored, so that ``ros2 bag play`` latches the path.
"""

from __future__ import annotations

import os
import shutil
import uuid
from pathlib import Path

import numpy as np
import yaml

from otf_core.bags.cdr import SECOND_NS, encode_path, encode_points
from otf_core.bags.rosbag2_metadata import (
    CREATOR,
    Part,
    bag_metadata,
    channel_metadata,
    metadata_text,
)
from otf_core.bags.topics import PATH, POINT
from otf_core.errors import ConfigError, InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

FILE_NAME = 'bag_0.mcap'
"""The same in every bag, so that equal content gives equal bytes."""


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
    part = Part(FILE_NAME, log_time[0], log_time[-1], {PATH: 1, POINT: len(samples)})
    metadata = bag_metadata([part], hashes)
    with (folder / FILE_NAME).open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile='ros2', library=CREATOR)
        channels = []
        for topic in (PATH, POINT):
            text, _ = store.generate_msgdef(topic.type, ros_version=2)
            schema = writer.register_schema(topic.type, 'ros2msg', text.encode())
            about = channel_metadata(topic)
            channels.append(writer.register_channel(topic.name, 'cdr', schema, about))
        first = encode_path(path.points, int(samples.stamp_ns[0]), PATH.frame)
        writer.add_message(channels[0], log_time[0], first, log_time[0])
        rows = encode_points(samples.stamp_ns, samples.xyz, POINT.frame)
        data, width = rows.tobytes(), rows.dtype.itemsize
        for i, time in enumerate(log_time):
            writer.add_message(channels[1], time, data[i * width : (i + 1) * width], time)
        inner = yaml.safe_dump(metadata, sort_keys=False)
        writer.add_metadata('rosbag2', {'serialized_metadata': inner})
        writer.finish()  # type: ignore[no-untyped-call]
    (folder / 'metadata.yaml').write_text(metadata_text(metadata), encoding='utf-8')
