# SPDX-License-Identifier: Apache-2.0
"""Paths as they are published: refused, used, or kept until the target follows them."""

from __future__ import annotations

from collections.abc import Callable

from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.serialization import serialize_message

from otf_calibrator.collector import PathTaken
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.session import Session
from otf_core.contradictions.recording_checks import check_path
from otf_core.errors import OtfError
from otf_core.model.machine import load_machine
from otf_ros import convert, qos
from otf_ros.topic_watch import senders


class PathReceiver:
    """Hands every path that fits the machine to the session, and states what became of it.

    Parameters
    ----------
    node : rclpy.node.Node
    files : callable
        The files that the parameters name now.
    """

    def __init__(
        self, node: Node, topic: str, session: Session, files: Callable[[], CalibratorConfig]
    ) -> None:
        self._node, self._topic, self._session, self._files = node, topic, session, files
        self.machine = load_machine(files().machine_file)
        """As described when the last path arrived."""
        node.create_subscription(Path, topic, self._receive, qos.PATH)

    def _receive(self, message: Path) -> None:
        sender, log = senders(self._node, self._topic), self._node.get_logger()
        try:
            path = convert.path_from_message(message)
            self.machine = load_machine(self._files().machine_file)
            check_path(path, self.machine)
        except OtfError as error:
            log.error(f'{self._topic} of {sender} ignored: {error}')
            return
        data = serialize_message(convert.path_for_journal(message))
        taken = self._session.intake.path(path, data)
        collector, points = self._session.collector, len(message.poses)
        if taken == PathTaken.USED:
            log.info(f'new path of {points} points, for {len(collector.buffer)} samples so far')
        elif taken == PathTaken.WAITS:
            text = f'another path, of {points} points, was published in mid-run by {sender}'
            collector.remarks.append(text)
            log.warning(f'{text}; {taken.value}')
