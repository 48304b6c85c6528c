# SPDX-License-Identifier: Apache-2.0
"""From a backend to ``tracker/point``: waits until nothing is missing, then publishes it all."""

from __future__ import annotations

import time
from concurrent.futures import Future

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from trajectory_msgs.msg import JointTrajectory

from otf_core.config import Parameters
from otf_core.errors import OtfError
from otf_core.model.observation import Samples
from otf_msgs.msg import CalibratorState, Plan, TrackerStatus
from otf_ros import app, convert, qos
from otf_ros.timers import create_timer
from otf_tracker_driver.backends import Backend
from otf_tracker_driver.backends.base import NO_SAMPLES, join_samples
from otf_tracker_driver.listeners import Calibrators
from otf_tracker_driver.params import DriverConfig
from otf_tracker_driver.status import Status
from otf_tracker_driver.window import Window

PERIOD = 0.005
"""s; how often the backend is asked for samples."""
LOOK, LOOK_AGAIN = 0.1, 1.0
"""s; how often it is looked who listens, before the stream and during it."""
MOST_AT_ONCE, MOST_PER_SECOND = 5000, 10_000
"""Samples; what has piled up while the process stood still is published at a pace that subscribers
can follow: their queues hold 20 000."""
STOOD_STILL, FOUND_AGAIN = 5.0, 4.0
"""s; a process that stands still for longer may have been forgotten by the others, as the lease of
its participant ends after 10 s. What is published before they have found it again is lost."""


