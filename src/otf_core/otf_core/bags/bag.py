# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS.

A bag is a rosbag2 folder or an .mcap file with the topics ``/tracker/point``
(geometry_msgs/msg/PointStamped in frame ``tracker``, header.stamp is the time of measurement) and
``/planner/path`` (nav_msgs/msg/Path in frame ``machine``). Any other topics are skipped. Poses and
transforms do for points; topics of other names are taken where they are named, in any frame.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.bag_writer import write_recording
from otf_core.bags.cdr import FORMS, POINT_FORM, decode_path, decode_points, form_of
from otf_core.bags.column import Column
from otf_core.bags.mcap_messages import MessageBlock
from otf_core.bags.sample_order import in_time_order, usable_path
from otf_core.bags.screening import Screening
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import InputError
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BagContent:
    """What a bag says.

    Attributes
    ----------
    samples : Samples
        Stamps strictly increase.
    path : NominalPath
    remarks : tuple of str
        What was repaired or left out, in words.
    """

    samples: Samples
    path: NominalPath
    remarks: tuple[str, ...] = ()


def read_bag(
    source: str | Path, *, recover: bool = False, point: Topic = POINT, path: Topic = PATH
) -> BagContent:
    """Read points and path.

    Points are taken in the order of reception (log time) and then put in the order of their own
    stamps, see ``sample_order.in_time_order``. A path that was published several times must be
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
        See ``topics.called`` for other names.

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
    alone = len(sources) == 1
    parts = [BagReading(s, point, path, recover=recover) for s in sources]
    for part in parts:
        part.require(*((point, path) if alone else (point,)))
    where = str(sources[0]) if alone else f'{sources[0]} and {len(sources) - 1} more'
    remarks = [text for part in parts for text in part.remarks]
    samples = samples_of(where, parts, remarks)
    for text in remarks:
        _log.warning('%s: %s', where, text)
    return BagContent(samples, path_of(where, parts), tuple(remarks))


def read_points(source: str | Path, *, recover: bool = False, point: Topic = POINT) -> Samples:
    """Read the points of a bag that may lack a path; otherwise as ``read_bag``."""
    part = BagReading(source, point, None, recover=recover)
    part.require(point)
    remarks = list(part.remarks)
    samples = samples_of(str(source), [part], remarks)
    for text in remarks:
        _log.warning('%s: %s', source, text)
    return samples


def samples_of(where: str, parts: Sequence[Reading], remarks: list[str]) -> Samples:
    """Join the points of parts; ``remarks`` is filled with what was repaired or left out."""
    raw = sorted((part.received() for part in parts), key=lambda r: r.stamp_ns[:1].tolist())
    stamp_ns, xyz = (
        raw[0].stamp_ns if len(raw) == 1 else np.concatenate([r.stamp_ns for r in raw]),
        raw[0].xyz if len(raw) == 1 else np.concatenate([r.xyz for r in raw]),
    )
    screening = Screening()
    screening.foreign(sum((part.foreign for part in parts), Counter()))
    return in_time_order(f'{where}: {parts[0].point.name}', stamp_ns, xyz, remarks, screening)


def path_of(where: str, parts: Sequence[Reading]) -> NominalPath:
    """Return the path, if it is always the same."""
    where = f'{where}: {parts[0].path.name if parts[0].path else PATH.name}'
    paths = _different([corners for part in parts for corners in part.paths])
    if not paths:
        raise InputError(f'{where}: no path was published while it was recorded')
    if len(paths) > 1:
        raise InputError(
            f'{where}: {len(paths)} different paths were published; record each run in its own bag'
        )
    return usable_path(where, paths[0])


def _different(paths: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Leave out what repeats."""
    found: list[NDArray[np.float64]] = []
    for path in paths:
        if not any(np.array_equal(path, known, equal_nan=True) for known in found):
            found.append(path)
    return found


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
    remarks: list[str] = []
    in_time_order(f'{folder}: samples', samples.stamp_ns, samples.xyz, remarks)
    if not np.all(samples.stamp_ns[1:] > samples.stamp_ns[:-1]):
        raise InputError(f'{folder}: stamps of samples to write have to increase strictly')
    if remarks:
        raise InputError(f'{folder}: samples would not be read as they are: {remarks[0]}')
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


