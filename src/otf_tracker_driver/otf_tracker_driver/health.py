# SPDX-License-Identifier: Apache-2.0
"""How a source of samples is: flow, beam, clock, losses, gaps; for status and diagnostics."""

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


class Flow(IntEnum):
    """Why samples do not flow though a stream is under way; numbers as in TrackerStatus."""

    STARTING = 4
    WAITING_FOR_CLOCK = 5
    BEAM_BROKEN = 6
    SILENT = 7
    NO_CONNECTION = 8


ORDINARY = frozenset({Flow.STARTING, Flow.WAITING_FOR_CLOCK})
"""What every stream passes through."""


class Hindrance(NamedTuple):
    """What keeps samples from flowing.

    Attributes
    ----------
    text : str
        One sentence on why, and on what is done about it.
    since : float, s
        Of ``time.monotonic``: when the last sample came, or the stream was asked for.
    restarts : int
        Times that the measurement was started, or the source opened, again since then.
    """

    kind: Flow
    text: str
    since: float
    restarts: int = 0

    @property
    def trouble(self) -> str:
        """The text, if this is not what every stream passes through."""
        return '' if self.kind in ORDINARY else self.text


class Gap(NamedTuple):
    """The stream broke off and went on.

    Attributes
    ----------
    last_ns, first_ns : int, ns
        Stamps of the last sample before and of the first one after it.
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
    device : str
        What is connected, in words.
    hardware : str
        The same as a name that does not change while it is connected.
    clock : ClockState or None
        None if the samples bring their stamps as they are.
    by_host : bool
        Samples are stamped on arrival.
    environment : tuple of float or None
        Temperature, C; pressure, mbar; relative humidity, %.
    connections, interruptions : int
        Connections made; times that the stream broke off and went on.
    warnings : tuple of str
        What is not as it was asked for, and can be used all the same.
    left_out : mapping of str to int
        Samples that were left out, by reason.
    unreadable : int
        Packets or lines that made no sense.
    """

    connected: bool = True
    device: str = ''
    hardware: str = ''
    beam: Beam = Beam.UNKNOWN
    clock: ClockState | None = None
    by_host: bool = False
    environment: tuple[float, float, float] | None = None
    connections: int = 0
    interruptions: int = 0
    warnings: tuple[str, ...] = ()
    left_out: Mapping[str, int] = field(default_factory=dict)
    unreadable: int = 0
    gaps: tuple[Gap, ...] = ()


def count_left_out(
    repeated: int, others: Mapping[str, int] = MappingProxyType({})
) -> dict[str, int]:
    """Samples left out by reason, those of repeated times among them."""
    return {**others, REPEATED: repeated} if repeated else dict(others)
