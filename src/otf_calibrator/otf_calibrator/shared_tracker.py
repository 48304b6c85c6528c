# SPDX-License-Identifier: Apache-2.0
"""One tracker for several machines: whose run the samples were.

Every calibrator hears all samples of its tracker, also while another machine drives. When a run is
calibrated, the calibrator of its machine says so on ``tracker/calibrated``: the stamp of the last
sample, and as frame_id the topic of the path, which tells machines apart. The others set the
samples until then aside.
"""

from __future__ import annotations

from rclpy.node import Node
from std_msgs.msg import Header

from otf_calibrator.intake import Intake
from otf_calibrator.job import Calibrated
from otf_ros import qos
from otf_ros.convert import ns_from_time, time_from_ns


class SharedTracker:
    """Tells other calibrators of the same tracker, and listens to them."""

    def __init__(self, node: Node, intake: Intake) -> None:
        self._intake, self._path = intake, node.resolve_topic_name('planner/path')
        self._publisher = node.create_publisher(Header, 'tracker/calibrated', qos.COMMAND)
        node.create_subscription(Header, 'tracker/calibrated', self._on_other, qos.COMMAND)

    def tell(self, outcome: Calibrated) -> None:
        """Say that a run was that of this machine; not of an interim result."""
        if outcome.request.final:
            stamp = time_from_ns(int(outcome.request.samples.stamp_ns[-1]))
            self._publisher.publish(Header(stamp=stamp, frame_id=self._path))

    def _on_other(self, message: Header) -> None:
        if message.frame_id != self._path:
            why = f'they were of the run along {message.frame_id}'
            self._intake.of_another(ns_from_time(message.stamp), why)
