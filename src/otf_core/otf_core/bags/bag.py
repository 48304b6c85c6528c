# SPDX-License-Identifier: Apache-2.0
"""Bags: tracker points and nominal path from and to rosbag2 recordings, without ROS.

A bag is a rosbag2 folder or an .mcap file with the topics ``/tracker/point``
(geometry_msgs/msg/PointStamped in frame ``tracker``, header.stamp is the time of measurement) and
``/planner/path`` (nav_msgs/msg/Path in frame ``machine``). Any other topics are skipped.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
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


def read_bag(source: str | Path, *, recover: bool = False) -> BagContent:
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

    Raises
    ------
    ConfigError
        If the source does not exist or is by its kind no bag.
    InputError
        If the bag is damaged or does not hold usable points and one usable path; the message says
        what, where and what to do.
    """
    return read_parts([source], recover=recover)


def read_parts(sources: Sequence[str | Path], *, recover: bool = False) -> BagContent:
    """Read bags that are parts of one run, in any order, as if they were one bag.

    Every part has points; the path stands in one of them at least, the same in all that have it.
    """
    alone = len(sources) == 1
    parts = [_Recording(s, (POINT, PATH), (POINT, PATH) if alone else (POINT,), recover)
             for s in sources]  # fmt: skip
    where = str(sources[0]) if alone else f'{sources[0]} and {len(sources) - 1} more'
    remarks = [text for part in parts for text in part.remarks]
    samples = _in_order(where, parts, remarks)
    path = _only_path(where, [corners for part in parts for corners in part.paths])
    return BagContent(samples, path, tuple(remarks))


def read_points(source: str | Path, *, recover: bool = False) -> Samples:
    """Read the points of a bag that may lack a path; otherwise as ``read_bag``."""
    part = _Recording(source, (POINT,), (POINT,), recover)
    return _in_order(str(source), [part], part.remarks)


def _in_order(where: str, parts: list[_Recording], remarks: list[str]) -> Samples:
    """Join the points of parts; the log says what was repaired or left out."""
    raw = [part.points() for part in parts]
    raw.sort(key=lambda columns: columns[0][:1].tolist())
    stamp_ns, xyz = raw[0] if len(raw) == 1 else tuple(map(np.concatenate, zip(*raw, strict=True)))
    screening = Screening()
    screening.foreign(sum((part.foreign for part in parts), Counter()))
    samples = in_time_order(f'{where}: {POINT.name}', stamp_ns, xyz, remarks, screening)
    for text in remarks:
        _log.warning('%s: %s', where, text)
    return samples


def _only_path(where: str, paths: list[NDArray[np.float64]]) -> NominalPath:
    """Return the path, if it is always the same."""
    where = f'{where}: {PATH.name}'
    if not paths:
        raise InputError(f'{where}: no path was published while it was recorded')
    different = _different(paths)
    if len(different) > 1:
        raise InputError(
            f'{where}: {len(different)} different paths were published; '
            f'record each run in its own bag'
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


class _Recording:
    """Raw points and paths of one bag.

    Attributes
    ----------
    paths : list of ndarray, shape (n, 3), m
        Different ones.
    remarks : list of str
        What was left out.
    foreign : Counter of str
        Points left out for their frame, by frame_id.
    """

    def __init__(
        self,
        source: str | Path,
        wanted: tuple[Topic, ...],
        needed: tuple[Topic, ...],
        recover: bool,
    ) -> None:
        self._where = str(source)
        self._stamp_ns = Column(np.empty(0, np.int64))
        self._xyz = Column(np.empty((0, 3)))
        self._log_time = Column(np.empty(0, np.int64))
        self.paths: list[NDArray[np.float64]] = []
        self.remarks: list[str] = []
        self._last_path: bytes | None = None
        self._points = 0
        self.foreign: Counter[str] = Counter()
        found: dict[str, str] = {}
        types = {t.name: t.type for t in wanted}
        for block in locate(source).messages(types, found, self.remarks, recover=recover):
            try:
                self._add(block)
            except InputError as error:
                raise InputError(f'{self._where}: {block.topic}: {error}') from None
        for topic in needed:
            if topic.name not in found:
                listed = ', '.join(f'{n} ({t})' for n, t in sorted(found.items())) or 'none'
                raise InputError(
                    f'{self._where}: topic {topic.name} is missing; topics in the bag: {listed}; '
                    + ('; '.join(self.remarks) or 'record it or remap to that name')
                )

    def _add(self, block: MessageBlock) -> None:
        if block.topic == POINT.name:
            points = decode_points(
                block.buffer, block.start, block.size, POINT.frame, self._points
            )
            self._stamp_ns.add(points.stamp_ns)
            self._xyz.add(points.xyz)
            kept = slice(None) if points.kept is None else points.kept
            self._log_time.add(block.log_time[kept])
            self.foreign.update(points.foreign)
            self._points += block.start.size
            return
        for start, size in zip(block.start.tolist(), block.size.tolist(), strict=True):
            data = bytes(block.buffer[start : start + size])
            if data == self._last_path:
                continue
            self._last_path = data
            self.paths = _different([*self.paths, decode_path(data, PATH.frame)])

    def points(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return stamps and points in the order of reception; the recording keeps none."""
        log_time = self._log_time.joined()
        as_received = bool(np.all(log_time[1:] >= log_time[:-1]))
        order = None if as_received else np.argsort(log_time, kind='stable')
        del log_time
        stamp_ns, xyz = self._stamp_ns.joined(), self._xyz.joined()
        if order is not None:
            stamp_ns, xyz = stamp_ns[order], xyz[order]
        return stamp_ns, xyz
