# SPDX-License-Identifier: Apache-2.0
"""Listens to a graph under faults: what was said, how long samples paused, what was lost."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.node import Node

from otf_core.model.path import NominalPath
from otf_msgs.msg import CalibrationResult, TrackerGap, TrackerStatus
from otf_ros import qos
from otf_ros.convert import ns_from_time, path_to_message
from otf_ros.drain import Drain

WORDS = 90
"""Characters of what was said that a table shows."""


@dataclass
class FaultRecord:
    """What was heard during one fault.

    Attributes
    ----------
    backwards : int
        Stamps that do not increase.
    longest : float, s
        Longest pause between batches.
    gaps : int
        Told by the driver.
    said : dict of str to None
        Different troubles, in order.
    """

    samples: int = 0
    backwards: int = 0
    longest: float = 0.0
    gaps: int = 0
    said: dict[str, None] = field(default_factory=dict)


class SoakListener(Node):
    """Hears points, status, gaps and results."""

    def __init__(self) -> None:
        super().__init__('soak_ear')
        self.heard = FaultRecord()
        self.results: list[CalibrationResult] = []
        self._last_ns, self._at = 0, time.monotonic()
        self._received: dict[str, int] = {}
        self._announced: dict[str, int] = {}
        self._stream = ''
        self._early = 0
        self._path = self.create_publisher(Path, 'planner/path', qos.PATH)
        self.create_subscription(TrackerStatus, 'tracker/status', self._on_status, qos.STATUS)
        self.create_subscription(TrackerGap, 'tracker/gap', self._on_gap, qos.EVENTS)
        self.create_subscription(
            CalibrationResult, 'calibrator/result', self.results.append, qos.RESULT
        )
        Drain(self, PointStamped, 'tracker/point', self._on_points, qos.MEASUREMENT)

    @property
    def streaming(self) -> bool:
        """True once samples have come."""
        return self._last_ns > 0

    def stray_path(self) -> None:
        """Publish a path that no machine of this size can drive."""
        corners = NominalPath(np.array([[0.0, 0, 0], [600.0, 0, 0], [600.0, 500.0, 0]]))
        self._path.publish(path_to_message(corners, self.get_clock().now().to_msg()))

    def begin(self) -> None:
        """Begin with another fault."""
        self.heard = FaultRecord()

    def end(self) -> FaultRecord:
        """Return what was heard since the beginning of this fault; a pause may still last."""
        self.heard.longest = max(self.heard.longest, time.monotonic() - self._at)
        return self.heard

    @property
    def lost(self) -> int:
        """Samples that the driver has announced and that have not come."""
        return sum(max(0, n - self._received.get(s, 0)) for s, n in self._announced.items())

    def _on_points(self, messages: list[PointStamped], numbers: list[int | None]) -> None:
        now = time.monotonic()
        self.heard.longest = max(self.heard.longest, now - self._at)
        self._at = now
        for message in messages:
            stamp_ns = ns_from_time(message.header.stamp)
            self.heard.backwards += stamp_ns <= self._last_ns
            self._last_ns = stamp_ns
        self.heard.samples += len(messages)
        self._received[self._stream] = self._received.get(self._stream, 0) + len(messages)

    def _on_status(self, message: TrackerStatus) -> None:
        if message.stream_id and message.stream_id != self._stream:
            # the first samples of a stream may overtake its status
            self._stream = message.stream_id
            self._received.setdefault(self._stream, 0)
        if message.stream_id:
            self._announced[message.stream_id] = message.samples_published
        first = message.message.partition(';')[0]
        if message.state != TrackerStatus.STREAMING or not first.startswith('streaming'):
            self.heard.said.setdefault(first[:WORDS])

    def _on_gap(self, message: TrackerGap) -> None:
        self.heard.gaps += 1
