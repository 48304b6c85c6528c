# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS."""

from __future__ import annotations

import logging
import os
import shutil
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
import yaml

from otf_core.bags.bag_reading import BagReading, Reading, path_of
from otf_core.bags.bag_signals import signal_messages
from otf_core.bags.cdr import SECOND_NS, encode_axes, encode_path, encode_points
from otf_core.bags.rosbag2_metadata import (
    AXES,
    CREATOR,
    PATH,
    POINT,
    Part,
    Topic,
    bag_metadata,
    channel_metadata,
    metadata_text,
)
from otf_core.bags.sample_order import Screening, sort_by_time, usable_path
from otf_core.errors import ConfigError, InputError
from otf_core.files.text_table import SkippedLines
from otf_core.files.writing import unwritable
from otf_core.model.axis_path import AxisPath, PartsTrack
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.sections import SignalSpec
from otf_core.model.signals import Signal

# Write a rosbag2 folder as rosbag2 itself lays it out: metadata.yaml and one MCAP file.
#
# Message definitions and type hashes come from rosbags' type store, the container from mcap.
# Offered quality of service is stored, so that ``ros2 bag play`` latches the path.

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
        raise unwritable(folder, error) from None


def _check_target(folder: Path, overwrite: bool) -> None:
    if not os.path.lexists(folder):
        return
    if not overwrite:
        raise ConfigError(f'{folder}: exists already; choose another name or remove it')
    replaceable = folder.is_dir() and not folder.is_symlink()
    if not replaceable or not ((folder / 'metadata.yaml').is_file() or not any(folder.iterdir())):
        raise ConfigError(f'{folder}: is not a bag and is not overwritten; choose another name')


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


