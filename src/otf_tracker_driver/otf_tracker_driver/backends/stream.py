# SPDX-License-Identifier: Apache-2.0
"""Backend for anything that sends points as lines; see docs/tracker-protocol.md."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError
from otf_core.model.observation import Samples
from otf_tracker_driver.backends.base import NO_SAMPLES, Backend, CommonConfig, join_samples
from otf_tracker_driver.health import Health, Hindrance, count_left_out
from otf_tracker_driver.stream.description import read_description
from otf_tracker_driver.stream.reader import Reader
from otf_tracker_driver.stream.transport import open_source

BY_HOST = (
    'WARNING: stamped on arrival, as its description declares: batches and delays of the network '
    'are in the stamps'
)


@dataclass(frozen=True)
class StreamConfig(Parameters):
    """Which source."""

    source: str = parameter(
        '', 'description of the source (YAML): address, columns, units, stamps; required'
    )


class Stream(Backend):
    """Streams points that come as lines of text or JSON."""

    parameters = StreamConfig
    own: StreamConfig

    def __init__(self, common: CommonConfig, own: StreamConfig) -> None:
        super().__init__(common, own)
        self._reader: Reader | None = None

    def connect(self) -> str:
        """Read the description and open the source."""
        if not self.own.source:
            raise ConfigError('parameter stream.source: missing; name the description to read')
        how = read_description(self.own.source)
        self._reader = Reader(how, open_source(how.source, how.peer))
        self.remark = BY_HOST if how.stamp is None else ''
        return f'{how.format} lines from {how.source} ({self.own.source})'

    @property
    def hindrance(self) -> Hindrance | None:
        """What keeps points from flowing just now."""
        return self._reader.hindrance if self._reader else None

    @property
    def trouble(self) -> str:
        """What is wrong with the stream just now; empty if nothing."""
        return self._reader.trouble if self._reader else ''

    @property
    def health(self) -> Health:
        """How the source and its clock are."""
        reader = self._reader
        if reader is None:
            return Health(connected=False)
        by_host = reader.by_host
        return Health(
            connected=reader.connected,
            device=reader.source,
            hardware=reader.source,
            clock=None if by_host else reader.stamper.clock,
            by_host=by_host,
            left_out=count_left_out(reader.repeated, reader.left_out),
            unreadable=reader.unreadable,
            connections=reader.connections,
            interruptions=reader.interruptions,
            gaps=reader.gaps,
        )

    def start(self) -> None:
        """Begin to take points."""
        if self._reader:
            self._reader.stream(True)

    def poll(self) -> Samples:
        """Return what has been stamped since the last call."""
        return join_samples(self._reader.fetch()) if self._reader else NO_SAMPLES

    @property
    def finished(self) -> bool:
        """Never true: the source says nothing of an end."""
        return False

    def stop(self) -> None:
        """Take no more points."""
        if self._reader:
            self._reader.stream(False)

    def disconnect(self) -> None:
        """Close the source."""
        if self._reader:
            self._reader.close()
            self._reader = None
