# SPDX-License-Identifier: Apache-2.0
"""What the calibrator reads: paths, status and gaps of the driver, signals; and its journal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path as FilePath
from typing import Any, TypeVar

from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory

from otf_calibrator.intake import Intake, SignalBuffer, Status, journal_place
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.plans import Item, Reception
from otf_calibrator.session import Session, Settings
from otf_core.arrays import Array
from otf_core.bags.bag_signals import topic_of
from otf_core.bags.cdr import encode_axes
from otf_core.bags.journal import Journal
from otf_core.bags.rosbag2_metadata import GAP, STATUS
from otf_core.contradictions.recording_checks import check_path
from otf_core.errors import InputError, OtfError
from otf_core.model.axis_path import PartsTrack, nominal_track
from otf_core.model.machine import load_machine
from otf_core.model.sections import SIGNAL_FIELDS, SignalSpec
from otf_msgs.msg import TrackerStatus
from otf_ros import convert, qos
from otf_ros.convert import ns_from_time
from otf_ros.definitions import message_text
from otf_ros.drain import Drain
from otf_ros.topic_watch import senders

A = TypeVar('A', bound=Any)
MOST_MISSED = 1000
"""Messages in a row that the publisher of the run may lose while there is another one."""
GONE, GONE_BESIDE = 1.0, 10.0
"""s; a publisher that was silent for so long has a successor, as a driver that was restarted; the
same where both have been heard at the same time."""
SHOWN_TURN = 0.01
"""rad between points of a track that is shown: chords leave 3 um at a radius of 0.25 m."""


class PublisherOfRun:
    """A run has the samples of one publisher, that which was heard first.

    rclpy does not say who sent a message, but the middleware numbers the messages of each
    publisher. While the graph knows two, a number that does not go on with the run is not of it.

    Parameters
    ----------
    present : callable
        Returns how many publishers the graph knows at this moment.
    """

    def __init__(self, present: Callable[[], int]) -> None:
        self._present = present
        self._last: int | None = None
        self._heard = 0.0
        self._other: int | None = None
        self._beside = False

    def select(self, messages: list[A], numbers: list[int | None], now: float) -> list[A]:
        """Return the messages of the run; all where the middleware does not number them."""
        own = []
        for message, number in zip(messages, numbers, strict=True):
            last, other = self._last, self._other
            step = 1 if last is None or number is None else number - last
            of_other = other is not None and number is not None and 0 < number - other < step
            goes_on = 0 < step <= MOST_MISSED and not of_other
            gone = now - self._heard > (GONE_BESIDE if self._beside else GONE)
            if not goes_on and not gone and self._present() > 1:
                self._other = number
                continue
            if not goes_on:
                self._other = None
            self._beside = self._other is not None
            self._last, self._heard = number, now
            own.append(message)
        return own


class PathReceiver:
    """Hands every path that fits the machine to the session, and states what became of it.

    Of a machine with rotary axes that is the parts on the topic ``axes``. One part of a machine
    without is its path.

    Parameters
    ----------
    path, axes : str
        Topics.
    settings : callable
        Returns the present parameters.
    """

    def __init__(
        self,
        node: Node,
        path: str,
        axes: str,
        session: Session,
        settings: Settings,
    ) -> None:
        self._node, self._session, self._settings = node, session, settings
        self._topic, self._axes = path, axes
        self.machine = load_machine(settings()[0].machine_file)
        """As described when the last path arrived."""
        self._track = node.create_publisher(Path, 'calibrator/track', qos.PATH)
        node.create_subscription(Path, path, self._receive, qos.PATH)
        # drained: one message a turn would come late beside many samples
        drain = Drain(node, JointTrajectory, axes, self._receive_parts, qos.PARTS)
        self.take_turn = drain.take_turn
        self._shown: PartsTrack | None = None

    def show(self, places: Mapping[str, Array] | None = None) -> None:
        """Publish the track of the reflectors of new parts, or with places that were found.

        Parameters
        ----------
        places : mapping of target to ndarray, shape (3,), m, optional
        """
        path = self._session.collector.path
        if not isinstance(path, PartsTrack) or (path is self._shown and not places):
            return
        self._shown = path
        track = nominal_track(path.machine, path.parts, places, SHOWN_TURN)
        self._track.publish(convert.path_to_message(track, convert.now(self._node)))

    def _receive_parts(self, messages: list[JointTrajectory], _: list[int | None]) -> None:
        for message in messages:
            self._take(self._axes, message, self._read_part)

    def _receive(self, message: Path) -> None:
        self._take(self._topic, message, self._read_path)

    def _take(self, topic: str, message: A, read: Callable[[A], tuple[Item, bytes, str]]) -> None:
        """Hand over what a message holds, and state what becomes of it."""
        sender, log = senders(self._node, topic), self._node.get_logger()
        intake, collector = self._session.intake, self._session.collector
        try:
            self.machine = intake.machine = load_machine(self._settings()[0].machine_file)
            item, data, words = read(message)
            heard = intake.take_path(item, data, ns_from_time(message.header.stamp))
        except OtfError as error:
            log.error(f'{topic} of {sender} ignored: {error}')
            return
        if heard == Reception.NEXT:
            text = f'another {words}, was published in mid-run by {sender}; {heard.value}'
            collector.remarks.append(text)
            log.warning(text)
        elif heard != Reception.KNOWN:
            log.info(f'new {words}, for {len(collector.buffer)} samples so far')

    def _read_part(self, message: JointTrajectory) -> tuple[Item, bytes, str]:
        part, stamp = convert.axes_from_message(message), message.header.stamp
        if not self.machine.rotary_names:
            return self._read_path(convert.path_of_part(part.of(self.machine), stamp))
        data = encode_axes(part.axes, part.positions, ns_from_time(stamp), part.target)
        return part, data, f"part, '{part.target}' of {len(part.positions)} corners"

    def _read_path(self, message: Path) -> tuple[Item, bytes, str]:
        path = convert.path_from_message(message)
        if self.machine.rotary_names:
            raise InputError(
                f'{self.machine.name} has the rotary axes {", ".join(self.machine.rotary_names)}; '
                f'publish axis positions on {self._axes}'
            )
        check_path(path, self.machine)
        data = serialize_message(convert.path_for_journal(message))
        return path, data, f'path, of {len(message.poses)} points'


def status_of(message: TrackerStatus) -> Status:
    """Return what a driver says of its stream; one that is held up may go on."""
    return Status(
        message.stream_id,
        message.samples_published,
        message.state not in (TrackerStatus.IDLE, TrackerStatus.FINISHED),
        message.state == TrackerStatus.FINISHED,
        ns_from_time(message.last),
    )


def listen(node: Node, intake: Intake, files: CalibratorConfig) -> None:
    """Take the signals of the machine; open the journal, go on with a run that was not finished.

    Raises
    ------
    ConfigError
        If the journal cannot be kept where the parameters say.
    """
    intake.machine = load_machine(files.machine_file)
    specs = [s for s in intake.machine.signals if s.type]
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
    stamp = convert.now_ns(node) if header is None else ns_from_time(header.stamp)
    value = float(getattr(message, SIGNAL_FIELDS[spec.type]))
    intake.take_signal(spec, stamp, value, serialize_message(message))


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
    topics = [topic_of(s) for s in intake.signals.specs]
    intake.journal = Journal(place, texts, topics, FilePath(files.machine_file))
    said = intake.resume_run(lambda data: status_of(deserialize_message(data, TrackerStatus)))
    if said:
        logger.warning(said)
    logger.info(f'journal: {place}')
