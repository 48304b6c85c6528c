# SPDX-License-Identifier: Apache-2.0
"""Messages that the calibrator reads, as its intake takes them; the journal that it keeps."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.serialization import deserialize_message

from otf_calibrator.intake import Intake, Status, journal_place
from otf_calibrator.params import CalibratorConfig
from otf_core.bags.journal import Journal
from otf_core.bags.topics import STATUS
from otf_msgs.msg import TrackerStatus
from otf_ros.definitions import message_text


def status_of(message: TrackerStatus) -> Status:
    """Return what a driver says of its stream; one that is held up by a fault may go on."""
    going = (TrackerStatus.STREAMING, TrackerStatus.FAULT)
    return Status(
        message.stream_id,
        message.samples_published,
        message.state in going,
        message.state == TrackerStatus.FINISHED,
    )


def keep_journal(node: Node, intake: Intake, files: CalibratorConfig) -> None:
    """Open the journal, and go on with a run that was not finished.

    Raises
    ------
    ConfigError
        If the journal cannot be kept where the parameters say.
    """
    logger = node.get_logger()
    output, namespace = files.output_directory, node.get_namespace()
    place = journal_place(files.journal_directory, output, namespace)
    if place is None:
        logger.warning('no journal is kept: until a calibration is done, samples are in memory')
        return
    texts = {STATUS.type: message_text('otf_msgs', 'TrackerStatus')}
    intake.journal = Journal(place, texts)
    said = intake.take_up(lambda data: status_of(deserialize_message(data, TrackerStatus)))
    if said:
        logger.warning(said)
    logger.info(f'journal: {place}')
