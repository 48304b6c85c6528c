# SPDX-License-Identifier: Apache-2.0
"""Messages that the calibrator reads, as its intake takes them; the journal that it keeps."""

from __future__ import annotations

import time
from functools import partial
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from otf_calibrator.beside import Beside
from otf_calibrator.intake import Intake, Status, journal_place
from otf_calibrator.params import CalibratorConfig
from otf_core.bags.journal import Journal
from otf_core.bags.rosbag2_metadata import GAP, STATUS
from otf_core.bags.signals import topic_of
from otf_core.model.declared_signals import PLAIN, SignalSpec
from otf_core.model.machine import load_machine
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import qos
from otf_ros.convert import ns_from_time
from otf_ros.definitions import message_text


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
    intake.beside = Beside(specs)
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
        logger.warning('no journal is kept: until a calibration is done, samples are in memory')
        return
    texts = {
        STATUS.type: message_text('otf_msgs', 'TrackerStatus'),
        GAP.type: message_text('otf_msgs', 'TrackerGap'),
    }
    intake.journal = Journal(place, texts, [topic_of(s) for s in intake.beside.specs])
    said = intake.take_up(
        lambda data: status_of(deserialize_message(data, TrackerStatus)),
        lambda data: stream_before(deserialize_message(data, TrackerGap)),
    )
    if said:
        logger.warning(said)
    logger.info(f'journal: {place}')
