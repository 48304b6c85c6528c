# SPDX-License-Identifier: Apache-2.0
"""The latched status of the driver: what it does, how many samples of which stream are out."""

from __future__ import annotations

import uuid

from rclpy.node import Node

from otf_msgs.msg import TrackerStatus
from otf_ros import qos
from otf_ros.convert import TRACKER_FRAME, header
from otf_tracker_driver.backends import Backend

NAMES = {
    TrackerStatus.IDLE: 'IDLE',
    TrackerStatus.STREAMING: 'STREAMING',
    TrackerStatus.FINISHED: 'FINISHED',
    TrackerStatus.FAULT: 'FAULT',
}
PERIOD = 0.5
"""s; how often the status is repeated while active."""


class Status:
    """Publishes ``tracker/status`` for a node, on change and repeatedly while active."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(TrackerStatus, 'tracker/status', qos.STATUS)
        self._timer = node.create_timer(PERIOD, self._publish, autostart=False)
        self.message = TrackerStatus()

    def report(self, state: int, text: str) -> None:
        """Publish a state, and log it; the same once more is not repeated."""
        message = self.message
        if (message.state, message.message) == (state, text):
            return
        message.state, message.name, message.message = state, NAMES[state], text
        self._publish()
        logger = self._node.get_logger()
        if state == TrackerStatus.FAULT:  # rclpy wants one severity per line of code
            logger.error(f'{NAMES[state]}: {text}')
        else:
            logger.info(f'{NAMES[state]}: {text}')

    def describe(self, name: str) -> None:
        """Say which backend will deliver samples."""
        self.message = TrackerStatus(backend=name)

    def begin(self, backend: Backend) -> None:
        """Begin a stream that can be told from all others."""
        self.message.stream_id = uuid.uuid4().hex[:12]
        self.message.samples_published = 0
        self.source(backend)

    def source(self, backend: Backend) -> None:
        """Take what is known of the samples to come."""
        self.message.samples_expected = backend.expected
        self.message.rate = backend.rate

    def repeat(self, active: bool) -> None:
        """Switch the repetition on or off."""
        (self._timer.reset if active else self._timer.cancel)()

    def _publish(self) -> None:
        self.message.header = header(self._node.get_clock().now().to_msg(), TRACKER_FRAME)
        self._publisher.publish(self.message)
