# SPDX-License-Identifier: Apache-2.0
"""Numbers of the emScon protocol and what they mean; unknown ones get a text, too."""

from __future__ import annotations

from enum import IntEnum


class PacketType(IntEnum):
    """Second word of every packet."""

    COMMAND = 0
    ERROR = 1
    SINGLE = 2
    MULTI = 3
    REFLECTOR_POSITION = 7
    EVENT = 8
    SINGLE_2 = 9
    MULTI_2 = 10


class Command(IntEnum):
    """Commands that this driver or its emulator speaks."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    SET_UNITS = 5
    GET_UNITS = 6
    INITIALIZE = 7
    GET_STATION_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    SET_ENVIRONMENT = 20
    GET_ENVIRONMENT = 21
    SET_MEASUREMENT_MODE = 24
    GET_MEASUREMENT_MODE = 25
    SET_COORDINATE_SYSTEM = 26
    GET_COORDINATE_SYSTEM = 27
    SET_CONTINUOUS_TIME = 30
    GET_CONTINUOUS_TIME = 31
    SET_REFLECTOR = 40
    GET_REFLECTOR = 41
    GET_REFLECTORS = 42
    SET_SYSTEM_SETTINGS = 47
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    FIND_REFLECTOR = 63
    UNSOLICITED = 64
    GET_DIRECTION = 66
    SET_STATISTIC_MODE = 80
    GET_STATISTIC_MODE = 81
    GET_FACE = 98
    GET_MEASUREMENT_STATUS = 122
    CLEAR_COMMAND_QUEUE = 130
    GET_TRACKER_INFO = 132
    GET_SOFTWARE_VERSION = 142


class Status(IntEnum):
    """Result codes that are acted upon."""

    OK = 0
    BUSY = 1
    NOT_IMPLEMENTED = 2
    WRONG_PARAMETER = 3
    WRONG_REFLECTOR = 23
    NOT_INITIALISED = 39
    MULTIPLE_CONNECTIONS = 10011
    NOT_READY = 10014
    BEAM_LOST = 701


class SampleStatus(IntEnum):
    """First word of every sample of a continuous measurement."""

    OK = 0
    SPEED_WARNING = 1
    SPEED_EXCEEDED = 2
    PRISM_ERROR = 3
    TRIGGER_VIOLATION = 4


class Event(IntEnum):
    """System status changes that are acted upon or sent by the emulator."""

    ENVIRONMENT = 2
    UNITS = 6
    REFLECTOR = 7
    SETTINGS = 8
    COORDINATE_SYSTEM = 12
    MODE = 17
    CONTINUOUS_PARAMETERS = 19
    STATUS_NOT_READY = 25
    STATUS_BUSY = 26
    STATUS_READY = 27
    INITIALISATION = 151
    SERVER_CLOSING = 998


METRE, RADIAN, CELSIUS, MILLIBAR, RELATIVE_HUMIDITY = 0, 0, 0, 0, 0
CARTESIAN_RIGHT_HANDED, SPHERICAL_COUNTER_CLOCKWISE = 0, 7
CONTINUOUS_TIME = 1
PROCESSOR_INITIALISED = 5
REFLECTOR_SEEN = 2048
"""Bit of the answer to GET_MEASUREMENT_STATUS."""

STATUS_TEXT = {
    1: 'server busy',
    2: 'command not implemented',
    3: 'wrong parameter',
    23: 'wrong reflector',
    26: 'no tracker processor',
    27: 'no weather station',
    35: 'usage conflict',
    37: 'no distance set: bring the reflector to a known point',
    38: 'no tracker connected',
    39: 'tracker not initialised',
    57: 'environment out of range',
    58: 'tracker is in compensation mode',
    94: 'no temperature',
    95: 'no pressure',
    96: 'no humidity',
    701: 'beam lost',
    10004: 'not ready to measure',
    10005: 'distance meter starting up',
    10011: 'another client is connected to the tracker: close it',
    10012: 'tracker not warmed up',
    10014: 'tracker not ready',
    10015: 'sensor communication failed',
}
SAMPLE_TEXT = {
    1: 'target fast',
    2: 'target too fast',
    3: 'no reflector',
    4: 'trigger too early',
}


def status_text(status: int) -> str:
    """State what a result code means."""
    if 4 <= status <= 10:
        return f'parameter {status - 3} is wrong (status {status})'
    if 11 <= status <= 22:
        return f'parameter out of range (status {status})'
    return f'{STATUS_TEXT.get(status, "unknown to this driver")} (status {status})'


def command_text(command: int) -> str:
    """State which command a number is."""
    known = {int(c): c.name.replace('_', ' ').lower() for c in Command}
    return f'{known.get(command, "unknown")} (command {command})'
