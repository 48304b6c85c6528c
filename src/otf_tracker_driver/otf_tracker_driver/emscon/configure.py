# SPDX-License-Identifier: Apache-2.0
"""Everything a tracker has to be told before it measures, each setting read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches

from otf_tracker_driver.emscon import codes
from otf_tracker_driver.emscon.codes import Command, Status
from otf_tracker_driver.emscon.commands import Value
from otf_tracker_driver.emscon.errors import CommandRefused, TrackerError
from otf_tracker_driver.emscon.link import Link

UNITS = (
    codes.METRE,
    codes.RADIAN,
    codes.CELSIUS,
    codes.MILLIBAR,
    codes.RELATIVE_HUMIDITY,
)
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
class MeasurementSetup:
    """How the tracker is to measure.

    Attributes
    ----------
    interval_ms : int
        From sample to sample.
    reflector : str
        Name in the tracker's list; empty: the one that is set.
    environment : tuple of float or None
        Temperature, C; pressure, mbar; relative humidity, %. None: what the tracker knows.
    """

    interval_ms: int
    reflector: str = ''
    environment: tuple[float, float, float] | None = None


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
    reflectors: tuple[str, ...]
    environment: tuple[float, float, float] | None
    warnings: tuple[str, ...] = ()

    @property
    def hardware(self) -> str:
        """Name and serial number."""
        return f'{self.name} {self.serial}'

    def __str__(self) -> str:
        """One line for people."""
        where = f'{self.hardware} (emScon {self.version}), reflector {self.reflector}'
        if self.environment is None:
            return where
        temperature, pressure, humidity = self.environment
        return f'{where}, {temperature:.1f} C, {pressure:.1f} mbar, {humidity:.0f} %'


async def identify(link: Link) -> tuple[str, str, int, bool]:
    """Return name, version, serial number, and whether the tracker is initialised."""
    status = [int(v) for v in await link.ask(Command.GET_SYSTEM_STATUS)]
    version = '.'.join(map(str, status[4:7]))
    info = await _optional(link, Command.GET_TRACKER_INFO)
    name = str(info[1]).strip() if info else ''
    return name or 'tracker', version, status[9], status[1] == codes.PROCESSOR_INITIALISED


async def configure(
    link: Link, wanted: MeasurementSetup, initialising: Callable[[], None]
) -> Tracker:
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
    name, version, serial, initialised = await identify(link)
    if not initialised:
        initialising()
        await link.ask(Command.INITIALIZE)
    await _set(link, Command.SET_UNITS, Command.GET_UNITS, *UNITS)
    warnings = await _set_system(link, measured=wanted.environment is None)
    cartesian = codes.CARTESIAN_RIGHT_HANDED
    await _set(link, Command.SET_COORDINATE_SYSTEM, Command.GET_COORDINATE_SYSTEM, cartesian)
    reflector, reflectors = await set_reflector(link, wanted.reflector)
    if wanted.environment is not None:
        await _set(link, Command.SET_ENVIRONMENT, Command.GET_ENVIRONMENT, *wanted.environment)
    environment = await _optional(link, Command.GET_ENVIRONMENT)
    mode = codes.CONTINUOUS_TIME
    await _set(link, Command.SET_MEASUREMENT_MODE, Command.GET_MEASUREMENT_MODE, mode)
    continuous = (wanted.interval_ms, 0, 0, 0)
    await _set(link, Command.SET_CONTINUOUS_TIME, Command.GET_CONTINUOUS_TIME, *continuous)
    known = tuple(float(v) for v in environment) if environment else None
    return Tracker(name, version, serial, reflector, reflectors, known, warnings)  # type: ignore[arg-type]


async def unchanged(link: Link) -> str:
    """State which setting that gives the samples their meaning has changed; empty if none."""
    if await link.ask(Command.GET_UNITS) != UNITS:
        return 'units'
    if await link.ask(Command.GET_COORDINATE_SYSTEM) != (codes.CARTESIAN_RIGHT_HANDED,):
        return 'coordinate system'
    settings = await _optional(link, Command.GET_SYSTEM_SETTINGS)
    for place in SHIFTS if settings else ():
        if settings[place] and not await _moves_nothing(link, place):
            return NAMES[place]
    return ''


async def set_reflector(link: Link, name: str) -> tuple[str, tuple[str, ...]]:
    """Set a reflector by its name, or keep the one that is set; return it and all names."""
    known = await link.reflectors()
    names = tuple(known.values())
    if name:
        number = next((n for n, other in known.items() if other == name), None)
        if number is None:
            near = get_close_matches(name, names, 1)
            hint = f'did you mean {near[0]}? ' if near else ''
            raise TrackerError(
                f'reflector {name!r} is unknown to the tracker; {hint}'
                f'possible: {", ".join(names) or "none"}'
            )
        await _set(link, Command.SET_REFLECTOR, Command.GET_REFLECTOR, number)
    (current,) = await link.ask(Command.GET_REFLECTOR)
    return known.get(int(current), f'number {current}'), names


async def _set_system(link: Link, measured: bool) -> tuple[str, ...]:
    """Switch transformations off and reports on; keep the weather station if it is used.

    Returns
    -------
    tuple of str
        Settings that the tracker acknowledges and does not keep, where that does no harm.
    """
    before = await _optional(link, Command.GET_SYSTEM_SETTINGS)
    if before is None:
        return tuple(
            [
                f'setting {NAMES[place]} cannot be read; make sure that it is off, or the identity'
                for place in SHIFTS
                if not await _moves_nothing(link, place)
            ]
        )
    settings = [int(v) for v in before]
    settings[TRANSFORMED] = settings[ORIENTED] = settings[POSITIONS] = settings[TRY_MODE] = 0
    settings[UNSOLICITED] = 1
    if not measured:
        settings[WEATHER] = 0
    await link.ask(Command.SET_SYSTEM_SETTINGS, *settings)
    actual = await link.ask(Command.GET_SYSTEM_SETTINGS)
    warnings = []
    for place, (wanted, got) in enumerate(zip(settings, actual, strict=True)):
        if wanted == got:
            continue
        text = f'setting {NAMES[place]} (command 47) is acknowledged, but stays at {got}'
        if place in SHIFTS:
            if not await _moves_nothing(link, place):
                raise TrackerError(
                    f'{text}, and {codes.command_text(SHIFTS[place][0])} does not show an '
                    f'identity: samples would not be in the own frame of the tracker; reset it '
                    f'at the tracker, or see whether another program holds it'
                )
            text += '; it is the identity, and moves nothing'
        warnings.append(text)
    return tuple(warnings)


async def _moves_nothing(link: Link, place: int) -> bool | None:
    """Whether a transformation or orientation is the identity; None if it cannot be read."""
    get, identity = SHIFTS[place]
    got = await _optional(link, get)
    if got is None:
        return None
    return all(abs(float(a) - b) < NOTHING_MOVED for a, b in zip(got, identity, strict=True))


async def _set(link: Link, set_: Command, get: Command, *values: Value) -> None:
    """Set values and read them back."""
    await link.ask(set_, *values)
    got = await link.ask(get)
    # servers may keep doubles with less digits
    if any(abs(float(a) - float(b)) > 1e-3 for a, b in zip(got, values, strict=True)):
        raise TrackerError(
            f'{codes.command_text(set_)}: {values} is set, but the tracker keeps {got}; set it '
            f'at the tracker, or see whether another program holds it'
        )


async def _optional(link: Link, command: Command) -> tuple[Value, ...] | None:
    """Answer of a command that not every server knows."""
    try:
        return await link.ask(command)
    except CommandRefused as refused:
        if refused.status != Status.NOT_IMPLEMENTED:
            raise
        return None
