# SPDX-License-Identifier: Apache-2.0
"""What the driver tells on ``/diagnostics``: link, beam, stream, clock, losses, air, memory."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial

from otf_msgs.msg import TrackerStatus
from otf_ros.diagnostics import Finding, Level, memory
from otf_tracker_driver.health import Beam, Health
from otf_tracker_driver.status import Status

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
    inside = TEMPERATURE[0] <= temperature <= TEMPERATURE[1]
    inside &= PRESSURE[0] <= pressure <= PRESSURE[1]
    text = f'{temperature:.1f} C, {pressure:.1f} mbar, {humidity:.0f} %'
    if inside:
        return Finding(Level.OK, text, values)
    return Finding(Level.ERROR, f'{text}: check the weather station, or set it', values)


class Rate:
    """Samples per second that the driver has published, over the last seconds."""

    def __init__(self, status: Status) -> None:
        self._status = status
        self._stream = ''
        self._seen: deque[tuple[float, int]] = deque(maxlen=LOOKS)

    def __call__(self) -> Finding:
        """Compare with the rate that the source promises."""
        message = self._status.message
        if message.state != TrackerStatus.STREAMING:
            self._seen.clear()
            level = LEVELS.get(message.state, Level.ERROR)
            values = {'no samples for [s]': message.silent_for, 'restarts': message.restarts}
            return Finding(level, f'{message.name}: {message.message}', values)
        if message.stream_id != self._stream:
            self._stream = message.stream_id
            self._seen.clear()
        self._seen.append((time.monotonic(), message.samples_published))
        (begun, before), (now, count) = self._seen[0], self._seen[-1]
        if now == begun:
            return Finding(Level.OK, 'the stream has begun')
        rate, nominal = (count - before) / (now - begun), self._status.pace
        values = {'rate [Hz]': rate, 'nominal rate [Hz]': nominal}
        values['times as fast as measured'] = message.real_time_factor
        if self._status.latency is not None:
            values['age of the oldest sample of a batch [s]'] = self._status.latency
        text = f'{rate:.0f} Hz; {message.message}'
        if not rate:
            return Finding(Level.ERROR, text, values)
        return Finding(Level.WARN if rate < SLOW * nominal else Level.OK, text, values)


SEEN: Mapping[str, Callable[[Health], Finding]] = {
    'link': link,
    'beam': beam,
    'clock': clock,
    'losses': losses,
    'environment': environment,
}


def tasks(status: Status) -> Mapping[str, Callable[[], Finding]]:
    """Tasks of the driver by their names."""
    looks = {name: partial(_look, look, status) for name, look in SEEN.items()}
    return {**looks, 'stream': Rate(status), 'memory': memory}


def _look(look: Callable[[Health], Finding], status: Status) -> Finding:
    return look(status.health)
