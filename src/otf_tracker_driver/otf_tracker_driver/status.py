# SPDX-License-Identifier: Apache-2.0
"""What the driver tells: the latched status, gaps of the stream, and ``/diagnostics``."""

from __future__ import annotations

import time
import uuid
from collections import deque

from builtin_interfaces.msg import Time
from rclpy.node import Node

from otf_core.model.observation import Samples
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import convert, frames, qos
from otf_ros.convert import NS, header, time_from_ns
from otf_ros.diagnostics import Diagnostics, Finding, Level, memory
from otf_ros.timers import create_timer
from otf_tracker_driver.backends import Backend
from otf_tracker_driver.backends.base import ORDINARY, Beam, Flow, Gap, Health, Hindrance
from otf_tracker_driver.clock import ClockState

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
BEHIND = 2.0
"""s; a backlog that is warned of."""
PERIOD = 0.5
"""s; how often the status is repeated while active."""
SPREAD = 0.01
"""s; packets that are later than that by habit are no stamps of a quiet network."""
SLOW = 0.8
"""Of the nominal rate; less is warned of."""
TEMPERATURE, PRESSURE = (0.0, 45.0), (650.0, 1100.0)
"""C and mbar; what trackers are specified for."""
BEAMS = {
    Beam.UNKNOWN: (Level.OK, 'the source does not report it'),
    Beam.ON_TARGET: (Level.OK, 'on the reflector'),
    Beam.LOST: (Level.ERROR, 'lost; bring it back onto the reflector'),
    Beam.SEARCHING: (Level.WARN, 'lost; the tracker searches for the reflector'),
}
LEVELS = {
    TrackerStatus.IDLE: Level.OK,
    TrackerStatus.FINISHED: Level.OK,
    TrackerStatus.STARTING: Level.OK,
    TrackerStatus.WAITING_FOR_CLOCK: Level.WARN,
}
"""Of a driver that publishes no samples; all other states are errors."""
LOOKS = 4
"""Of these the oldest and the newest give the rate."""