class Reading(Protocol):
    """Points and paths of a recording as they were received, a bag or not."""

    point: Topic
    path: Topic | None
    paths: list[NDArray[np.float64]]
    foreign: Counter[str]

    def received(self) -> Received:
        """Return the points in the order of reception; they need not be kept."""


class BagReading:
    """Raw points and paths of one bag, as far as it holds them.

    Parameters
    ----------
    source : str or Path
    point : Topic
    path : Topic, optional
    recover : bool
        See ``read_bag``.

    Attributes
    ----------
    topics : dict of topic to message type
        All that are in the bag.
    paths : list of ndarray, shape (n, 3), m
        Different ones.
    remarks : list of str
        What was left out.
    foreign : Counter of str
        Points left out for their frame, by frame_id.
    said : list of str
        How it was read, where that is not as usual.
    """

    def __init__(
        self,
        source: str | Path,
        point: Topic = POINT,
        path: Topic | None = PATH,
        *,
        recover: bool = False,
    ) -> None:
        self._where, self.point, self.path = str(source), point, path
        self._stamp_ns = Column(np.empty(0, np.int64))
        self._xyz = Column(np.empty((0, 3)))
        self._log_time = Column(np.empty(0, np.int64))
        self._last_path: bytes | None = None
        self._points = 0
        self._frame, self._form = point.frame, POINT_FORM
        self.topics: dict[str, str] = {}
        self.paths: list[NDArray[np.float64]] = []
        self.remarks: list[str] = []
        self.said: list[str] = []
        self.foreign: Counter[str] = Counter()
        types: dict[str, tuple[str, ...]] = {point.name: tuple(FORMS)}
        types |= {} if path is None else {path.name: (path.type,)}
        messages = locate(source).messages(types, self.topics, self.remarks, recover=recover)
        for block in messages:
            try:
                self._add(block)
            except InputError as error:
                raise InputError(f'{self._where}: {block.topic}: {error}') from None

    def require(self, *wanted: Topic) -> None:
        """Refuse a bag without these topics; InputError names those that it has."""
        for topic in wanted:
            if topic.name not in self.topics:
                listed = ', '.join(f'{n} ({t})' for n, t in sorted(self.topics.items())) or 'none'
                option = '--topic' if topic is self.point else '--path-topic'
                advice = f'record it, remap to that name, or name another one ({option})'
                raise InputError(
                    f'{self._where}: topic {topic.name} is missing; topics in the bag: {listed}; '
                    + ('; '.join(self.remarks) or advice)
                )

    def _add(self, block: MessageBlock) -> None:
        if block.topic == self.point.name:
            self._add_points(block)
            return
        assert self.path is not None
        for start, size in zip(block.start.tolist(), block.size.tolist(), strict=True):
            data = bytes(block.buffer[start : start + size])
            if data == self._last_path:
                continue
            self._last_path = data
            self.paths = _different([*self.paths, decode_path(data, self.path.frame)])

    def _add_points(self, block: MessageBlock) -> None:
        if not self._points and block.start.size:
            first = slice(block.start[0], block.start[0] + block.size[0])
            kind = self.topics[self.point.name]
            if kind != self.point.type or not self.point.frame:
                self._form, frame = form_of(kind, bytes(block.buffer[first]))
                self._frame = self.point.frame or frame
                self.said.append(f'{self.point.name}: {kind} in frame {self._frame!r}')
        points = decode_points(
            block.buffer, block.start, block.size, self._frame, self._points, self._form
        )
        self._stamp_ns.add(points.stamp_ns)
        self._xyz.add(points.xyz)
        kept = slice(None) if points.kept is None else points.kept
        self._log_time.add(block.log_time[kept])
        self.foreign.update(points.foreign)
        self._points += block.start.size

    def received(self) -> Received:
        """Return the points in the order of reception; they are not kept."""
        log_time = self._log_time.joined()
        as_received = bool(np.all(log_time[1:] >= log_time[:-1]))
        stamp_ns, xyz = self._stamp_ns.joined(), self._xyz.joined()
        if as_received:
            return Received(stamp_ns, xyz, log_time)
        order = np.argsort(log_time, kind='stable')
        return Received(stamp_ns[order], xyz[order], log_time[order])
