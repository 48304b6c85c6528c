# SPDX-License-Identifier: Apache-2.0
"""Points and paths of one bag as they were recorded, as far as it holds them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otf_core.bags.bag_source import locate
from otf_core.bags.cdr import FORMS, POINT_FORM, decode_axes, decode_path, decode_points, form_of
from otf_core.bags.mcap_messages import MessageBlock
from otf_core.bags.rosbag2_metadata import AXES, PATH, POINT, Topic
from otf_core.bags.sample_order import usable_path
from otf_core.errors import InputError
from otf_core.files.text_table import SkippedLines
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import TOOL
from otf_core.model.path import NominalPath


@dataclass(frozen=True)
class ReceivedPoints:
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


class Reading(ABC):
    """Points and paths of a recording as they were received, a bag or not.

    Attributes
    ----------
    point, path : Topic
        What they are called in messages; no path: none is wanted.
    topics : dict of topic to message type
        All that are in a bag.
    paths : list of ndarray, shape (n, 3), m
        Different ones.
    axis_paths : list of AxisPath
        Parts of a run of a machine with rotary axes, as they come.
    remarks : list of str
        What was left out.
    foreign : Counter of str
        Points left out for their frame, by frame_id.
    left_out : list of SkippedLines
        Lines of a text that are not samples, by reason.
    said : list of str
        How it was read, where that is not as usual.
    """

    def __init__(self, source: str | Path, point: Topic, path: Topic | None) -> None:
        self._where, self.point, self.path = str(source), point, path
        self.topics: dict[str, str] = {}
        self.paths: list[NDArray[np.float64]] = []
        self.axis_paths: list[AxisPath] = []
        self.remarks: list[str] = []
        self.left_out: list[SkippedLines] = []
        self.said: list[str] = []
        self.foreign: Counter[str] = Counter()

    @abstractmethod
    def require(self, *wanted: Topic) -> None:
        """Refuse a recording without these topics."""

    @abstractmethod
    def received(self) -> ReceivedPoints:
        """Return the points in the order of reception."""


class BagReading(Reading):
    """Raw points and paths of one bag, as far as it holds them; ``recover``: see ``read_bag``."""

    def __init__(
        self,
        source: str | Path,
        point: Topic = POINT,
        path: Topic | None = PATH,
        *,
        recover: bool = False,
    ) -> None:
        super().__init__(source, point, path)
        none = np.empty(0, np.int64)
        self._received = [(none, np.empty((0, 3)), none)]
        self._last_path: bytes | None = None
        self._cleared = self._points = 0
        self._frame, self._form = point.frame, POINT_FORM
        types: dict[str, tuple[str, ...]] = {point.name: tuple(FORMS)}
        types |= {} if path is None else {path.name: (path.type,), AXES.name: (AXES.type,)}
        add = {AXES.name: self._add_axes, point.name: self._add_points}
        for block in locate(source).messages(types, self.topics, self.remarks, recover=recover):
            try:
                add.get(block.topic, self._add_paths)(block)
            except InputError as error:
                raise InputError(f'{self._where}: {block.topic}: {error}') from None
        if self._cleared and path is not None:
            self.remarks.append(
                f'{self._cleared} messages of {path.name} have no points, as when a planner '
                f'clears its path; they are left out'
            )

    def require(self, *wanted: Topic) -> None:
        """Refuse a bag without these topics; InputError names those that it has."""
        for topic in wanted:
            if topic.name not in self.topics:
                listed = ', '.join(f'{n} ({t})' for n, t in sorted(self.topics.items())) or 'none'
                key = 'topic' if topic is self.point else 'path_topic'
                suited = FORMS if topic is self.point else (topic.type,)
                another = ' or '.join(f'{key}: {name}' for name in self._suited(suited)[:3])
                advice = (
                    f'read another one, with --config: {another}'
                    if another
                    else f'record it, or remap to that name a topic of type {" or ".join(suited)}'
                )
                raise InputError(
                    f'{self._where}: topic {topic.name} is missing; topics in the bag: {listed}; '
                    + ('; '.join(self.remarks) or advice)
                )

    def _suited(self, types: Collection[str]) -> list[str]:
        """Topics of some types, but those that otf itself publishes beside samples and path."""
        own = '/calibrator/'
        return [n for n, kind in sorted(self.topics.items())
                if kind in types and not n.startswith(own)]  # fmt: skip

    def only_topic(self, types: Collection[str]) -> str | None:
        """Return the one topic of some types; None if there are others."""
        names = self._suited(types)
        return names[0] if len(names) == 1 else None

    def _add_paths(self, block: MessageBlock) -> None:
        assert self.path is not None
        for _, data in block:
            if data == self._last_path:
                continue
            self._last_path = data
            path = decode_path(data, self.path.frame)
            if len(path):
                self.paths = drop_repetitions([*self.paths, path])
            else:
                self._cleared += 1

    def _add_axes(self, block: MessageBlock) -> None:
        for _, data in block:
            frame, names, positions = decode_axes(data)
            if len(positions):
                self.axis_paths.append(AxisPath(names, positions, frame or TOOL))

    def _add_points(self, block: MessageBlock) -> None:
        if not self._points and block.start.size:
            kind = self.topics[self.point.name]
            if kind != self.point.type or not self.point.frame:
                self._form, frame = form_of(kind, next(iter(block))[1])
                self._frame = self.point.frame or frame
                self.said.append(f'{self.point.name}: {kind} in frame {self._frame!r}')
        points = decode_points(
            block.buffer, block.start, block.size, self._frame, self._points, self._form
        )
        rows = slice(None) if points.kept is None else points.kept
        self._received.append((points.stamp_ns, points.xyz, block.log_time[rows]))
        self.foreign.update(points.foreign)
        self._points += block.start.size

    def received(self) -> ReceivedPoints:
        """Return the points in the order of reception."""
        columns = zip(*self._received, strict=True)
        stamp_ns, xyz, log_time = (np.concatenate(column) for column in columns)
        if np.all(log_time[1:] >= log_time[:-1]):
            return ReceivedPoints(stamp_ns, xyz, log_time)
        order = np.argsort(log_time, kind='stable')
        return ReceivedPoints(stamp_ns[order], xyz[order], log_time[order])


def path_of(where: str, parts: Sequence[Reading]) -> NominalPath:
    """Return the path, if it is always the same."""
    where = f'{where}: {parts[0].path.name if parts[0].path else PATH.name}'
    paths = drop_repetitions([corners for part in parts for corners in part.paths])
    if not paths:
        raise InputError(
            f'{where}: no path with points was published while it was recorded; give the one that '
            f'was driven: --path FILE (plan.json, CSV x,y,z or NC program)'
        )
    if len(paths) > 1:
        raise InputError(
            f'{where}: {len(paths)} different paths were published; give the one that '
            f'was driven: --path FILE (plan.json, CSV x,y,z or NC program)'
        )
    return usable_path(where, paths[0])


def drop_repetitions(paths: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Leave out what repeats."""
    distinct: list[NDArray[np.float64]] = []
    for path in paths:
        if not any(np.array_equal(path, known, equal_nan=True) for known in distinct):
            distinct.append(path)
    return distinct
