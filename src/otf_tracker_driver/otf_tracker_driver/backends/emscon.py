# SPDX-License-Identifier: Apache-2.0
"""Backend for Leica trackers that speak emScon over TCP; see docs/tracker-protocol.md."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import dataclass

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError
from otf_core.model.observation import Samples
from otf_tracker_driver.backends.base import NO_SAMPLES, Backend, CommonConfig, join_samples
from otf_tracker_driver.emscon.configure import MeasurementSetup
from otf_tracker_driver.emscon.errors import TrackerError
from otf_tracker_driver.emscon.operations import OPERATIONS
from otf_tracker_driver.emscon.session import Address
from otf_tracker_driver.emscon.state import (
    CONFIGURING,
    CONNECTING,
    INITIALISING,
    SessionState,
)
from otf_tracker_driver.emscon.thread import SessionThread
from otf_tracker_driver.health import Health, Hindrance, count_left_out

PATIENCE, INITIALISED = 8.0, 3.0
"""s; longer than it takes to set up a tracker that is initialised; and one that initialises for
longer goes on with that after ``connect``."""
PAUSE = 0.01
ENVIRONMENT = ((-50.0, 60.0), (500.0, 1200.0), (0.0, 100.0))


@dataclass(frozen=True)
class EmsconConfig(Parameters):
    """Where the tracker is, and how it is to measure."""

    host: str = parameter(
        '127.0.0.1', 'address of the tracker; the factory setting is 192.168.0.1'
    )
    port: int = parameter(700, 'TCP port of the tracker', '', 1, 65535)
    interval: float = parameter(
        0.002, 'time from sample to sample, in whole milliseconds', 's', 0.001, 1.0
    )
    reflector: str = parameter('', 'name of the reflector in the tracker; empty: the current one')
    environment: str = parameter(
        '', 'temperature (C), pressure (mbar), humidity (%), such as 20.0,1013.2,50; empty: '
        'values set in the tracker, or those of its weather station',
    )  # fmt: skip
    find_reflector: bool = parameter(
        True, 'the tracker may search for the reflector when the beam is lost'
    )


class Emscon(Backend):
    """Streams what a tracker measures, for as long as it is wanted."""

    parameters = EmsconConfig
    own: EmsconConfig

    def __init__(self, common: CommonConfig, own: EmsconConfig) -> None:
        super().__init__(common, own)
        self._thread: SessionThread | None = None
        self._streams = False
        self.rate = 1.0 / own.interval

    @property
    def state(self) -> SessionState | None:
        """What is known of tracker, link and clock; None while disconnected."""
        return self._thread.state if self._thread else None

    def connect(self) -> str:
        """Connect and configure; a tracker that has to initialise goes on with that meanwhile."""
        own = self.own
        if not own.host:
            raise ConfigError('parameter emscon.host: empty; give the address of the tracker')
        wanted = MeasurementSetup(
            _milliseconds(own.interval), own.reflector, _environment(own.environment)
        )
        self._thread = SessionThread(Address(own.host, own.port), wanted, own.find_reflector)
        began = time.monotonic()
        while not self._thread.configured:
            initialising = self._thread.state.phase == INITIALISING
            if time.monotonic() - began > (INITIALISED if initialising else PATIENCE):
                break
            if self.cancelled():
                raise TrackerError(f'tracker at {own.host}:{own.port}: connecting was stopped')
            time.sleep(PAUSE)
        known = self._thread.state.tracker
        return f'{known or "tracker"} at {own.host}:{own.port}'

    @property
    def remark(self) -> str:  # type: ignore[override]
        """What the tracker does not keep."""
        warnings = '; '.join(self.health.warnings)
        return f'WARNING: {warnings}' if warnings else ''

    @property
    def preparing(self) -> str:
        """Not empty while the tracker initialises or is being set up."""
        if self._thread is None or self._thread.configured:
            return ''
        initialising = self._thread.state.phase == INITIALISING
        return 'the tracker initialises' if initialising else 'the tracker is being set up'

    @property
    def hindrance(self) -> Hindrance | None:
        """What keeps samples from flowing just now."""
        return self._thread.state.hindrance if self._thread else None

    @property
    def health(self) -> Health:
        """How tracker, link, beam and clock are."""
        state = self.state
        if state is None:
            return Health(connected=False)
        return Health(
            connected=state.phase not in (CONNECTING, CONFIGURING, INITIALISING),
            device=str(state.tracker or ''),
            hardware=state.tracker.hardware if state.tracker else '',
            beam=state.beam,
            clock=state.clock,
            environment=state.environment or (state.tracker and state.tracker.environment),
            connections=state.connections,
            interruptions=state.interruptions,
            left_out=count_left_out(state.repeated, state.left_out),
            unreadable=state.unreadable,
            warnings=state.tracker.warnings if state.tracker else (),
            gaps=state.gaps,
        )

    def operate(self, name: str, own: Parameters) -> Future[str]:
        """Have the tracker do one of ``OPERATIONS``."""
        assert isinstance(own, EmsconConfig), 'parameters of this backend'
        if self._thread is None:
            raise TrackerError('not connected; configure first')
        if name == 'set_reflector':
            if not own.reflector:
                raise ConfigError('parameter emscon.reflector: empty; name the reflector to set')
            return self._thread.use_reflector(own.reflector)
        return self._thread.do(OPERATIONS[name])

    def start(self) -> None:
        """Have the tracker measure."""
        if self._thread:
            self._thread.stream(True)
            self._streams = True

    def poll(self) -> Samples:
        """Return what has been stamped since the last call."""
        if self._thread is None or not self._streams:
            return NO_SAMPLES
        assert self._thread.configured, 'asked before the start'
        return join_samples(self._thread.fetch())

    @property
    def finished(self) -> bool:
        """Never true: a tracker measures until it is stopped."""
        return False

    def stop(self) -> None:
        """Have the tracker stop."""
        if self._thread and self._streams:
            self._thread.stream(False)
        self._streams = False

    def disconnect(self) -> None:
        """Stop and disconnect."""
        self.stop()
        if self._thread:
            self._thread.close()
            self._thread = None


def _milliseconds(interval: float) -> int:
    whole = round(interval * 1e3)
    if abs(interval * 1e3 - whole) > 1e-6:
        raise ConfigError(
            f'parameter emscon.interval: {interval:g} s; trackers take whole milliseconds'
        )
    return whole


def _environment(text: str) -> tuple[float, float, float] | None:
    """Read the three numbers; None if there are none."""
    if not text.strip():
        return None
    wrong = ConfigError(
        f'parameter emscon.environment: {text!r}; give temperature in C, pressure in mbar, '
        f'humidity in %, such as 20.0,1013.2,50'
    )
    try:
        temperature, pressure, humidity = map(float, text.split(','))
    except ValueError:
        raise wrong from None
    values = temperature, pressure, humidity
    if not all(low <= v <= high for v, (low, high) in zip(values, ENVIRONMENT, strict=True)):
        raise wrong
    return values
