# SPDX-License-Identifier: Apache-2.0
"""What the calibrator reads: paths, status and gaps of the driver, signals; and its journal."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from otf_calibrator.collector import PathTaken
from otf_calibrator.intake import Intake, SignalBuffer, Status, journal_place
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.session import Session
from otf_core.bags.bag_signals import topic_of
from otf_core.bags.journal import Journal
from otf_core.bags.rosbag2_metadata import GAP, STATUS
from otf_core.contradictions.recording_checks import check_path
from otf_core.errors import OtfError
from otf_core.model.declared_signals import PLAIN, SignalSpec
from otf_core.model.machine import load_machine
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import convert, qos
from otf_ros.convert import ns_from_time
from otf_ros.definitions import message_text
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
        fate = self._session.intake.path(path, data)
        collector, points = self._session.collector, len(message.poses)
        if fate == PathTaken.USED:
            log.info(f'new path of {points} points, for {len(collector.buffer)} samples so far')
        elif fate == PathTaken.WAITS:
            text = f'another path, of {points} points, was published in mid-run by {sender}'
            collector.remarks.append(text)
            log.warning(f'{text}; {fate.value}')


def status_of(message: TrackerStatus) -> Status:
    """Return what a driver says of its stream; one that is held up may go on."""
    return Status(
        message.stream_id,
        message.samples_published,
        message.state not in (TrackerStatus.IDLE, TrackerStatus.FINISHED),
        message.state == TrackerStatus.FINISHED,
        ns_from_time(message.last),
    )


def stream_before(message: TrackerGap) -> tuple[str, int]:
    """Return the stream of a driver that was killed, empty if none was, and its samples."""
    return message.stream_before, message.published_before


def listen(node: Node, intake: Intake, files: CalibratorConfig) -> None:
    """Take the signals of the machine; open the journal, go on with a run that was not finished.

    Raises
    ------
    ConfigError
        If the journal cannot be kept where the parameters say.
    """
    specs = [s for s in load_machine(files.machine_file).signals if s.type]
    intake.signals = SignalBuffer(specs)
    for spec in specs:
        module, _, kind = spec.type.replace('/msg/', '.msg/').partition('/')
        message = getattr(import_module(module), kind)
        node.create_subscription(
            message, spec.topic, partial(_take, node, intake, spec), qos.SIGNAL
        )
    _keep_journal(node, intake, files)


def _take(node: Node, intake: Intake, spec: SignalSpec, message: Any) -> None:
    """Take a value at its stamp; one without a stamp at its time of reception."""
    header = getattr(message, 'header', None)
    now = node.get_clock().now().nanoseconds or time.time_ns()  # a bag that is played has a clock
    stamp = now if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
    value = float(getattr(message, PLAIN[spec.type]))
    intake.signal(spec, stamp, value, serialize_message(message))


def _keep_journal(node: Node, intake: Intake, files: CalibratorConfig) -> None:
    logger = node.get_logger()
    output, namespace = files.output_directory, node.get_namespace()
    place = journal_place(files.journal_directory, output, namespace)
    if place is None:
        logger.warning('no journal is kept: samples are in memory only, until they are calibrated')
        return
    texts = {
        STATUS.type: message_text('otf_msgs', 'TrackerStatus'),
        GAP.type: message_text('otf_msgs', 'TrackerGap'),
    }
    intake.journal = Journal(place, texts, [topic_of(s) for s in intake.signals.specs])
    said = intake.take_up(
        lambda data: status_of(deserialize_message(data, TrackerStatus)),
        lambda data: stream_before(deserialize_message(data, TrackerGap)),
    )
    if said:
        logger.warning(said)
    logger.info(f'journal: {place}')
