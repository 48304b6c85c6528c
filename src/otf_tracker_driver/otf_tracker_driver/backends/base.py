# SPDX-License-Identifier: Apache-2.0
"""What every source of tracker samples offers the driver; nothing here knows ROS.

Life of a backend: connect, then any number of streams (prepare, start, poll until finished or
stop), then disconnect. All calls come from one thread. ``poll`` returns whatever has been measured
since the call before. Known samples derive from ``paced.PacedBackend``, devices that are read in a
thread from ``live.LiveBackend``. How to add one: docs/extend.md.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, NamedTuple

import numpy as np

from otf_core.config import Parameters, parameter
from otf_core.errors import InputError
from otf_core.model.axis_path import AxisPath
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan
from otf_tracker_driver.clock import ClockState

OPERATIONS = (
    'list_reflectors',
    'set_reflector',
    'bird_bath',
    'find_reflector',
    'two_face_check',
    'clear_errors',
)
"""What an operator may ask of a source that takes commands."""
NO_SAMPLES = Samples(np.empty(0, np.int64), np.empty((0, 3)))


@dataclass(frozen=True)
class CommonConfig(Parameters):
    """What several backends share; declared without the name of a backend in front."""

    machine_file: str = parameter(
        '', 'machine description (machine.yaml); backends that simulate the cell require it'
    )
    time_scale: float = parameter(
        1.0, 'factor by which simulated or recorded samples are published faster than measured, '
        'at most: no faster than calibrators take them', '', 0.1, 50.0,
    )  # fmt: skip


def check_common(common: CommonConfig, changed: Collection[str]) -> None:
    """Refuse a machine description that cannot be read.

    Raises
    ------
    ConfigError
        Names what is wrong in the file.
    """
    if 'machine_file' in changed and common.machine_file:
        load_machine(common.machine_file)


class Unreachable(InputError):
    """The source is not there, or not ready yet; the same attempt may succeed later."""


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


class Backend(ABC):
    """A source of tracker samples.

    Parameters
    ----------
    own : Parameters
        Of the class that ``parameters`` names.

    Attributes
    ----------
    parameters : subclass of Parameters
        Its own parameters, declared by the node as NAME.parameter.
    brings_path : bool
        True if the nominal path comes with the samples, so no planner is needed.
    needs_plan : bool
        True if ``prepare`` must be given a plan.
    rate : float, Hz
        Samples per second of measurement time; 0 while unknown.
    expected : int
        Samples of the whole stream; 0 if the source does not know.
    path : NominalPath or None
        Nominal path that comes with the samples; known once connected.
    parts : tuple of AxisPath
        The same of a machine with rotary axes.
    remark : str
        What is worth saying about the stream when it starts.
    allowed : int or None
        Samples of the stream that may be handed out by now, if the source can wait; None: all.
    in_packets : bool
        True if many samples come at once, which the driver then spreads over their time.
    cancelled : callable
        Tells whether ``connect`` shall give up.
    now_ns : callable
        Time of the graph, ns: of the computer, or of ``/clock``.
    """

    parameters: ClassVar[type[Parameters]]
    brings_path: ClassVar[bool] = False
    needs_plan: ClassVar[bool] = False
    in_packets: ClassVar[bool] = False
    rate: float = 0.0
    expected: int = 0
    allowed: int | None = None
    path: NominalPath | None = None
    parts: tuple[AxisPath, ...] = ()
    remark: str = ''
    cancelled: Callable[[], bool] = staticmethod(lambda: False)
    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    def __init__(self, common: CommonConfig, own: Parameters) -> None:
        self.common, self.own = common, own

    @abstractmethod
    def connect(self) -> str:
        """Open the source; return one sentence on what it is.

        OtfError if it cannot be used; Unreachable if it is not there, or not ready, yet.
        """

    def prepare(self, plan: Plan | None) -> None:  # noqa: B027 - not every source needs it
        """Get ready for a new stream; returns at once, ``preparing`` tells when it is done."""

    @property
    def preparing(self) -> str:
        """What the source still has to do before it can start; empty if ready. May raise."""
        return ''

    @abstractmethod
    def start(self) -> None:
        """Start a stream from its beginning."""

    @abstractmethod
    def poll(self) -> Samples:
        """Return the samples measured since the last call, at once; OtfError on a fault.

        Any other error is a defect: the driver says so and ends.
        """

    @property
    @abstractmethod
    def finished(self) -> bool:
        """True once ``poll`` has returned the last sample."""

    def count_until(self, stamp_ns: int) -> int:
        """Samples of the stream up to a stamp, if the source can wait for who takes them."""
        return 0

    @property
    def real_time_factor(self) -> float:
        """Measured time per elapsed time, of the last seconds or of the whole; 0: not known."""
        return 1.0

    @property
    def pace_words(self) -> str:
        """The same of a stream that is over; empty if it is no news."""
        return ''

    @property
    def hindrance(self) -> Hindrance | None:
        """What keeps samples from flowing in a stream that goes on by itself; None: they flow."""
        return None

    @property
    def trouble(self) -> str:
        """What is wrong with a stream that is under way; empty if nothing."""
        return self.hindrance.trouble if self.hindrance else ''

    @property
    def health(self) -> Health:
        """How the source is, for status and diagnostics; also while nothing streams."""
        return Health()

    def operate(self, name: str, own: Parameters) -> Future[str]:
        """Have the source do something that an operator asks for; returns at once.

        Parameters
        ----------
        name : str
            One of ``OPERATIONS``.
        own : Parameters
            As they are now.

        Returns
        -------
        Future of str
            One sentence on what came of it, or OtfError.

        Raises
        ------
        InputError
            If it cannot do that.
        """
        raise InputError('this source takes no commands; the backend emscon does')

    def stop(self) -> None:  # noqa: B027
        """End the stream; nothing happens if there is none."""

    def disconnect(self) -> None:  # noqa: B027
        """Release the source; comes at any time, also if ``connect`` failed."""


def join_samples(parts: list[Samples]) -> Samples:
    """All samples of a list as one."""
    if not parts:
        return NO_SAMPLES
    return Samples(
        np.concatenate([part.stamp_ns for part in parts]),
        np.concatenate([part.xyz for part in parts]),
    )
