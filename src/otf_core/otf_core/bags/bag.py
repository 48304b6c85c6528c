# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS."""

from __future__ import annotations

import logging
import os
import shutil
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import merge
from itertools import chain
from pathlib import Path

import numpy as np
import yaml

from otf_core.bags.bag_reading import BagReading, Reading, path_of
from otf_core.bags.bag_signals import signal_messages
from otf_core.bags.cdr import SECOND_NS, encode_axes, encode_path, encode_points
from otf_core.bags.rosbag2_metadata import (
    AXES,
    PATH,
    POINT,
    Part,
    Topic,
    bag_metadata,
    describe_topics,
    metadata_text,
    start_mcap,
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


def _write_files(folder: Path, content: BagContent) -> None:
    samples = content.samples
    # a log time is unsigned; stamps may have any epoch
    log_time = np.maximum(samples.stamp_ns, 0).tolist()
    rows = encode_points(samples.stamp_ns, samples.xyz, POINT.frame)
    points, width = rows.tobytes(), rows.dtype.itemsize
    driven = _driven(content.path, content.axis_paths, int(samples.stamp_ns[0]))
    messages = [(log_time[0], *m) for m in driven]
    beside = [
        (max(time, 0), topic, data) for time, topic, data in signal_messages(content.signals)
    ]
    each = ((t, POINT, points[i * width : (i + 1) * width]) for i, t in enumerate(log_time))
    definitions, hashes = describe_topics(
        dict.fromkeys([*(m[1] for m in messages), POINT, *(m[1] for m in beside)])
    )
    times = [*log_time[:: len(log_time) - 1], *(m[0] for m in beside)]
    counts = Counter({POINT: len(samples)}) + Counter(m[1] for m in [*messages, *beside])
    metadata = bag_metadata([Part(FILE_NAME, min(times), max(times), counts)], hashes)
    with (folder / FILE_NAME).open('wb') as stream:
        writer, channels = start_mcap(stream, definitions, data_crcs=True)
        in_order = merge(beside, each, key=lambda message: message[0])
        for time, topic, data in chain(messages, in_order):
            writer.add_message(channels[topic], time, data, time)
        inner = yaml.safe_dump(metadata, sort_keys=False)
        writer.add_metadata('rosbag2', {'serialized_metadata': inner})
        writer.finish()  # type: ignore[no-untyped-call]
    (folder / 'metadata.yaml').write_text(metadata_text(metadata), encoding='utf-8')


def write_axis_paths(file: Path, axis_paths: Sequence[AxisPath]) -> None:
    """Write the parts of a path alone as an MCAP file, one message each; no stamps."""
    with file.open('wb') as stream:
        writer, channels = start_mcap(stream, describe_topics([AXES])[0], data_crcs=True)
        for topic, message in _driven(None, axis_paths, 0):
            writer.add_message(channels[topic], 0, message, 0)
        writer.finish()  # type: ignore[no-untyped-call]


def _driven(
    path: NominalPath | None, axis_paths: Sequence[AxisPath], stamp_ns: int
) -> list[tuple[Topic, bytes]]:
    """Messages that say what was driven."""
    messages = [(AXES, encode_axes(p.axes, p.positions, stamp_ns, p.target)) for p in axis_paths]
    if path is not None:
        messages.insert(0, (PATH, encode_path(path.points, stamp_ns, PATH.frame)))
    return messages


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
    return content_of([BagReading(source, point, path, recover=recover)], [source])


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
    folder, samples = Path(os.path.abspath(folder)), content.samples
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
    content = replace(content, path=path, axis_paths=tuple(parts))
    for stamp in (samples.stamp_ns[0], samples.stamp_ns[-1]):
        if not -(2**31) <= stamp // SECOND_NS < 2**31:
            raise InputError(f'{folder}: stamp {stamp} ns does not fit into a ROS time')
    try:
        _check_target(folder, overwrite)
        folder.parent.mkdir(parents=True, exist_ok=True)
        new = folder.parent / f'.{folder.name}.{uuid.uuid4().hex}.new'
        new.mkdir()
        try:
            _write_files(new, content)
            _replace(new, folder)
        finally:
            shutil.rmtree(new, ignore_errors=True)
    except OSError as error:
        raise unwritable(folder, error) from None
