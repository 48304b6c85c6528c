# SPDX-License-Identifier: Apache-2.0
"""What an emulated tracker has been told, and how it answers; nothing here takes time."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from otf_tracker_driver.emscon import codes
from otf_tracker_driver.emscon.codes import Command, Event, Status
from otf_tracker_driver.emscon.commands import LAYOUTS, Value, answer, request_values
from otf_tracker_driver.emscon.framing import ProtocolError
from otf_tracker_driver.emscon.packets import encode_answer, encode_event

C = Command
LENGTH = (1.0, 1e3, 1e6, 1 / 0.3048, 1 / 0.9144, 1 / 0.0254)
ANGLE = (1.0, 180 / np.pi, 200 / np.pi)
CLOCKWISE, CYLINDRICAL = 6, (4, 5)
"""Coordinate systems."""
REFLECTORS = {3: 'RRR-0.5in', 7: 'CCR-1.5in', 9: 'TBR-0.5in'}
SETTERS: dict[Command, tuple[Command, Event]] = {
    C.SET_UNITS: (C.GET_UNITS, Event.UNITS),
    C.SET_ENVIRONMENT: (C.GET_ENVIRONMENT, Event.ENVIRONMENT),
    C.SET_MEASUREMENT_MODE: (C.GET_MEASUREMENT_MODE, Event.MODE),
    C.SET_COORDINATE_SYSTEM: (C.GET_COORDINATE_SYSTEM, Event.COORDINATE_SYSTEM),
    C.SET_CONTINUOUS_TIME: (C.GET_CONTINUOUS_TIME, Event.CONTINUOUS_PARAMETERS),
    C.SET_REFLECTOR: (C.GET_REFLECTOR, Event.REFLECTOR),
    C.SET_SYSTEM_SETTINGS: (C.GET_SYSTEM_SETTINGS, Event.SETTINGS),
    C.SET_STATISTIC_MODE: (C.GET_STATISTIC_MODE, Event.MODE),
}
LIMITS: dict[Command, tuple[tuple[float, float], ...]] = {
    C.SET_UNITS: ((0, 5), (0, 2), (0, 1), (0, 6), (0, 0)),
    C.SET_ENVIRONMENT: ((-10, 60), (500, 1200), (0, 100)),
    C.SET_MEASUREMENT_MODE: ((0, 1),),
    C.SET_COORDINATE_SYSTEM: ((0, 7),),
    C.SET_CONTINUOUS_TIME: ((1, 100_000), (0, 2**31 - 1), (0, 1), (0, 1)),
}
ALL_READY = 1 | 2 | 4 | 8 | 4096 | 65536


class Device:
    """Settings as a tracker has them that another program used before.

    Attributes
    ----------
    kept : dict
        Values of the settings, by the command that gets them.
    initialised, seen : bool
        Whether the tracker is initialised, and sees a reflector.
    face : int
        1 or 2.
    """

    def __init__(self) -> None:
        self.initialised = self.seen = False
        self.face = 1
        self.kept: dict[Command, tuple[Value, ...]] = {
            C.GET_UNITS: (1, 1, 0, 3, 0),
            C.GET_ENVIRONMENT: (20.0, 1013.25, 50.0),
            C.GET_MEASUREMENT_MODE: (0,),
            C.GET_COORDINATE_SYSTEM: (codes.SPHERICAL_COUNTER_CLOCKWISE,),
            C.GET_CONTINUOUS_TIME: (100, 0, 0, 0),
            C.GET_REFLECTOR: (3,),
            C.GET_SYSTEM_SETTINGS: (1, 1, 1, 1, 0, 1, 0, 0, 0),
            C.GET_STATISTIC_MODE: (0, 0),
        }

    @property
    def interval_ms(self) -> int:
        """From sample to sample."""
        return int(self.kept[C.GET_CONTINUOUS_TIME][0])

    def ready(self) -> int:
        """Result code of an attempt to measure."""
        if not self.initialised:
            return Status.NOT_INITIALISED
        return Status.OK if self.seen else 37

    def answers(self, number: int, body: bytes) -> list[bytes]:
        """Answers to a command that takes no time, and events that come with them."""
        if number == C.CLEAR_COMMAND_QUEUE:
            return [encode_answer(number, Status.OK)]
        if number not in LAYOUTS:
            return [encode_answer(number, Status.NOT_IMPLEMENTED)]
        command = Command(number)
        try:
            values = request_values(command, body)
        except (ProtocolError, struct.error):
            return [answer(command, Status.WRONG_PARAMETER)]
        if command in SETTERS:
            return self._set(command, values)
        if command in self.kept:
            return [answer(command, Status.OK, *self.kept[command])]
        if command == C.GET_REFLECTORS:
            return [
                answer(command, Status.OK, len(REFLECTORS), number, 1, 0.019, name)
                for number, name in REFLECTORS.items()
            ]
        facts = self._facts()
        if command in facts:
            return [answer(command, Status.OK, *facts[command])]
        return [answer(command, Status.NOT_IMPLEMENTED)]

    def _set(self, command: Command, values: tuple[Value, ...]) -> list[bytes]:
        for place, (value, (low, high)) in enumerate(
            zip(values, LIMITS.get(command, ()), strict=False)
        ):
            if not low <= float(value) <= high:
                return [answer(command, 4 + place)]
        if command == C.SET_COORDINATE_SYSTEM and values[0] in CYLINDRICAL:
            return [answer(command, Status.NOT_IMPLEMENTED)]
        if command == C.SET_REFLECTOR and values[0] not in REFLECTORS:
            return [answer(command, Status.WRONG_REFLECTOR)]
        setting, event = SETTERS[command]
        self.kept[setting] = values
        return [answer(command, Status.OK), encode_event(event)]

    def _facts(self) -> dict[Command, tuple[Value, ...]]:
        processor = codes.PROCESSOR_INITIALISED if self.initialised else 3
        bits = ALL_READY | (codes.REFLECTOR_SEEN if self.seen else 0)
        return {
            C.GET_SYSTEM_STATUS: (0, processor, 3, 0, 3, 6, 0, 1, 0, 7007),
            C.GET_TRACKER_STATUS: (2 if self.initialised else 0,),
            C.GET_MEASUREMENT_STATUS: (0, bits),
            C.GET_FACE: (self.face,),
            C.GET_TRACKER_INFO: (
                5, 'EMULATED', 7007, 1, 1, 0, 0, 0.0, 80.0, 0.1, 1000, 2, 6.28, 1.57, 0, 1, 0,
            ),
            C.GET_SOFTWARE_VERSION: ('emulator 3.6',),
        }  # fmt: skip

    def shown(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (n, 3), m, in the units and the coordinate system that are set."""
        length = LENGTH[int(self.kept[C.GET_UNITS][0])]
        angle = ANGLE[int(self.kept[C.GET_UNITS][1])]
        system = int(self.kept[C.GET_COORDINATE_SYSTEM][0])
        if system <= 3:
            mirrored = np.ones(3)
            if system:
                mirrored[system - 1] = -1.0
            return np.asarray(xyz * mirrored * length)
        x, y, z = xyz.T
        horizontal = (-1.0 if system == CLOCKWISE else 1.0) * np.arctan2(y, x) * angle
        distance = np.linalg.norm(xyz, axis=1)
        zenith = np.arccos(z / distance) * angle
        return np.column_stack([horizontal, zenith, distance * length])