class Streamer:
    """One backend, connected here, and the publisher of its samples.

    Raises
    ------
    OtfError
        If the backend cannot be connected.
    """

    def __init__(
        self, node: LifecycleNode, status: Status, config: DriverConfig, backend: Backend
    ) -> None:
        self._node, self._status, self._config = node, status, config
        self._backend = backend
        backend.cancelled = app.is_ending
        backend.now_ns = lambda: node.get_clock().now().nanoseconds or time.time_ns()
        try:
            self.description = backend.connect()
        except OtfError:
            backend.disconnect()
            raise
        status.source(backend)
        self._points = node.create_lifecycle_publisher(
            PointStamped, 'tracker/point', qos.MEASUREMENT
        )
        self._offered = self._offer_path()
        self._timer = create_timer(node, PERIOD, self._tick, autostart=False)
        self._plan_wanted = self._streaming = False
        self._pending, self._allowed, self._ticked = NO_SAMPLES, 0.0, time.monotonic()
        self._held_until = 0.0
        self._calibrators = Calibrators(node, self._points.topic_name, self._on_state)
        self._window = Window()

    def _offer_path(self) -> list[Publisher]:
        """Publish the path that comes with the samples, if one does."""
        publishers, now = [], self._node.get_clock().now().to_msg()
        if self._backend.path is not None:
            publishers.append(self._node.create_publisher(Path, 'planner/path', qos.PATH))
            publishers[-1].publish(convert.path_to_message(self._backend.path, now))
        if self._backend.parts:
            publishers.append(
                self._node.create_publisher(JointTrajectory, 'planner/axes', qos.PARTS)
            )
            for part in self._backend.parts:
                publishers[-1].publish(convert.axes_to_message(part, now))
        return publishers

    def begin(self, plan: Plan | None) -> None:
        """Get ready for a stream from the beginning; it starts when nothing is missing."""
        self._streaming, self._plan_wanted = False, self._backend.needs_plan
        self._pending, self._ticked = NO_SAMPLES, time.monotonic()
        self._timer.reset()
        self._status.repeat(True)
        if not self._plan_wanted:
            self._backend.prepare(None)
        elif plan:
            self.take(plan)

    def take(self, plan: Plan) -> None:
        """Drive this plan, if one is waited for."""
        if not self._plan_wanted:
            return
        try:
            self._backend.prepare(convert.plan_from_message(plan))
            self._plan_wanted = False
            self._timer.reset()
        except OtfError as error:
            self._timer.cancel()  # the fault is shown until another plan comes
            self._status.report(TrackerStatus.FAULT, f'planner/plan cannot be driven: {error}')

    @property
    def under_way(self) -> bool:
        """True if a stream goes on, or begins as soon as nothing is missing."""
        return not self._timer.is_canceled()

    def operate(self, name: str, own: Parameters) -> Future[str]:
        """Have the source do what an operator asks for; see Backend."""
        return self._backend.operate(name, own)

    def stop(self) -> None:
        """End the stream."""
        self._streaming = False
        self._timer.cancel()
        self._status.repeat(False)
        self._backend.stop()
        self._plan_wanted = False

    def release(self) -> None:
        """End the stream and disconnect the backend."""
        self.stop()
        self._backend.disconnect()
        self._node.destroy_timer(self._timer)
        self._calibrators.close()
        self._node.destroy_lifecycle_publisher(self._points)
        for publisher in self._offered:
            self._node.destroy_publisher(publisher)

    def _tick(self) -> None:
        """Publish what the backend has measured since the last tick."""
        try:
            missing = '' if self._streaming else self._missing()
            if missing:
                self._status.report(TrackerStatus.IDLE, missing)
                return
            if not self._streaming:
                self._backend.start()
                self._status.begin(self._backend)
                self._streaming, self._window = True, Window(self._calibrators.names)
            if self._calibrators.look(LOOK_AGAIN):
                self._window.see(self._calibrators.names, self._status.message.samples_published)
            self._backend.allowed = self._window.allowed
            batch = self._due(self._backend.poll())
            self._status.take(batch)
            hindrance, trouble = self._backend.hindrance, self._backend.trouble
            if hindrance and not len(batch):
                self._status.hinder(hindrance, trouble)
            else:
                remark = f'streaming {self._backend.remark}'.strip()
                warned = bool(trouble or self._backend.health.warnings)
                self._status.report(TrackerStatus.STREAMING, trouble or remark, warned)
        except OtfError as error:
            self.stop()
            self._status.report(TrackerStatus.FAULT, f'{error}; deactivate, correct it, activate')
            return
        except Exception as error:  # a defect: the status states it before the node ends
            text = f'internal error of the backend: {error!r}; the driver ends'
            self._status.report(TrackerStatus.FAULT, text)
            raise
        for message in convert.points_to_messages(batch):
            self._points.publish(message)
        if self._backend.finished and not len(self._pending):
            self.stop()
            text = f'all samples published{self._backend.pace_words}; '
            text += 'deactivate and activate to stream again'
            self._status.report(TrackerStatus.FINISHED, text)

    def _missing(self) -> str:
        """State what is not there yet that a stream needs; empty if nothing."""
        if self._plan_wanted:
            return 'waiting for planner/plan'
        wanted = self._config.wait_for_subscribers
        self._calibrators.look(LOOK)
        listening = min(self._calibrators.count, self._points.get_subscription_count())
        if not self._backend.preparing and listening < wanted:
            return (
                f'waiting for calibrators that listen to tracker/point: {listening} of '
                f'{wanted}; with wait_for_subscribers 0 it waits for none'
            )
        return self._backend.preparing

    def _on_state(self, calibrator: str, message: CalibratorState) -> None:
        """Let the source go on if a calibrator has taken samples."""
        status, taken = self._status.message, 0
        if message.stream_id == status.stream_id:
            taken = self._backend.count_until(convert.ns_from_time(message.taken))
        self._window.hear(calibrator, taken, status.samples_published)

    def _due(self, new: Samples) -> Samples:
        """Take new samples; return what is to be published now, in order."""
        pending = join_samples([self._pending, new]) if len(self._pending) else new
        now = time.monotonic()
        paused = now - self._ticked
        if paused > STOOD_STILL:
            self._held_until = now + FOUND_AGAIN
        self._allowed, self._ticked = (
            min(self._allowed + MOST_PER_SECOND * paused, MOST_AT_ONCE),
            now,
        )
        count = 0 if now < self._held_until else min(len(pending), int(self._allowed))
        self._allowed -= count
        self._pending = pending.part(count, len(pending))
        return pending.part(0, count)
