# SPDX-License-Identifier: Apache-2.0
"""Points and paths of one bag as they were recorded, as far as it holds them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import decode_path, decode_points
from otf_core.bags.column import Column
from otf_core.bags.mcap_messages import MessageBlock
from otf_core.bags.sample_order import usable_path
from otf_core.bags.topics import PATH, POINT, Topic
from otf_core.errors import InputError
from otf_core.model.path import NominalPath

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Received:
    """Points in the order of reception.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,), ns
        As stamped by the tracker.
    xyz : ndarray, shape (n, 3), m
    log_time : ndarray of int64, shape (n,), ns
        When they were recorded; ascending.
    """

    stamp_ns: NDArray[np.int64]
    xyz: Array
    log_time: NDArray[np.int64]


class BagReading:
    """Raw points and paths of the wanted topics of one bag.

    Parameters
    ----------
    source : str or Path
        As of ``bag.read_bag``.
    wanted : tuple of Topic
    recover : bool
        Leave out damaged chunks inside an MCAP file.

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
    """

    def __init__(
        self, source: str | Path, wanted: tuple[Topic, ...], *, recover: bool = False
    ) -> None:
        self._where = str(source)
        self._stamp_ns = Column(np.empty(0, np.int64))
        self._xyz = Column(np.empty((0, 3)))
        self._log_time = Column(np.empty(0, np.int64))
        self._last_path: bytes | None = None
        self._points = 0
        self.paths: list[Array] = []
        self.remarks: list[str] = []
        self.foreign: Counter[str] = Counter()
        self.topics: dict[str, str] = {}
        types = {t.name: t.type for t in wanted}
        for block in locate(source).messages(types, self.topics, self.remarks, recover=recover):
            try:
                self._add(block)
            except InputError as error:
                raise InputError(f'{self._where}: {block.topic}: {error}') from None

    def require(self, *needed: Topic) -> None:
        """Refuse a bag without these topics; InputError names those that it has."""
        for topic in needed:
            if topic.name not in self.topics:
                listed = ', '.join(f'{n} ({t})' for n, t in sorted(self.topics.items())) or 'none'
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
            self.paths = different([*self.paths, decode_path(data, PATH.frame)])

    def received(self) -> Received:
        """Return the points; they are not kept."""
        log_time = self._log_time.joined()
        as_received = bool(np.all(log_time[1:] >= log_time[:-1]))
        stamp_ns, xyz = self._stamp_ns.joined(), self._xyz.joined()
        if as_received:
            return Received(stamp_ns, xyz, log_time)
        order = np.argsort(log_time, kind='stable')
        return Received(stamp_ns[order], xyz[order], log_time[order])

    def path(self) -> NominalPath:
        """Return the path, if it is always the same."""
        return only_path(self._where, self.paths)


def only_path(where: str, paths: list[Array]) -> NominalPath:
    """Return the one path that was published."""
    where = f'{where}: {PATH.name}'
    if not paths:
        raise InputError(f'{where}: no path was published while it was recorded')
    found = different(paths)
    if len(found) > 1:
        raise InputError(
            f'{where}: {len(found)} different paths were published; record each run in its own bag'
        )
    return usable_path(where, found[0])


def different(paths: list[Array]) -> list[Array]:
    """Leave out paths that repeat."""
    found: list[Array] = []
    for path in paths:
        if not any(np.array_equal(path, known, equal_nan=True) for known in found):
            found.append(path)
    return found
