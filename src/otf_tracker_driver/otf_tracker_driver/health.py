# SPDX-License-Identifier: Apache-2.0
"""How a source of samples is: beam, clock, losses, gaps; for status and diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple

from otf_tracker_driver.clock.device_clock import ClockState


class Beam(IntEnum):
    """Where the beam is; numbers as in TrackerStatus."""

    UNKNOWN = 0
    ON_TARGET = 1
    LOST = 2
    SEARCHING = 3


class Gap(NamedTuple):
    """The stream broke off and went on.

    Attributes
    ----------
    last_ns, first_ns : int, ns
        Stamps of the last sample before and of the first one after it.
    reason : str
    """

    last_ns: int
    first_ns: int
    reason: str


REPEATED = 'time had been there'
"""Why samples are left out whose stamps would not be later than those before."""


@dataclass(frozen=True)
class Health:
    """State of a source; the defaults are those of one that cannot tell.

    Attributes
    ----------
    connected : bool
    device : str
        What is connected.
    beam : Beam
    clock : ClockState or None
        None if the samples bring their stamps as they are.
    by_host : bool
        Samples are stamped on arrival.
    environment : tuple of float or None
        Temperature, C; pressure, mbar; relative humidity, %.
    connections, interruptions : int
    left_out : mapping of str to int
        Samples that were left out, by reason.
    unreadable : int
        Packets or lines that made no sense.
    gaps : tuple of Gap
    """

    connected: bool = True
    device: str = ''
    beam: Beam = Beam.UNKNOWN
    clock: ClockState | None = None
    by_host: bool = False
    environment: tuple[float, float, float] | None = None
    connections: int = 0
    interruptions: int = 0
    left_out: Mapping[str, int] = field(default_factory=dict)
    unreadable: int = 0
    gaps: tuple[Gap, ...] = ()


def left_out(repeated: int, others: Mapping[str, int] = MappingProxyType({})) -> dict[str, int]:
    """Samples left out by reason, those of repeated times among them."""
    return {**others, REPEATED: repeated} if repeated else dict(others)
