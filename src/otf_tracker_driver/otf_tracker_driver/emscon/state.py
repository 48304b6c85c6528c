# SPDX-License-Identifier: Apache-2.0
"""What a tracker session does and has seen, for status and diagnostics."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from otf_tracker_driver.clock.device_clock import ClockState
from otf_tracker_driver.emscon.configure import Tracker
from otf_tracker_driver.health import Beam, Gap, Hindrance

CONNECTING, CONFIGURING, INITIALISING = 'connecting', 'configuring', 'initialising'
READY, STREAMING, SEARCHING = 'ready', 'streaming', 'searching'
BEING_STARTED = 'the measurement is being started'


@dataclass
class SessionState:
    """Written by the session's thread, read by anyone; every field is replaced as a whole.

    Attributes
    ----------
    phase : str
        One of the names above.
    hindrance : Hindrance or None
        What keeps samples from flowing just now, in a stream; why there is no connection, without.
    tracker : Tracker or None
        None until configured.
    environment : tuple of float or None
        Temperature, C; pressure, mbar; relative humidity, %; of the last packet.
    packets, samples : int
        Received in all streams.
    unreadable, late_answers, unused : int
        Packets that made no sense; answers nobody waited for; packets of types not used.
    left_out : Counter
        Samples that were not handed on, by reason.
    slow_down : int
        Samples handed on though the tracker warns that the target is fast.
    repeated, squeezed : int
        Samples left out because their time had been there; samples moved behind a jump.
    connections, interruptions : int
        Connections made; times that the stream broke off and went on.
    gaps : tuple of Gap
        The latest interruptions.
    """

    phase: str = CONNECTING
    hindrance: Hindrance | None = None
    beam: Beam = Beam.UNKNOWN
    tracker: Tracker | None = None
    clock: ClockState = field(default_factory=ClockState)
    environment: tuple[float, float, float] | None = None
    packets: int = 0
    samples: int = 0
    unreadable: int = 0
    late_answers: int = 0
    unused: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    slow_down: int = 0
    repeated: int = 0
    squeezed: int = 0
    connections: int = 0
    interruptions: int = 0
    gaps: tuple[Gap, ...] = ()

    @property
    def trouble(self) -> str:
        """What hinders the measurement just now; empty if nothing out of the ordinary."""
        return self.hindrance.trouble if self.hindrance else ''