class Status:
    """Publishes ``tracker/status`` for a node, on change and repeatedly while active."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(TrackerStatus, 'tracker/status', qos.STATUS)
        self._gaps = node.create_publisher(TrackerGap, 'tracker/gap', qos.EVENTS)
        self._timer = create_timer(node, PERIOD, self._publish, autostart=False)
        self.message = TrackerStatus()
        self._backend: Backend | None = None
        self._told_ns = 0
        self._lasting: tuple[int, Flow] | None = None
        self._log_again, self._oldest = AGAIN_AFTER, 0.0
        self._seen: deque[tuple[float, int]] = deque(maxlen=LOOKS)
        looks = {look.__name__: look for look in (link, beam, clock, losses, environment)}
        tasks = {name: lambda look=look: look(self.health) for name, look in looks.items()}
        Diagnostics(node, self._hardware, {**tasks, 'stream': self._flow, 'memory': memory})

    def report(self, state: int, text: str, trouble: bool = False) -> None:
        """Publish a state, and log it, as a warning if it is trouble; not the same once more."""
        message = self.message
        self._lasting = None
        if (message.state, message.message) == (state, text):
            return
        message.silent_for, message.restarts = 0.0, 0
        self._change(state, text, trouble)

    def fault(self, text: str) -> None:
        """Report that something has to be corrected."""
        self.report(TrackerStatus.FAULT, text)

    def stream(self, trouble: str) -> None:
        """Report that samples flow, with what is wrong all the same."""
        assert self._backend is not None
        if self.message.backlog > BEHIND:
            trouble = trouble or f'more than {BEHIND:g} s behind the source; this computer is busy'
        text = trouble or f'streaming {self._backend.remark}'.strip()
        self.report(TrackerStatus.STREAMING, text, bool(trouble or self._backend.health.warnings))

    def hinder(self, hindrance: Hindrance, trouble: str = '') -> None:
        """Determine that no samples flow, for how long, and why; log it now, and ever less often.

        Parameters
        ----------
        trouble : str
            What else is wrong; instead of the text of the hindrance.
        """
        lasted, kind = time.monotonic() - hindrance.since, hindrance.kind
        fault = kind in HELD_UP and lasted > FAULT_AFTER
        text = trouble or hindrance.text
        if lasted >= 1.0:
            text += f'; no samples for {lasted:.0f} s'
        if hindrance.restarts and kind not in ORDINARY:
            text += f', {hindrance.restarts} restart{"s" if hindrance.restarts > 1 else ""}'
        self.message.silent_for, self.message.restarts = lasted, hindrance.restarts
        self._last(TrackerStatus.FAULT if fault else int(kind), kind, text, lasted)

    def wait(self, text: str, since: float) -> None:
        """Determine that the source is not there yet, since when, s; as ``hinder`` does."""
        self._last(int(Flow.NO_CONNECTION), Flow.NO_CONNECTION, text, time.monotonic() - since)
        self._publish()

    def _last(self, state: int, kind: Flow, text: str, lasted: float) -> None:
        """Take a state that lasts; publish it when it begins, and log it now and then."""
        if self._lasting == (state, kind) and lasted <= self._log_again:
            message = self.message  # published by the timer
            message.state, message.name, message.message = state, NAMES[state], text
            return
        self._log_again = max(AGAIN_AFTER, 2 * lasted)
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

    def _hardware(self) -> str:
        """What the samples come from: the device, or the backend while none is known."""
        return self.health.hardware or self.message.backend or 'no source yet'

    def describe(self, name: str) -> None:
        """State which backend will deliver samples."""
        self.message = TrackerStatus(backend=name)
        self._backend = None

    def source(self, backend: Backend) -> None:
        """Take what is known of the samples to come."""
        self._backend = backend
        self.message.samples_expected = backend.expected
        self.message.rate = backend.rate

    def begin(self, backend: Backend) -> None:
        """Begin a stream that can be told from all others."""
        self.message.stream_id = uuid.uuid4().hex[:12]
        self.message.samples_published = 0
        self.message.first = self.message.last = Time()
        self._oldest = 0.0
        self._seen.clear()
        self.source(backend)

    def take(self, batch: Samples, backlog: float) -> None:
        """Take samples that are about to be published, and publish the gaps that they end."""
        message, health = self.message, self.health
        message.backlog = backlog
        if not len(batch):
            return
        if not message.samples_published:
            message.first = time_from_ns(int(batch.stamp_ns[0]))
        message.samples_published += len(batch)
        message.last = time_from_ns(int(batch.stamp_ns[-1]))
        if health.clock or health.by_host:
            self._oldest = (time.time_ns() - int(batch.stamp_ns[0])) * 1e-9
        for gap in health.gaps:
            if self._told_ns < gap.first_ns <= batch.stamp_ns[-1]:
                self._told_ns = gap.first_ns
                self._publish_gap(gap)

    def _publish_gap(self, gap: Gap) -> None:
        message = TrackerGap(
            header=header(convert.now(self._node), frames.tracker()),
            stream_id=self.message.stream_id,
            last=time_from_ns(gap.last_ns),
            first=time_from_ns(gap.first_ns),
            reason=gap.reason,
        )
        self._gaps.publish(message)
        lasted = (gap.first_ns - gap.last_ns) / NS
        self._node.get_logger().warning(f'gap of {lasted:.2f} s in the stream: {gap.reason}')

    def repeat(self, active: bool) -> None:
        """Switch the repetition on or off."""
        (self._timer.reset if active else self._timer.cancel)()

    def _publish(self) -> None:
        message, health = self.message, self.health
        message.header = header(convert.now(self._node), frames.tracker())
        message.beam = int(health.beam)
        message.interruptions = health.interruptions
        message.samples_left_out = sum(health.left_out.values())
        clock = health.clock or ClockState()
        message.clock_settled, message.clock_rate = clock.settled, clock.rate
        message.clock_spread, message.clock_jumps = clock.spread, clock.jumps
        streamed = self._backend is not None and message.stream_id
        message.real_time_factor = self._backend.real_time_factor if streamed else 0.0
        self._publisher.publish(message)

    def _flow(self) -> Finding:
        """Compare the samples of the last seconds with the rate that the source promises."""
        message = self.message
        if message.state != TrackerStatus.STREAMING or self._backend is None:
            self._seen.clear()
            level = LEVELS.get(message.state, Level.ERROR)
            values: dict[str, float] = {'no samples for [s]': message.silent_for}
            values['restarts'] = message.restarts
            return Finding(level, f'{message.name}: {message.message}', values)
        self._seen.append((time.monotonic(), message.samples_published))
        (begun, before), (now, count) = self._seen[0], self._seen[-1]
        if now == begun:
            return Finding(Level.OK, 'the stream has begun')
        rate = (count - before) / (now - begun)
        nominal = message.rate * self._backend.real_time_factor
        values = {'rate [Hz]': rate, 'nominal rate [Hz]': nominal, 'backlog [s]': message.backlog}
        values['times as fast as measured'] = message.real_time_factor
        values['age of the oldest sample of a batch [s]'] = self._oldest
        level = Level.WARN if rate < SLOW * nominal or message.backlog > BEHIND else Level.OK
        return Finding(level if rate else Level.ERROR, f'{rate:.0f} Hz; {message.message}', values)


def link(health: Health) -> Finding:
    """Whether there is a connection."""
    values = {'connections': health.connections, 'unreadable': health.unreadable}
    if not health.connected:
        return Finding(Level.ERROR, 'not connected', values)
    if health.warnings:
        return Finding(Level.WARN, '; '.join(health.warnings), values)
    return Finding(Level.OK, health.device or 'connected', values)


def beam(health: Health) -> Finding:
    """Where the beam is."""
    level, text = BEAMS[health.beam]
    return Finding(level, text, {'interruptions': health.interruptions})


def clock(health: Health) -> Finding:
    """How well times of the source are known on the host's clock."""
    state = health.clock
    if health.by_host:
        return Finding(Level.WARN, 'stamped on arrival, as declared')
    if state is None:
        return Finding(Level.OK, 'stamps come with the samples')
    values = {
        'rate [ppm]': 1e6 * state.rate,
        'spread of packets [ms]': 1e3 * state.spread,
        'delay of the last packet [ms]': 1e3 * state.delay,
        'jumps': state.jumps,
        'late packets': state.late,
    }
    if not state.settled:
        return Finding(Level.WARN, 'not known yet: samples wait for packets', values)
    if state.spread > SPREAD:
        return Finding(Level.WARN, 'packets come irregularly; stamps are uncertain', values)
    return Finding(Level.OK, 'followed', values)


def losses(health: Health) -> Finding:
    """What the source sent and was left out."""
    total = sum(health.left_out.values())
    if not total:
        return Finding(Level.OK, 'nothing left out')
    values = {f'{reason} [samples]': count for reason, count in health.left_out.items()}
    return Finding(Level.WARN, f'{total} samples left out since connecting', values)


def environment(health: Health) -> Finding:
    """Air as the tracker knows it."""
    if health.environment is None:
        return Finding(Level.OK, 'not reported by the source')
    temperature, pressure, humidity = health.environment
    names = 'temperature [C]', 'pressure [mbar]', 'humidity [%]'
    values = dict(zip(names, health.environment, strict=True))
    text = f'{temperature:.1f} C, {pressure:.1f} mbar, {humidity:.0f} %'
    inside = TEMPERATURE[0] <= temperature <= TEMPERATURE[1]
    if inside and PRESSURE[0] <= pressure <= PRESSURE[1]:
        return Finding(Level.OK, text, values)
    return Finding(Level.ERROR, f'{text}: check the weather station, or set it', values)
