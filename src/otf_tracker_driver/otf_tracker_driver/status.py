# SPDX-License-Identifier: Apache-2.0
"""The latched status of the driver: what it does, how many samples are out, where gaps lie."""

from __future__ import annotations

import time
import uuid

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header

from otf_core.model.observation import Samples
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import frames, qos
from otf_ros.convert import NS, header, time_from_ns
from otf_ros.timers import create_timer
from otf_tracker_driver.backends import Backend
from otf_tracker_driver.clock.device_clock import ClockState
from otf_tracker_driver.health import ORDINARY, Flow, Gap, Health, Hindrance

NAMES = {
    TrackerStatus.IDLE: 'IDLE',
    TrackerStatus.STREAMING: 'STREAMING',
    TrackerStatus.FINISHED: 'FINISHED',
    TrackerStatus.FAULT: 'FAULT',
    **{int(flow): flow.name for flow in Flow},
}
HELD_UP = frozenset({Flow.SILENT, Flow.NO_CONNECTION})
"""What is a fault once it has lasted; a broken beam waits for people as long as they take."""
FAULT_AFTER = 10.0
"""s"""
AGAIN_AFTER = 2.0
"""s; what lasts is logged again then, and whenever it has lasted twice as long."""
PERIOD = 0.5
"""s; how often the status is repeated while active."""


class Status:
    """Publishes ``tracker/status`` for a node, on change and repeatedly while active.

    Attributes
    ----------
    latency : float or None, s
        Age of the oldest sample of the last batch when it was published; None if unknown.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(TrackerStatus, 'tracker/status', qos.STATUS)
        self._gaps = node.create_publisher(TrackerGap, 'tracker/gap', qos.EVENTS)
        self._timer = create_timer(node, PERIOD, self._publish, autostart=False)
        self.message = TrackerStatus()
        self._backend: Backend | None = None
        self._told_ns = 0
        self._lasting: tuple[int, Flow] | None = None
        self._log_again = AGAIN_AFTER
        self.latency: float | None = None

    def report(self, state: int, text: str, trouble: bool = False) -> None:
        """Publish a state, and log it, as a warning if it is trouble; not the same once more."""
        message = self.message
        self._lasting = None
        if (message.state, message.message) == (state, text):
            return
        message.silent_for, message.restarts = 0.0, 0
        self._change(state, text, trouble)

    def hinder(self, hindrance: Hindrance, trouble: str = '') -> None:
        """Determine that no samples flow, for how long, and why; log it now, and ever less often.

        Parameters
        ----------
        trouble : str
            What else is wrong; instead of the text of the hindrance.
        """
        lasted, kind = time.monotonic() - hindrance.since, hindrance.kind
        state = int(kind)
        if kind in HELD_UP and lasted > FAULT_AFTER:
            state = TrackerStatus.FAULT
        text = trouble or hindrance.text
        if lasted >= 1.0:
            text += f'; no samples for {lasted:.0f} s'
        if hindrance.restarts and kind not in ORDINARY:
            text += f', {hindrance.restarts} restart{"s" if hindrance.restarts > 1 else ""}'
        self.message.silent_for, self.message.restarts = lasted, hindrance.restarts
        self._last(state, kind, text, lasted)

    def wait(self, text: str, since: float) -> None:
        """Determine that the source is not there yet, since when, s; as ``hinder`` does."""
        self._last(int(Flow.NO_CONNECTION), Flow.NO_CONNECTION, text, time.monotonic() - since)
        self._publish()

    def _last(self, state: int, kind: Flow, text: str, lasted: float) -> None:
        """Take a state that lasts; publish it when it begins, and log it now and then."""
        if self._lasting != (state, kind):
            self._log_again = max(AGAIN_AFTER, 2 * lasted)
        elif lasted > self._log_again:
            self._log_again = 2 * lasted
        else:  # published by the timer
            self.message.state, self.message.name, self.message.message = state, NAMES[state], text
            return
        self._lasting = state, kind
        self._change(state, text, kind not in ORDINARY)

    def _change(self, state: int, text: str, trouble: bool) -> None:
        """Publish and log a state."""
        message = self.message
        message.state, message.name, message.message = state, NAMES[state], text
        self._publish()
        logger = self._node.get_logger()
        if state == TrackerStatus.FAULT:  # rclpy wants one severity per line of code
            logger.error(f'{NAMES[state]}: {text}')
        elif trouble:
            logger.warning(f'{NAMES[state]}: {text}')
        else:
            logger.info(f'{NAMES[state]}: {text}')

    @property
    def health(self) -> Health:
        """How the source is; as of one that is not connected if there is none."""
        return self._backend.health if self._backend else Health(connected=False)

    @property
    def hardware(self) -> str:
        """What the samples come from: the device, or the backend while none is known."""
        return self.health.hardware or self.message.backend or 'no source yet'

    @property
    def pace(self) -> float:
        """Samples per second that are to be expected, Hz; 0 if the source does not tell."""
        return self.message.rate * (self._backend.real_time_factor if self._backend else 1.0)

    def describe(self, name: str) -> None:
        """State which backend will deliver samples."""
        self.message = TrackerStatus(backend=name)
        self._backend = None

    def begin(self, backend: Backend) -> None:
        """Begin a stream that can be told from all others."""
        self.message.stream_id = uuid.uuid4().hex[:12]
        self.message.samples_published = 0
        self.message.first = self.message.last = Time()
        self.latency = None
        self.source(backend)

    def take(self, batch: Samples) -> None:
        """Take samples that are about to be published, and publish the gaps that they end."""
        if len(batch) and not self.message.samples_published:
            self.message.first = time_from_ns(int(batch.stamp_ns[0]))
        self.message.samples_published += len(batch)
        if len(batch):
            self.message.last = time_from_ns(int(batch.stamp_ns[-1]))
        health = self.health
        if len(batch) and (health.clock or health.by_host):
            self.latency = (time.time_ns() - int(batch.stamp_ns[0])) * 1e-9
        for gap in health.gaps:
            if gap.first_ns <= self._told_ns:
                continue
            self._told_ns = gap.first_ns
            self._publish_gap(gap)

    def _publish_gap(self, gap: Gap) -> None:
        message = TrackerGap(
            header=self._header(),
            stream_id=self.message.stream_id,
            last=time_from_ns(gap.last_ns),
            first=time_from_ns(gap.first_ns),
            reason=gap.reason,
        )
        self._gaps.publish(message)
        lasted = (gap.first_ns - gap.last_ns) / NS
        self._node.get_logger().warning(f'gap of {lasted:.2f} s in the stream: {gap.reason}')

    def source(self, backend: Backend) -> None:
        """Take what is known of the samples to come."""
        self._backend = backend
        self.message.samples_expected = backend.expected
        self.message.rate = backend.rate

    def repeat(self, active: bool) -> None:
        """Switch the repetition on or off."""
        (self._timer.reset if active else self._timer.cancel)()

    def _publish(self) -> None:
        message, health = self.message, self.health
        message.header = self._header()
        message.beam = int(health.beam)
        message.interruptions = health.interruptions
        message.samples_left_out = sum(health.left_out.values())
        clock = health.clock or ClockState()
        message.clock_settled, message.clock_rate = clock.settled, clock.rate
        message.clock_spread, message.clock_jumps = clock.spread, clock.jumps
        streamed = self._backend is not None and message.stream_id
        message.real_time_factor = self._backend.real_time_factor if streamed else 0.0
        self._publisher.publish(message)

    def _header(self) -> Header:
        return header(self._node.get_clock().now().to_msg(), frames.tracker())
