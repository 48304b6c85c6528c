# SPDX-License-Identifier: Apache-2.0
"""From a backend to ``tracker/point``: waits until nothing is missing, then publishes it all."""

from __future__ import annotations

from concurrent.futures import Future

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleNode

from otf_core.config import Parameters
from otf_core.errors import OtfError
from otf_msgs.msg import Plan, TrackerStatus
from otf_ros import app, convert, qos
from otf_ros.timers import create_timer
from otf_tracker_driver.backends import Backend
from otf_tracker_driver.params import DriverConfig
from otf_tracker_driver.status import Status

PERIOD = 0.005
"""s; how often the backend is asked for samples."""


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
        backend.cancelled = app.ending
        try:
            self.description = backend.connect()
        except OtfError:
            backend.disconnect()
            raise
        status.source(backend)
        self._points = node.create_lifecycle_publisher(
            PointStamped, 'tracker/point', qos.MEASUREMENT
        )
        self._timer = create_timer(node, PERIOD, self._tick, autostart=False)
        self._plan_wanted = self._streaming = False

    def path(self) -> Path | None:
        """Return the path that comes with the samples, if one does."""
        if self._backend.path is None:
            return None
        now = self._node.get_clock().now().to_msg()
        return convert.path_to_message(self._backend.path, now)

    def begin(self, plan: Plan | None) -> None:
        """Get ready for a stream from the beginning; it starts when nothing is missing."""
        self._streaming, self._plan_wanted = False, self._backend.needs_plan
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
    def streaming(self) -> bool:
        """True from the first to the last sample of a stream."""
        return self._streaming

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
        self._node.destroy_lifecycle_publisher(self._points)

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
                self._streaming = True
            batch = self._backend.poll()
            remark, trouble = f'streaming {self._backend.remark}'.strip(), self._backend.trouble
            self._status.report(TrackerStatus.STREAMING, trouble or remark, bool(trouble))
        except OtfError as error:
            self.stop()
            self._status.report(TrackerStatus.FAULT, f'{error}; deactivate, correct it, activate')
            return
        except Exception as error:
            text = f'internal error of the backend: {error!r}; the driver ends'
            self._status.report(TrackerStatus.FAULT, text)
            raise
        self._status.take(batch)
        for message in convert.points_to_messages(batch):
            self._points.publish(message)
        if self._backend.finished:
            self.stop()
            text = 'all samples published; deactivate and activate to stream again'
            self._status.report(TrackerStatus.FINISHED, text)

    def _missing(self) -> str:
        """Say what is not there yet that a stream needs; empty if nothing."""
        if self._plan_wanted:
            return 'waiting for planner/plan'
        present, wanted = self._points.get_subscription_count(), self._config.wait_for_subscribers
        if not self._backend.preparing and present < wanted:
            return f'waiting for subscriptions of tracker/point: {present} of {wanted}'
        return self._backend.preparing