def write_axis_paths(file: Path, axis_paths: Sequence[AxisPath]) -> None:
    """Write the parts of a path alone as an MCAP file, one message each; no stamps."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with file.open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile='ros2', library=CREATOR)
        text, _ = store.generate_msgdef(AXES.type, ros_version=2)
        schema = writer.register_schema(AXES.type, 'ros2msg', text.encode())
        channel = writer.register_channel(AXES.name, 'cdr', schema, channel_metadata(AXES))
        for _, message in _driven(None, axis_paths, 0):
            writer.add_message(channel, 0, message, 0)
        writer.finish()  # type: ignore[no-untyped-call]


def _driven(
    path: NominalPath | None, axis_paths: Sequence[AxisPath], stamp_ns: int
) -> list[tuple[Topic, bytes]]:
    """Messages that say what was driven."""
    messages = [(AXES, encode_axes(p.axes, p.positions, stamp_ns, p.target)) for p in axis_paths]
    if path is not None:
        messages.insert(0, (PATH, encode_path(path.points, stamp_ns, PATH.frame)))
    return messages


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


# Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS.
#
# A bag is a rosbag2 folder or an .mcap file with the topics ``/tracker/point``
# (geometry_msgs/msg/PointStamped in frame ``tracker``, header.stamp is the time of measurement)
# and ``/planner/path`` (nav_msgs/msg/Path in frame ``machine``). Any other topics are skipped.
# Poses and transforms do for points; topics of other names are taken where they are named, in any
# frame.

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BagContent:
    """What a bag says.

    Attributes
    ----------
    path : NominalPath, optional
        As published; of the track of parts (to be written) their axis positions are.
    samples : Samples
        Stamps strictly increase.
    remarks : tuple of str
        What was repaired or left out, in words.
    left_out : tuple of SkippedLines
        Lines of a text that are not samples, by reason.
    signals : mapping of SignalSpec to Signal
        To be written beside them; reading is ``signals.read_signals``.
    axis_paths : tuple of AxisPath
        Parts of a run of a machine with rotary axes.
    """

    samples: Samples
    path: NominalPath | None
    remarks: tuple[str, ...] = ()
    signals: Mapping[SignalSpec, Signal] = field(default_factory=dict)
    left_out: tuple[SkippedLines, ...] = ()
    axis_paths: tuple[AxisPath, ...] = ()


def read_bag(
    source: str | Path, *, recover: bool = False, point: Topic = POINT, path: Topic = PATH
) -> BagContent:
    """Read points and path.

    Points are taken in the order of reception (log time) and then put in the order of their own
    stamps, see ``sample_order.sort_by_time``. A path that was published several times must be
    the same each time.

    Parameters
    ----------
    source : str or Path
        A rosbag2 folder (any number of parts, any storage or compression that rosbags reads), a
        folder with a single .mcap file or numbered parts, or an .mcap file. An MCAP file that is
        cut off or still being recorded is read to its last complete chunk.
    recover : bool
        Leave out damaged chunks inside an MCAP file as well, instead of refusing the bag.
    point, path : Topic
        See ``rosbag2_metadata.rename_topic`` for other names.

    Raises
    ------
    ConfigError
        If the source does not exist or is by its kind no bag.
    InputError
        If the bag is damaged or does not hold usable points and one usable path; the message says
        what, where and what to do.
    """
    return read_parts([source], recover=recover, point=point, path=path)


def read_parts(
    sources: Sequence[str | Path],
    *,
    recover: bool = False,
    point: Topic = POINT,
    path: Topic = PATH,
) -> BagContent:
    """Read bags that are parts of one run, in any order, as if they were one bag.

    Every part has points; the path stands in one of them at least, the same in all that have it.
    """
    return content_of([BagReading(s, point, path, recover=recover) for s in sources], sources)


def read_points(source: str | Path, *, recover: bool = False, point: Topic = POINT) -> Samples:
    """Read the points of a bag that may lack a path; otherwise as ``read_bag``."""
    return points_of(BagReading(source, point, None, recover=recover), source)


def content_of(
    parts: Sequence[Reading], sources: Sequence[str | Path], path: str | Path | None = None
) -> BagContent:
    """Join what was read of the parts of a run; the log says what was left out or taken for what.

    Parameters
    ----------
    parts : sequence of Reading
        Of each of the sources. A single one has to have a path if it may have one.
    path : str or Path, optional
        File that the path comes from, for messages.
    """
    for part in parts:
        part.require(part.point)
        if part.path is not None and len(parts) == 1 and not part.axis_paths:
            part.require(part.path)
    where = str(sources[0]) if len(sources) == 1 else f'{sources[0]} and {len(sources) - 1} more'
    samples, remarks = _join_parts(where, parts)
    left_out = tuple(lines for part in parts for lines in part.left_out)
    axis_paths = tuple(own for part in parts for own in part.axis_paths)
    driven = None
    if not axis_paths or any(part.paths for part in parts):
        driven = path_of(str(path or where), parts)
    return BagContent(samples, driven, tuple(remarks), left_out=left_out, axis_paths=axis_paths)


def points_of(part: Reading, source: str | Path) -> Samples:
    """Return the samples of one recording, whether it has a path or not; see ``content_of``."""
    part.require(part.point)
    return _join_parts(str(source), [part])[0]


def _join_parts(where: str, parts: Sequence[Reading]) -> tuple[Samples, list[str]]:
    """Samples of parts, and remarks; both kinds of words go to the log."""
    remarks = [text for part in parts for text in part.remarks]
    samples = samples_of(where, parts, remarks)
    for text in (said for part in parts for said in part.said):
        _log.info('%s: %s', where, text)
    for text in remarks:
        _log.warning('%s: %s', where, text)
    return samples, remarks


def samples_of(where: str, parts: Sequence[Reading], remarks: list[str]) -> Samples:
    """Join the points of parts; ``remarks`` is filled with what was repaired or left out."""
    raw = sorted((part.received() for part in parts), key=lambda r: r.stamp_ns[:1].tolist())
    stamp_ns, xyz = (
        raw[0].stamp_ns if len(raw) == 1 else np.concatenate([r.stamp_ns for r in raw]),
        raw[0].xyz if len(raw) == 1 else np.concatenate([r.xyz for r in raw]),
    )
    screening = Screening()
    screening.foreign(sum((part.foreign for part in parts), Counter()))
    return sort_by_time(f'{where}: {parts[0].point.name}', stamp_ns, xyz, remarks, screening)


def write_bag(folder: str | Path, content: BagContent, *, overwrite: bool = False) -> None:
    """Write a rosbag2 folder (metadata.yaml and one MCAP file with zstd chunks).

    The path comes first, then every point and signal with its stamp as log time. The same content
    gives the same bytes. The folder appears under its name only when it is complete.

    Parameters
    ----------
    folder : str or Path
        The new bag; missing parent folders are made.
    overwrite : bool
        Replace the folder if it is a bag or empty; never anything else.

    Raises
    ------
    ConfigError
        If the folder exists or cannot be written.
    InputError
        If the content is not what ``read_bag`` would give back unchanged.
    """
    samples = content.samples
    remarks: list[str] = []
    sort_by_time(f'{folder}: samples', samples.stamp_ns, samples.xyz, remarks)
    if not np.all(samples.stamp_ns[1:] > samples.stamp_ns[:-1]):
        raise InputError(f'{folder}: stamps of samples to write have to increase strictly')
    if remarks:
        raise InputError(f'{folder}: samples would not be read as they are: {remarks[0]}')
    path, parts = content.path, content.axis_paths
    if isinstance(path, PartsTrack):
        parts, path = path.parts, None
    if path is not None:
        usable_path(f'{folder}: path', path.points)
    elif not parts:
        raise InputError(f'{folder}: a bag needs a path')
    write_recording(Path(folder), samples, path, overwrite, content.signals, parts)
