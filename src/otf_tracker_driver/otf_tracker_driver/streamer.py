# SPDX-License-Identifier: Apache-2.0
"""From a backend to ``tracker/point``: waits until nothing is missing, then publishes it all."""

from __future__ import annotations

import time

import numpy as np
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from trajectory_msgs.msg import JointTrajectory

from otf_core.errors import OtfError
from otf_core.model.observation import Samples
from otf_msgs.msg import CalibratorState, Plan, TrackerStatus
from otf_ros import app, convert, qos
from otf_ros.timers import create_timer
from otf_tracker_driver.backends import Backend
from otf_tracker_driver.backends.base import NO_SAMPLES, join_samples
from otf_tracker_driver.calibrators import Calibrators
from otf_tracker_driver.params import DriverConfig
from otf_tracker_driver.status import Status

PERIOD = 0.005
"""s; how often the backend is asked for samples."""
TYPICAL = 100
"""Samples whose intervals tell how much time those that wait have taken."""
CATCH_UP = 1.0
"""s; time constant with which a backlog is published."""
LONGEST_STEP = 0.5
"""s; what a longer pause of this process has delayed is caught up with."""
MOST_PER_SECOND = 10_000
"""Samples; the pace of a backlog that subscribers can follow: their queues hold 20 000."""
STOOD_STILL, FOUND_AGAIN = 5.0, 4.0
"""s; a process that stands still for longer may have been forgotten by the others, as the lease of
its participant ends after 10 s. What is published before they have found it again is lost."""
LOOK = 0.1
"""s; how often it is looked who listens before a stream."""


