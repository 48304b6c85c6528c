# SPDX-License-Identifier: Apache-2.0
"""Write a rosbag2 folder as rosbag2 itself lays it out: metadata.yaml and one MCAP file.

Message definitions and type hashes come from rosbags' type store, the container from mcap. Offered
quality of service is stored, so that ``ros2 bag play`` latches the path.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import yaml

from otf_core.bags.cdr import SECOND_NS, encode_axes, encode_path, encode_points
from otf_core.bags.rosbag2_metadata import (
    CREATOR,
    Part,
    bag_metadata,
    channel_metadata,
    metadata_text,
)
from otf_core.bags.signal_messages import signal_messages
from otf_core.bags.topics import AXES, PATH, POINT, Topic
from otf_core.errors import ConfigError, InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.declared_signals import SignalSpec
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.signals import Signal

FILE_NAME = 'bag_0.mcap'
"""The same in every bag, so that equal content gives equal bytes."""


def write_recording(
    folder: Path,
    samples: Samples,
    path: NominalPath | None,
    overwrite: bool,
    signals: Mapping[SignalSpec, Signal] = MappingProxyType({}),
    axis_paths: Sequence[AxisPath] = (),
) -> None:
    """Write points, path and signals; see ``bag.write_bag``."""
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
            _write_files(new, samples, path, signals, axis_paths)
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


def _write_files(
    folder: Path,
    samples: Samples,
    path: NominalPath | None,
    signals: Mapping[SignalSpec, Signal],
    axis_paths: Sequence[AxisPath],
) -> None:
    from mcap.writer import CompressionType, Writer  # with rosbags: 0.2 s only writers pay
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    # a log time is unsigned; stamps may have any epoch
    log_time = np.maximum(samples.stamp_ns, 0).tolist()
    beside = signal_messages(signals, store)
    driven = _driven(path, axis_paths, int(samples.stamp_ns[0]))
    counts = Counter(topic for topic, _ in driven) + Counter({POINT: len(samples)})
    counts += Counter(topic for _, topic, _ in beside)
    hashes = {topic: store.hash_rihs01(topic.type) for topic in counts}
    start, end = (
        f([log_time[k], *(beside[k][0] for _ in beside[:1])]) for f, k in ((min, 0), (max, -1))
    )
    part = Part(FILE_NAME, max(start, 0), end, counts)
    metadata = bag_metadata([part], hashes)
    with (folder / FILE_NAME).open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile='ros2', library=CREATOR)
        channels = {}
        for topic in counts:
            text, _ = store.generate_msgdef(topic.type, ros_version=2)
            schema = writer.register_schema(topic.type, 'ros2msg', text.encode())
            about = channel_metadata(topic)
            channels[topic] = writer.register_channel(topic.name, 'cdr', schema, about)
        for topic, first in driven:
            writer.add_message(channels[topic], log_time[0], first, log_time[0])
        for time, topic, data in _in_order(samples, log_time, beside):
            writer.add_message(channels[topic], time, data, time)
        inner = yaml.safe_dump(metadata, sort_keys=False)
        writer.add_metadata('rosbag2', {'serialized_metadata': inner})
        writer.finish()  # type: ignore[no-untyped-call]
    (folder / 'metadata.yaml').write_text(metadata_text(metadata), encoding='utf-8')


def _driven(
    path: NominalPath | None, axis_paths: Sequence[AxisPath], stamp_ns: int
) -> list[tuple[Topic, bytes]]:
    """Messages that say what was driven."""
    found = [(AXES, encode_axes(p.axes, p.positions, stamp_ns, p.target)) for p in axis_paths]
    if path is not None:
        found.insert(0, (PATH, encode_path(path.points, stamp_ns, PATH.frame)))
    return found


def _in_order(
    samples: Samples, log_time: list[int], beside: list[tuple[int, Topic, bytes]]
) -> Iterator[tuple[int, Topic, bytes]]:
    """Points and signals as they come: log time in ns, topic, serialized message."""
    rows = encode_points(samples.stamp_ns, samples.xyz, POINT.frame)
    data, width = rows.tobytes(), rows.dtype.itemsize
    next_beside = 0
    for i, time in enumerate(log_time):
        while next_beside < len(beside) and beside[next_beside][0] <= time:
            stamp, topic, message = beside[next_beside]
            yield max(stamp, 0), topic, message
            next_beside += 1
        yield time, POINT, data[i * width : (i + 1) * width]
    yield from beside[next_beside:]
