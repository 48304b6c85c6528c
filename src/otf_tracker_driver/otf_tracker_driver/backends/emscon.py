# SPDX-License-Identifier: Apache-2.0
"""Backend for Leica trackers that speak emScon over TCP; see docs/trackers.md.

One thread keeps the tracker connected, configured and, if wanted, streaming, whatever happens:
connect, configure, wait until a stream is wanted, bring the beam onto the reflector, start, watch;
on trouble say so at once, mend it, go on.
"""

from __future__ import annotations

import contextlib
import math
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError
from otf_tracker_driver.backends import emscon_link as protocol
from otf_tracker_driver.backends.base import Beam, CommonConfig, Flow, Health
from otf_tracker_driver.backends.emscon_link import (
    Command,
    CommandRefused,
    ErrorReport,
    Event,
    Link,
    LinkError,
    Measurements,
    Packet,
    SampleStatus,
    Status,
    StatusChange,
    TrackerError,
    connected,
)
from otf_tracker_driver.backends.live import BEAT, FURTHEST, LiveBackend

FIRST_PAUSE, LONGEST_PAUSE = 0.2, 1.0
"""s; between attempts to connect or to find the reflector, doubled each time."""
IDLE = 0.05
"""s; how often a thread that streams nothing looks whether it shall."""
PATIENCE, INITIALISED = 8.0, 3.0
"""s; longer than it takes to set up a tracker that is initialised; and one that initialises for
longer goes on with that after ``connect``."""
SILENT_FOR, LONGEST_SILENCE = 1.0, 30.0
"""s; a tracker that streams sends packets three times per second, late by 60 ms at most. One that
sends nothing is started again after the first time, then after twice as long each time."""
LINGERS = 3.0
"""s; a tracker may take a connection for open for a while after its end."""
MOST_DOUBTED = 100
"""Packets that wait for a setting to be read back."""
SEARCH_DISTANCE = 3.0
"""m; where a search begins if nothing better is known."""
SENDS_NOTHING = 'the tracker measures and sends nothing'
NOT_MEASURING, NOT_CONFIRMED = 'came while no measurement was under way', 'settings not confirmed'
"""Why samples are left out."""
PASSING = frozenset({
    Status.BUSY, Status.NOT_INITIALISED, Status.NOT_READY, Status.MULTIPLE_CONNECTIONS,
    26, 38, 10004, 10005, 10012, 10015,
})  # fmt: skip
"""Refusals of a tracker that may be ready later."""
HARMLESS = frozenset({0, 1, 2, 3, 7, 17, 19, 24, 25, 26, 27, 28, 30, 31, 145, 151, 850, 999})
"""Events that leave units and coordinates as they are."""
ENVIRONMENT = ((-50.0, 60.0), (500.0, 1200.0), (0.0, 100.0))
WEATHER, TRANSFORMED, ORIENTED, UNSOLICITED, POSITIONS, TRY_MODE = 0, 1, 2, 4, 5, 6
"""Places in the system settings."""
NAMES = (
    'weather station', 'transformation', 'station orientation', 'keep last position',
    'reports of errors and events', 'reflector positions', 'try mode', 'level sensor', 'camera',
)  # fmt: skip
SHIFTS = {
    TRANSFORMED: (Command.GET_TRANSFORMATION, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
    ORIENTED: (Command.GET_STATION_ORIENTATION, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
}
"""What moves samples out of the tracker's own frame: how it is read, and what moves nothing."""
NOTHING_MOVED = 1e-9
"""m, rad, -; far less than a tracker resolves at 100 m."""


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

    def __post_init__(self) -> None:
        """Check also what bounds do not say."""
        super().__post_init__()
        if not self.host:
            raise ConfigError('host: empty; give the address of the tracker')
        if abs(self.interval * 1e3 - self.interval_ms) > 1e-6:
            raise ConfigError(f'interval: {self.interval:g} s; trackers take whole milliseconds')
        try:
            values = tuple(map(float, self.environment.split(','))) if self.environment else ()
            inside = [low <= v <= high for v, (low, high) in zip(values, ENVIRONMENT, strict=True)]
        except ValueError:
            inside = [not self.environment.strip()]
        if not all(inside):
            raise ConfigError(
                f'environment: {self.environment!r}; give temperature in C, pressure in mbar, '
                f'humidity in %, such as 20.0,1013.2,50'
            )

    @property
    def interval_ms(self) -> int:
        """Time from sample to sample, ms."""
        return round(self.interval * 1e3)


@dataclass(frozen=True)
class Tracker:
    """What is known of a tracker once it is configured.

    Attributes
    ----------
    environment : tuple of float or None
        Temperature, C; pressure, mbar; relative humidity, %.
    warnings : tuple of str
        Settings that it does not keep, and that it can be used with all the same.
    """

    name: str
    version: str
    serial: int
    reflector: str
    environment: tuple[float, ...] | None
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        """One line for people."""
        where = f'{self.name} {self.serial} (emScon {self.version}), reflector {self.reflector}'
        if self.environment is None:
            return where
        temperature, pressure, humidity = self.environment
        return f'{where}, {temperature:.1f} C, {pressure:.1f} mbar, {humidity:.0f} %'


def configure(link: Link, own: EmsconConfig, initialising: Callable[[], None]) -> Tracker:
    """Identify, initialise if needed, set everything and read it back.

    Parameters
    ----------
    initialising : callable
        Called before the tracker is initialised, which takes a while.

    Raises
    ------
    TrackerError
        If the tracker keeps another setting, or does not know the reflector.
    """
    status = [int(v) for v in link.ask(Command.GET_SYSTEM_STATUS)]
    info = link.optional(Command.GET_TRACKER_INFO)
    name = (str(info[1]).strip() if info else '') or 'tracker'
    if status[1] != protocol.PROCESSOR_INITIALISED:
        initialising()
        link.ask(Command.INITIALIZE)
    link.set(Command.SET_UNITS, Command.GET_UNITS, *protocol.SI_UNITS)
    warnings = _set_system(link, measured=not own.environment)
    cartesian = protocol.CARTESIAN_RIGHT_HANDED
    link.set(Command.SET_COORDINATE_SYSTEM, Command.GET_COORDINATE_SYSTEM, cartesian)
    reflector = set_reflector(link, own.reflector)
    if own.environment:
        values = map(float, own.environment.split(','))
        link.set(Command.SET_ENVIRONMENT, Command.GET_ENVIRONMENT, *values)
    environment = link.optional(Command.GET_ENVIRONMENT)
    mode = protocol.CONTINUOUS_TIME
    link.set(Command.SET_MEASUREMENT_MODE, Command.GET_MEASUREMENT_MODE, mode)
    continuous = (own.interval_ms, 0, 0, 0)
    link.set(Command.SET_CONTINUOUS_TIME, Command.GET_CONTINUOUS_TIME, *continuous)
    known = tuple(float(v) for v in environment) if environment else None
    version = '.'.join(map(str, status[4:7]))
    return Tracker(name, version, status[9], reflector, known, warnings)


def _unchanged(link: Link) -> str:
    """State which setting that gives the samples their meaning has changed; empty if none."""
    if link.ask(Command.GET_UNITS) != protocol.SI_UNITS:
        return 'units'
    if link.ask(Command.GET_COORDINATE_SYSTEM) != (protocol.CARTESIAN_RIGHT_HANDED,):
        return 'coordinate system'
    settings = link.optional(Command.GET_SYSTEM_SETTINGS)
    for place in SHIFTS if settings else ():
        if settings[place] and not _moves_nothing(link, place):
            return NAMES[place]
    return ''


def set_reflector(link: Link, name: str) -> str:
    """Set a reflector by its name, or keep the one that is set; return it."""
    known = link.reflectors()
    if name:
        names = tuple(known.values())
        number = next((n for n, other in known.items() if other == name), None)
        if number is None:
            near = get_close_matches(name, names, 1)
            hint = f'did you mean {near[0]}? ' if near else ''
            raise TrackerError(
                f'reflector {name!r} is unknown to the tracker; {hint}'
                f'possible: {", ".join(names) or "none"}'
            )
        link.set(Command.SET_REFLECTOR, Command.GET_REFLECTOR, number)
    (current,) = link.ask(Command.GET_REFLECTOR)
    return known.get(int(current), f'number {current}')


def _set_system(link: Link, measured: bool) -> tuple[str, ...]:
    """Switch transformations off and reports on; keep the weather station if it is used.

    Returns
    -------
    tuple of str
        Settings that the tracker acknowledges and does not keep, where that does no harm.
    """
    before = link.optional(Command.GET_SYSTEM_SETTINGS)
    if before is None:
        return tuple(
            f'setting {NAMES[place]} cannot be read; make sure that it is off, or the identity'
            for place in SHIFTS
            if not _moves_nothing(link, place)
        )
    settings = [int(v) for v in before]
    settings[TRANSFORMED] = settings[ORIENTED] = settings[POSITIONS] = settings[TRY_MODE] = 0
    settings[UNSOLICITED] = 1
    if not measured:
        settings[WEATHER] = 0
    link.ask(Command.SET_SYSTEM_SETTINGS, *settings)
    warnings = []
    for place, got in enumerate(link.ask(Command.GET_SYSTEM_SETTINGS)):
        if settings[place] == got:
            continue
        text = f'setting {NAMES[place]} (command 47) is acknowledged, but stays at {got}'
        if place in SHIFTS:
            if not _moves_nothing(link, place):
                raise TrackerError(
                    f'{text}, and {protocol.command_text(SHIFTS[place][0])} does not show an '
                    f'identity: samples would not be in the own frame of the tracker; reset it '
                    f'at the tracker, or see whether another program holds it'
                )
            text += '; it is the identity, and moves nothing'
        warnings.append(text)
    return tuple(warnings)


def _moves_nothing(link: Link, place: int) -> bool | None:
    """Whether a transformation or orientation is the identity; None if it cannot be read."""
    get, identity = SHIFTS[place]
    got = link.optional(get)
    if got is None:
        return None
    return all(abs(float(a) - b) < NOTHING_MOVED for a, b in zip(got, identity, strict=True))


def two_face_check(link: Link) -> tuple[float, float]:
    """Measure a target that stands still in both faces.

    Returns
    -------
    tuple of float
        Half the difference, face the tracker was in less the other, of horizontal and vertical
        angle, rad.
    """
    first = [float(angle) for angle in link.ask(Command.GET_DIRECTION)]
    link.ask(Command.CHANGE_FACE)
    horizontal, vertical = (float(angle) for angle in link.ask(Command.GET_DIRECTION))
    link.ask(Command.CHANGE_FACE)
    # a server may give the angles of the second face as its circles show them
    apart = [
        [math.remainder(a - b, 2 * math.pi) for a, b in zip(first, reading, strict=True)]
        for reading in ((horizontal, vertical), (horizontal + math.pi, -vertical))
    ]
    horizontal, vertical = min(apart, key=lambda pair: math.hypot(*pair))
    return horizontal / 2, vertical / 2


def _operation(name: str, link: Link, reflector: str) -> str:
    """Do what an operator asks for; return one sentence on what came of it."""
    if name == 'list_reflectors':
        return ', '.join(link.reflectors().values()) or 'the tracker knows no reflector'
    if name == 'set_reflector':
        return set_reflector(link, reflector)
    if name == 'bird_bath':
        link.ask(Command.GO_BIRD_BATH)
        return 'the beam is on the reflector in the bird bath, and the distance is set'
    if name == 'find_reflector':
        link.ask(Command.FIND_REFLECTOR, SEARCH_DISTANCE)
        return 'the reflector is found'
    if name == 'clear_errors':
        link.ask(Command.CLEAR_COMMAND_QUEUE, 0)
        return 'commands that were waiting in the tracker are cleared'
    horizontal, vertical = (1e6 * angle for angle in two_face_check(link))
    return (
        f'horizontal {horizontal:.2f} urad, vertical {vertical:.2f} urad: half the differences of '
        f'both faces, of a target at rest'
    )


class Emscon(LiveBackend):
    """Streams what a tracker measures, for as long as it is wanted."""

    parameters = EmsconConfig
    own: EmsconConfig

    def __init__(self, common: CommonConfig, own: EmsconConfig) -> None:
        super().__init__(common, own)
        self.rate, self.source = 1.0 / own.interval, f'tracker at {own.host}:{own.port}'
        self.tracker: Tracker | None = None
        self.initialising = False
        self._environment: tuple[float, ...] | None = None
        self._asked: queue.SimpleQueue[tuple[str, str, Future[str]]] = queue.SimpleQueue()
        self._measuring = self._doubt = self._closing = False
        self._why, self._kind = '', Flow.SILENT
        self._patience, self._last_range = SILENT_FOR, 0.0
        self._doubted: list[tuple[Measurements, int]] = []

    def connect(self) -> str:
        """Connect and configure; a tracker that has to initialise goes on with that meanwhile."""
        self.begin_work()
        began = time.monotonic()
        while self.tracker is None:
            self.check()
            if time.monotonic() - began > (INITIALISED if self.initialising else PATIENCE):
                break
            if self.cancelled():
                raise TrackerError(f'{self.source}: connecting was stopped')
            time.sleep(0.01)
        return f'{self.tracker or "tracker"} at {self.own.host}:{self.own.port}'

    @property
    def remark(self) -> str:  # type: ignore[override]
        """What the tracker does not keep."""
        warnings = self.tracker.warnings if self.tracker else ()
        return f'WARNING: {"; ".join(warnings)}' if warnings else ''

    @property
    def preparing(self) -> str:
        """Not empty while the tracker initialises or is being set up."""
        self.check()
        if self.tracker:
            return ''
        return 'the tracker initialises' if self.initialising else 'the tracker is being set up'

    @property
    def health(self) -> Health:
        """How tracker, link, beam and clock are."""
        tracker = self.tracker
        if tracker is None:
            return super().health
        return replace(
            super().health,
            device=str(tracker),
            hardware=f'{tracker.name} {tracker.serial}',
            environment=self._environment or tracker.environment,
            warnings=tracker.warnings,
        )

    def operate(self, name: str, own: Parameters) -> Future[str]:
        """Have the tracker do one of ``OPERATIONS`` while it does not measure."""
        assert isinstance(own, EmsconConfig), 'parameters of this backend'
        self.check()
        if name == 'set_reflector' and not own.reflector:
            raise ConfigError('parameter emscon.reflector: empty; name the reflector to set')
        if not self.connected:
            raise TrackerError(f'not connected: {self.trouble or "wait"}')
        done: Future[str] = Future()
        self._asked.put((name, own.reflector, done))
        return done

    # What follows runs in the thread.

    def work(self) -> None:
        """Connect and keep at it; raises TrackerError only if the first attempt fails."""
        pause, began = FIRST_PAUSE, time.monotonic()
        while not self.ended.is_set():
            try:
                arguments = self._unasked, self.host_clock.now_ns, self.ended
                with connected(self.own.host, self.own.port, *arguments) as link:
                    self._keep(link)
            except TrackerError as error:
                if self.ended.is_set():
                    break
                refused = isinstance(error, CommandRefused) and error.status
                # a tracker may just not have noticed that our last connection has ended
                ours = refused == Status.MULTIPLE_CONNECTIONS
                ours &= time.monotonic() - began < LINGERS
                if self.tracker is None and not ours:
                    passing = isinstance(error, LinkError) or refused in PASSING
                    kind = LinkError if passing else TrackerError
                    raise kind(f'{self.source}: {error}') from None
                self.beam = Beam.UNKNOWN
                text = f'{self.source}: {error}; connecting again'
                self.hinder(Flow.NO_CONNECTION, text)
            finally:
                if self.connected:
                    pause = FIRST_PAUSE
                self.connected = False
                self._answer_operators(None)
            self.ended.wait(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _keep(self, link: Link) -> None:
        """Configure, and stream whenever it is wanted; ends with an error only."""
        try:
            tracker = configure(link, self.own, self._initialise)
            self.initialising = self._doubt = self._closing = False
            self.connections += 1
            self.tracker, self.connected, pause = tracker, True, FIRST_PAUSE
            while True:
                try:
                    if not self.wanted:
                        if self.hindrance and self.hindrance.kind != Flow.STARTING:
                            self._hindrance = None
                        self._wait(link, IDLE)
                    elif self._on_target(link):
                        self._measure(link)
                    pause = FIRST_PAUSE
                except CommandRefused as refused:
                    self.hinder(Flow.SILENT, f'{refused}; trying again')
                    if refused.status == Status.NOT_INITIALISED:
                        raise LinkError('the tracker is not initialised any more') from None
                    self._wait(link, pause)
                    pause = min(2 * pause, LONGEST_SILENCE)
        finally:
            self.unreadable += link.unreadable

    def _initialise(self) -> None:
        self.initialising = True

    def _wait(self, link: Link, seconds: float) -> None:
        """Take what arrives for so long, and do what operators ask for."""
        link.pause(seconds)
        if self._closing:
            raise LinkError('the server is closing')
        self._answer_operators(link)

    def _answer_operators(self, link: Link | None) -> None:
        while not self._asked.empty():
            name, reflector, done = self._asked.get()
            try:
                if link is None:
                    raise TrackerError(f'not connected: {self.trouble or "wait"}')
                if self._measuring:
                    raise TrackerError('the tracker is measuring; stop it first')
                said = _operation(name, link, reflector)
                if name == 'set_reflector':
                    self.own = replace(self.own, reflector=said)
                    self.tracker = self.tracker and replace(self.tracker, reflector=said)
                done.set_result(said)
            except TrackerError as error:
                done.set_exception(error)
                if isinstance(error, LinkError) and link:
                    raise

    def _on_target(self, link: Link) -> bool:
        """Bring the beam onto the reflector; False if no stream is wanted any more."""
        pause = FIRST_PAUSE
        while self.wanted:
            try:
                bits = int(link.ask(Command.GET_MEASUREMENT_STATUS)[1])
            except CommandRefused:  # servers that cannot tell are believed to see it
                return True
            if bits & protocol.REFLECTOR_SEEN:
                return True
            self._lose_beam()
            lost = self._why or 'no reflector in the beam'
            if self.own.find_reflector:
                if pause == FIRST_PAUSE:
                    text = f'{lost}; the tracker searches for the reflector'
                    self.hinder(Flow.BEAM_BROKEN, text)
                try:
                    link.ask(Command.FIND_REFLECTOR, self._last_range or SEARCH_DISTANCE)
                    return True
                except CommandRefused as refused:
                    text = f'{lost}; searched in vain: {refused}; trying again'
                    self.hinder(Flow.BEAM_BROKEN, text)
            else:
                self.hinder(Flow.BEAM_BROKEN, f'{lost}; bring the beam back onto the reflector')
            self._wait(link, pause)
            pause = min(2 * pause, LONGEST_PAUSE)
        return False

    def _lose_beam(self) -> None:
        self.beam = Beam.SEARCHING if self.own.find_reflector else Beam.LOST

    def _measure(self, link: Link) -> None:
        """Start, and watch until the stream is not wanted any more or breaks off."""
        again = self.served == self.wanted
        try:
            self._why, self._doubted = '', []
            self.begin()
            self._measuring = True
            link.ask(Command.START_MEASUREMENT)
            self.stamper.started(link.asked_ns, link.answered_ns, link.sent_ns)
            self.beam = Beam.ON_TARGET
            self.restarts += again and self.hindrance is not None
            if self.hindrance:
                self.hinder(self.hindrance.kind, self.hindrance.text)
            self.silence.heard()
            while self.wanted_still and not self._why:
                link.read(BEAT)
                if self._closing:
                    raise LinkError('the server is closing')
                self._answer_operators(link)
                if self._doubt:
                    self._settle_doubt(link)
                if self.silence.beat() > self._patience and not link.unread:
                    self._patience = min(2 * self._patience, LONGEST_SILENCE)
                    self._kind, self._why = Flow.SILENT, SENDS_NOTHING
            with contextlib.suppress(CommandRefused):  # it may have stopped by itself
                link.ask(Command.STOP_MEASUREMENT)  # what comes before the answer counts
        except LinkError as error:
            if self.ended.is_set():
                link.tell(Command.STOP_MEASUREMENT)
            self._kind, self._why = Flow.NO_CONNECTION, self._why or str(error)
            raise
        finally:
            self._measuring = False
            self._leave_out_doubted(NOT_CONFIRMED)
            self.break_off(self._why)
            if self._why and self.wanted_still:
                more = '; starting it again' if self._why == SENDS_NOTHING else ''
                self.hinder(self._kind, self._why + more)

    def _settle_doubt(self, link: Link) -> None:
        """Read back what gives samples their meaning, after an event that may have changed it."""
        self._doubt = False
        changed = _unchanged(link)
        if changed:
            self._leave_out_doubted(f'{changed} changed')
            raise LinkError(f'another program has changed the {changed}; set again')
        doubted, self._doubted = self._doubted, []
        for packet, arrival_ns in doubted:
            self._take(packet, arrival_ns)

    def _leave_out_doubted(self, reason: str) -> None:
        self.left_out[reason] += sum(len(packet.status) for packet, _ in self._doubted)
        self._doubted = []

    def _unasked(self, packet: Packet, arrival_ns: int) -> None:
        """Take what the tracker sends by itself."""
        if isinstance(packet, StatusChange):
            self._closing |= packet.event == Event.SERVER_CLOSING
            self._doubt |= packet.event not in HARMLESS
        elif isinstance(packet, ErrorReport) and self._measuring:
            lost = packet.status == Status.BEAM_LOST
            if lost:
                self._lose_beam()
            self._kind = Flow.BEAM_BROKEN if lost else Flow.SILENT
            self._why = self._why or protocol.status_text(packet.status)
        elif isinstance(packet, Measurements) and not self._measuring:
            self.left_out[NOT_MEASURING] += len(packet.status) if self.wanted else 0
        elif isinstance(packet, Measurements) and self.wanted_still:
            self.silence.heard()
            if not self._doubt:
                self._take(packet, arrival_ns)
                return
            if len(self._doubted) >= MOST_DOUBTED:
                self.left_out[NOT_CONFIRMED] += len(self._doubted.pop(0)[0].status)
            self._doubted.append((packet, arrival_ns))

    def _take(self, packet: Measurements, arrival_ns: int) -> None:
        """Stamp what the tracker says is measured; count the rest by reason."""
        if np.all(np.isfinite(packet.environment)):
            self._environment = packet.environment
        usable = self._usable(packet)
        with np.errstate(invalid='ignore', over='ignore'):
            distance = np.linalg.norm(packet.value, axis=1)
            sane = np.isfinite(packet.value).all(axis=1) & (distance < FURTHEST) & (distance > 0)
        self.left_out['no point'] += int(np.count_nonzero(usable & ~sane))
        valid = usable & sane
        if valid.any():
            self._last_range, self._patience = float(distance[valid][-1]), SILENT_FOR
        self.measured(packet.device_ns, packet.value, arrival_ns, valid)
        if len(packet.status) and np.all(packet.status == SampleStatus.PRISM_ERROR):
            self._lose_beam()
            self._kind, self._why = Flow.BEAM_BROKEN, self._why or 'no reflector in any sample'
        elif not valid.any() and time.monotonic() - self._since > SILENT_FOR and not self._why:
            self.hinder(Flow.SILENT, 'the tracker sends no sample that can be used')

    def _usable(self, packet: Measurements) -> NDArray[np.bool_]:
        """Samples that the tracker says are measured; counts the others by reason."""
        status = packet.status
        if packet.result != Status.OK:
            self.left_out[protocol.status_text(packet.result)] += len(status)
            return np.zeros(len(status), bool)
        usable = (status == SampleStatus.OK) | (status == SampleStatus.SPEED_WARNING)
        for code in np.unique(status[~usable]).tolist():
            text = protocol.SAMPLE_TEXT.get(code, f'sample status {code}')
            self.left_out[text] += int(np.count_nonzero(status == code))
        return usable
