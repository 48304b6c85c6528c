# SPDX-License-Identifier: Apache-2.0
"""Calibrator node: collects path and samples, calibrates when the run is complete, publishes."""

from __future__ import annotations

import time
from collections.abc import Collection

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.serialization import serialize_message

from otf_calibrator.action import CalibrateAction
from otf_calibrator.inputs import PathReceiver, PublisherOfRun, listen, status_of
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.publish import OutcomePublisher, StatePublisher, diagnose_node, places_of
from otf_calibrator.session import Session
from otf_calibrator.worker import check_files
from otf_core.config import CalibrationConfig
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import convert, qos, services
from otf_ros.drain import Drain
from otf_ros.params import NodeParameters
from otf_ros.timers import create_timer
from otf_ros.topic_watch import TopicWatch

PERIOD = 0.1
"""s; how often the run and a calibration under way are looked at if nothing happens to them."""
POINT, PATH, AXES = 'tracker/point', 'planner/path', 'planner/axes'
STATUS, GAP = 'tracker/status', 'tracker/gap'
READ = {POINT: qos.MEASUREMENT, PATH: qos.PATH, AXES: qos.PARTS}
READ |= {STATUS: qos.STATUS, GAP: qos.EVENTS}

AT_CALIBRATION = {
    'machine_file', 'output_directory', 'history_directory', 'method', 'save_bag', 'report',
    'effects', *(info.name for info in CalibrationConfig.infos()),
}  # fmt: skip
"""Parameters that are read when a calibration begins."""


class Calibrator(Node):
    """From ``planner/path`` (``axes``) and ``tracker/point`` to the topics below ``calibrator/``.

    Raises
    ------
    OtfError
        If parameters, the machine description or the folders for results and journal are wrong
        at start. Whatever is wrong later gives the state FAILED, and the node lives on.
    """

    def __init__(self) -> None:
        super().__init__('calibrator')
        groups = CalibratorConfig, CalibrationConfig
        self._settings = NodeParameters(self, *groups, read_only=['journal_directory'])
        self._settings.tell_when(_when)
        check_files(files := self._read_settings()[0])
        self._settings.check_also(CalibratorConfig, check_files)
        wake = self.create_guard_condition(self._tick).trigger
        warn = self.get_logger().warning
        self._session = Session(self._read_settings, warn, wake, lambda: self._drain.empty())
        self._publisher = PublisherOfRun(lambda: self.count_publishers(POINT))
        listen(self, self._session.intake, files)
        self._watch = TopicWatch(self, READ, POINT)
        self._state = StatePublisher(self)
        self._paths = PathReceiver(self, PATH, AXES, self._session, self._read_settings)
        self._outcomes = OutcomePublisher(self, self._session, self._state)
        self.create_subscription(TrackerStatus, STATUS, self._on_status, qos.STATUS)
        self.create_subscription(TrackerGap, GAP, self._on_gap, qos.EVENTS)
        services.offer(self, 'calibrator/calibrate', self._session.calibrate)
        services.offer(self, 'calibrator/reset', self._session.forget)
        services.offer(self, 'calibrator/diagnose', self._session.diagnose)
        results = lambda: self._read_settings()[0].output_directory  # noqa: E731
        diagnose_node(self, self._session, results, lambda: self._paths.machine.name)
        self._action = CalibrateAction(self, self._session, lambda: self._outcomes.latest)
        create_timer(self, PERIOD, self._look)
        # last: samples may come at once
        self._drain = Drain(self, PointStamped, POINT, self._on_points, qos.MEASUREMENT)

    def close(self) -> None:
        """End a calibration or a diagnosis under way; files are whole or not there."""
        self._session.close()
        self._action.close()

    def _read_settings(self) -> tuple[CalibratorConfig, CalibrationConfig]:
        return self._settings.read(CalibratorConfig), self._settings.read(CalibrationConfig)

    def _on_status(self, message: TrackerStatus) -> None:
        self._session.intake.take_status(status_of(message), serialize_message(message))

    def _on_gap(self, message: TrackerGap) -> None:
        self._session.intake.take_gap(serialize_message(message))

    def _on_points(self, messages: list[PointStamped], numbers: list[int | None]) -> None:
        self._paths.take_turn()  # a part comes before the samples that need it
        used = self._publisher.select(messages, numbers, time.monotonic())
        if len(used) < len(messages):
            self._session.intake.leave_out(len(messages) - len(used), self._watch.second())
        if used:
            self._state.take(used[-1].header.stamp, len(used))
        if used and self._session.take(convert.points_from_messages(used)):
            self._tick()

    def _look(self) -> None:
        self._drain.take_turn()  # what came while the process stood still is of the run: not over
        self._tick()

    def _tick(self) -> None:
        self._watch.look()
        self._paths.show()
        self._session.collector.publishers = self._watch.publishers
        if job := self._session.take_finished():
            self._outcomes.finish(job)
            self._paths.show(places_of(job))
        if outcome := self._session.take_saved():
            self._outcomes.complete(outcome)
        if started := self._session.start_due():
            self.get_logger().info(started)
        if look := self._session.first_look():
            self._outcomes.publish_sight(look.result())
            self._paths.show(places_of(look))
        if diagnosed := self._session.take_diagnosed():
            self._outcomes.publish_diagnosis(diagnosed)
        self._state.publish(self._session, self._watch.troubles)
        self._action.look()


def _when(names: Collection[str]) -> str:
    """When parameters count, if not at once."""
    return 'counts at the next calibration' if AT_CALIBRATION & set(names) else ''
