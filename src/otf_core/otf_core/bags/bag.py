# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS.

A bag is a rosbag2 folder or an .mcap file with the topics ``/tracker/point``
(geometry_msgs/msg/PointStamped in frame ``tracker``, header.stamp is the time of measurement) and
``/planner/path`` (nav_msgs/msg/Path in frame ``machine``). Any other topics are skipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.bag_writer import write_recording
from otf_core.bags.cdr import decode_path, decode_points
from otf_core.bags.column import Column
from otf_core.bags.mcap_messages import MessageBlock
from otf_core.bags.sample_order import in_time_order, usable_path
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath


@dataclass(frozen=True)
class BagContent:
    """What a bag says.

    Attributes
    ----------
    samples : Samples
        Stamps strictly increase.
    path : NominalPath
    """

    samples: Samples
    path: NominalPath


def read_bag(source: str | Path) -> BagContent:
    """Read points and path.

    Points are taken in the order of reception (log time) and then put in the order of their own
    stamps, see ``sample_order.in_time_order``. A path that was published several times must be
    the same each time.

    Parameters
    ----------
    source : str or Path
        A rosbag2 folder (any number of parts, any storage or compression that rosbags reads), a
        folder with a single .mcap file, or an .mcap file.

    Raises
    ------
    ConfigError
        If the source does not exist or is by its kind no bag.
    InputError
        If the bag is damaged, cut off or does not hold usable points and one usable path; the
        message says what, where and what to do.
    """
    reading = BagReading(source, (POINT, PATH))
    reading.require(POINT, PATH)
    return BagContent(reading.samples(), reading.path())


def read_points(source: str | Path) -> Samples:
    """Read the points of a bag that may lack a path; otherwise as ``read_bag``."""
    reading = BagReading(source, (POINT,))
    reading.require(POINT)
    return reading.samples()


def write_bag(folder: str | Path, content: BagContent, *, overwrite: bool = False) -> None:
    """Write a rosbag2 folder (metadata.yaml and one MCAP file with zstd chunks).

    The path comes first, then every point with its stamp as log time. The same content gives the
    same bytes. The folder appears under its name only when it is complete.

    Parameters
    ----------
    folder : str or Path
        The new bag; missing parent folders are made.
    content : BagContent
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
    checked = in_time_order(f'{folder}: samples', samples.stamp_ns, samples.xyz)
    if not np.array_equal(checked.stamp_ns, samples.stamp_ns):
        raise InputError(f'{folder}: stamps of samples to write have to increase strictly')
    usable_path(f'{folder}: path', content.path.points)
    write_recording(Path(folder), samples, content.path, overwrite)


@dataclass(frozen=True)
class Received:
    """Points as they were received.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        As stamped by the tracker.
    xyz : ndarray, shape (n, 3), m
    log_time : ndarray of int64, shape (n,), ns
        When they were recorded; ascending.
    """

    stamp_ns: NDArray[np.int64]
    xyz: NDArray[np.float64]
    log_time: NDArray[np.int64]


class BagReading:
    """Raw points and paths of the wanted topics of one bag, as far as it holds them.

    Attributes
    ----------
    topics : dict of topic to message type
        All that are in the bag.
    """

    def __init__(self, source: str | Path, wanted: tuple[Topic, ...]) -> None:
        self._where = str(source)
        self._stamp_ns = Column(np.empty(0, np.int64))
        self._xyz = Column(np.empty((0, 3)))
        self._log_time = Column(np.empty(0, np.int64))
        self._paths: list[NDArray[np.float64]] = []
        self._last_path: bytes | None = None
        self._points = 0
        self.topics: dict[str, str] = {}
        for block in locate(source).messages({t.name: t.type for t in wanted}, self.topics):
            try:
                self._add(block)
            except InputError as error:
                raise InputError(f'{self._where}: {block.topic}: {error}') from None

    def require(self, *wanted: Topic) -> None:
        """Refuse a bag without these topics; InputError names those that it has."""
        for topic in wanted:
            if topic.name not in self.topics:
                listed = ', '.join(f'{n} ({t})' for n, t in sorted(self.topics.items())) or 'none'
                raise InputError(
                    f'{self._where}: topic {topic.name} is missing; topics in the bag: {listed}; '
                    f'record it or remap to that name'
                )

    def _add(self, block: MessageBlock) -> None:
        if block.topic == POINT.name:
            stamp_ns, xyz = decode_points(
                block.buffer, block.start, block.size, POINT.frame, self._points
            )
            self._stamp_ns.add(stamp_ns)
            self._xyz.add(xyz)
            self._log_time.add(block.log_time)
            self._points += stamp_ns.size
            return
        for start, size in zip(block.start.tolist(), block.size.tolist(), strict=True):
            data = bytes(block.buffer[start : start + size])
            if data == self._last_path:
                continue
            self._last_path = data
            points = decode_path(data, PATH.frame)
            if not any(np.array_equal(points, known, equal_nan=True) for known in self._paths):
                self._paths.append(points)

    def received(self) -> Received:
        """Return the points in the order of reception; they are not kept."""
        log_time = self._log_time.joined()
        as_received = bool(np.all(log_time[1:] >= log_time[:-1]))
        stamp_ns, xyz = self._stamp_ns.joined(), self._xyz.joined()
        if as_received:
            return Received(stamp_ns, xyz, log_time)
        order = np.argsort(log_time, kind='stable')
        return Received(stamp_ns[order], xyz[order], log_time[order])

    def samples(self) -> Samples:
        """Return the points in time order; they are not kept."""
        points = self.received()
        return in_time_order(f'{self._where}: {POINT.name}', points.stamp_ns, points.xyz)

    def path(self) -> NominalPath:
        """Return the only path."""
        where = f'{self._where}: {PATH.name}'
        if not self._paths:
            raise InputError(f'{where}: no path was published while it was recorded')
        if len(self._paths) > 1:
            raise InputError(
                f'{where}: {len(self._paths)} different paths were published; '
                f'record each run in its own bag'
            )
        return usable_path(where, self._paths[0])