class Pace:
    """Spreads packets over the time in which they were measured; late by no more than a packet.

    Samples are published in the intervals of their stamps. What has come and is older than a
    packet is a backlog, which is caught up with, ever faster the longer it is.

    Attributes
    ----------
    backlog : float, s
        Measured time of the samples that are not published, beyond that of the last packet.
    """

    def __init__(self) -> None:
        self._pending, self._due_ns = NO_SAMPLES, 0.0
        self._packet, self._allowed = 0, 0.0
        self._ticked = self._held_until = time.monotonic()
        self.backlog = 0.0

    @property
    def empty(self) -> bool:
        """True if all that has come is published."""
        return not len(self._pending)

    def take(self, new: Samples, in_packets: bool) -> Samples:
        """Take new samples; return what is to be published now, in order."""
        now = time.monotonic()
        paused, self._ticked = now - self._ticked, now
        if paused > STOOD_STILL:
            self._held_until = now + FOUND_AGAIN
        if self.empty and len(new):
            self._due_ns = float(new.stamp_ns[0])
        pending = self._pending = join_samples([self._pending, new]) if len(new) else self._pending
        if in_packets and not self.empty:
            self._packet = len(new) or self._packet
            steps = np.diff(pending.stamp_ns[:TYPICAL]) if len(pending) > 1 else np.zeros(1)
            more = max(0, len(pending) - self._packet)
            self.backlog = more * float(np.median(steps)) * 1e-9
        if now < self._held_until or self.empty:
            return NO_SAMPLES
        step = min(paused, LONGEST_STEP)
        self._allowed = min(self._allowed + step, LONGEST_STEP)
        count = min(len(pending), int(self._allowed * MOST_PER_SECOND))
        if in_packets:
            self._due_ns = max(self._due_ns, float(pending.stamp_ns[0]))
            self._due_ns += step * (1 + self.backlog / CATCH_UP) * 1e9
            count = min(count, int(pending.stamp_ns.searchsorted(self._due_ns, 'right')))
        self._allowed -= count / MOST_PER_SECOND
        self._pending = pending.part(count, len(pending))
        return pending.part(0, count)


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
        self.backend = backend
        backend.cancelled = app.is_ending
        backend.now_ns = lambda: convert.now_ns(node)
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
        self._pace, self._looked, self._listening = Pace(), 0.0, 0
        self._calibrators = Calibrators(node, self._points.topic_name, self._taken)

    def _offer_path(self) -> list[Publisher]:
        """Publish the path that comes with the samples, if one does."""
        publishers, now = [], convert.now(self._node)
        if self.backend.path is not None:
            publishers.append(self._node.create_publisher(Path, 'planner/path', qos.PATH))
            publishers[-1].publish(convert.path_to_message(self.backend.path, now))
        if self.backend.parts:
            publishers.append(
                self._node.create_publisher(JointTrajectory, 'planner/axes', qos.PARTS)
            )
            for part in self.backend.parts:
                publishers[-1].publish(convert.axes_to_message(part, now))
        return publishers

    def begin(self, plan: Plan | None) -> None:
        """Get ready for a stream from the beginning; it starts when nothing is missing."""
        self._streaming, self._plan_wanted = False, self.backend.needs_plan
        self._timer.reset()
        self._status.repeat(True)
        if not self._plan_wanted:
            self.backend.prepare(None)
        elif plan:
            self.take(plan)

    def take(self, plan: Plan) -> None:
        """Drive this plan, if one is waited for."""
        if not self._plan_wanted:
            return
        try:
            self.backend.prepare(convert.plan_from_message(plan))
            self._plan_wanted = False
            self._timer.reset()
        except OtfError as error:
            self._timer.cancel()  # the fault is shown until another plan comes
            self._status.report(TrackerStatus.FAULT, f'planner/plan cannot be driven: {error}')

    @property
    def under_way(self) -> bool:
        """True if a stream goes on, or begins as soon as nothing is missing."""
        return not self._timer.is_canceled()

    def stop(self) -> None:
        """End the stream."""
        self._streaming = self._plan_wanted = False
        self._timer.cancel()
        self._status.repeat(False)
        self.backend.stop()

    def release(self) -> None:
        """End the stream and disconnect the backend."""
        self.stop()
        self.backend.disconnect()
        self._node.destroy_timer(self._timer)
        self._calibrators.close()
        self._node.destroy_lifecycle_publisher(self._points)
        for publisher in self._offered:
            self._node.destroy_publisher(publisher)

    def _tick(self) -> None:
        """Publish what the backend has measured since the last tick."""
        backend, status = self.backend, self._status
        try:
            missing = '' if self._streaming else self._missing()
            if missing:
                status.report(TrackerStatus.IDLE, missing)
                return
            if not self._streaming:
                backend.start()
                status.begin(backend)
                self._streaming, self._pace = True, Pace()
                self._calibrators.begin()
            backend.allowed = self._calibrators.allowed()
            batch = self._pace.take(backend.poll(), backend.in_packets)
            status.take(batch, self._pace.backlog)
            self._calibrators.published = status.message.samples_published
            if backend.hindrance and not len(batch) and self._pace.empty:
                status.hinder(backend.hindrance, backend.trouble)
            else:
                status.stream('' if backend.hindrance else backend.trouble)
        except OtfError as error:
            self.stop()
            status.report(TrackerStatus.FAULT, f'{error}; deactivate, correct it, activate')
            return
        except Exception as error:  # a defect: the status states it before the node ends
            text = f'internal error of the backend: {error!r}; the driver ends'
            status.report(TrackerStatus.FAULT, text)
            raise
        for message in convert.points_to_messages(batch):
            self._points.publish(message)
        if backend.finished and self._pace.empty:
            self.stop()
            text = f'all samples published{backend.pace_words}; '
            text += 'deactivate and activate to stream again'
            status.report(TrackerStatus.FINISHED, text)

    def _missing(self) -> str:
        """State what is not there yet that a stream needs; empty if nothing."""
        if self._plan_wanted:
            return 'waiting for planner/plan'
        wanted = self._config.wait_for_subscribers
        if time.monotonic() - self._looked > LOOK:
            self._looked = time.monotonic()
            calibrators = self._calibrators.count()
            self._listening = min(calibrators, self._points.get_subscription_count())
        listening = self._listening
        if not self.backend.preparing and listening < wanted:
            return (
                f'waiting for calibrators that listen to tracker/point: {listening} of '
                f'{wanted}; with wait_for_subscribers 0 it waits for none'
            )
        return self.backend.preparing

    def _taken(self, message: CalibratorState) -> int:
        """Samples of the stream that a calibrator has taken, or that are lost to it."""
        if message.stream_id != self._status.message.stream_id:
            return 0
        return self.backend.count_until(convert.ns_from_time(message.taken))
