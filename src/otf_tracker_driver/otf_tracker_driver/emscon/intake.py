# SPDX-License-Identifier: Apache-2.0
"""From packets of a continuous measurement to stamped samples; nothing useless goes on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from otf_core.model.observation import Samples
from otf_tracker_driver.clock.stamper import Stamper
from otf_tracker_driver.emscon.codes import SAMPLE_TEXT, SampleStatus, Status, status_text
from otf_tracker_driver.emscon.packets import Measurements
from otf_tracker_driver.emscon.state import SessionState
from otf_tracker_driver.health import Gap

FURTHEST = 200.0
"""m; no tracker measures further."""
MOST_GAPS = 1000


class Intake:
    """Checks, stamps and hands on samples; counts what it leaves out.

    Parameters
    ----------
    deliver : callable
        Takes samples.
    """

    def __init__(self, state: SessionState, deliver: Callable[[Samples], None]) -> None:
        self._state, self._deliver = state, deliver
        self._stamper = Stamper()
        self._last_ns: int | None = None
        self._interrupted = ''
        self.last_range = 0.0

    def begin(self) -> None:
        """Begin a measurement: the tracker's clock starts again."""
        self._hand_on(self._stamper.restart())

    def started(self, ordered_ns: int, answered_ns: int, sent_ns: int) -> None:
        """Take when the tracker was told to start, and when its answer arrived."""
        self._stamper.started(ordered_ns, answered_ns, sent_ns)

    @property
    def waiting(self) -> bool:
        """True if samples wait for their stamps."""
        return self._stamper.waiting

    def drop(self) -> None:
        """Forget what waits: it belongs to a stream that is not wanted any more."""
        self._stamper.restart()

    def end(self, interruption: str) -> None:
        """Hand on what waits; mark the gap that follows if there was an interruption."""
        self._hand_on(self._stamper.flush())
        if self._last_ns is not None:
            self._interrupted = self._interrupted or interruption

    def forget(self) -> None:
        """Begin a stream that has nothing to do with the one before."""
        self._last_ns, self._interrupted = None, ''

    def take(self, packet: Measurements, arrival_ns: int) -> bool:
        """Take a packet; tell whether any of its samples saw a reflector."""
        state, status = self._state, packet.status
        state.packets += 1
        if np.all(np.isfinite(packet.environment)):
            state.environment = packet.environment
        usable = self._usable(packet)
        with np.errstate(invalid='ignore', over='ignore'):
            distance = np.linalg.norm(packet.value, axis=1)
            sane = np.isfinite(packet.value).all(axis=1) & (distance < FURTHEST) & (distance > 0)
        if np.any(usable & ~sane):
            state.left_out['no point'] += int(np.count_nonzero(usable & ~sane))
        valid = usable & sane
        if valid.any():
            self.last_range = float(distance[valid][-1])
        self._hand_on(self._stamper.take(packet.device_ns, packet.value, arrival_ns, valid))
        return not len(status) or not np.all(status == SampleStatus.PRISM_ERROR)

    def _usable(self, packet: Measurements) -> NDArray[np.bool_]:
        """Samples that the tracker says are measured; counts the others by reason."""
        state, status = self._state, packet.status
        if packet.result != Status.OK:
            state.left_out[status_text(packet.result)] += len(status)
            return np.zeros(len(status), bool)
        warned = status == SampleStatus.SPEED_WARNING
        state.slow_down += int(np.count_nonzero(warned))
        usable = (status == SampleStatus.OK) | warned
        for code in np.unique(status[~usable]).tolist():
            text = SAMPLE_TEXT.get(code, f'sample status {code}')
            state.left_out[text] += int(np.count_nonzero(status == code))
        return usable

    def _hand_on(self, parts: list[Samples]) -> None:
        state = self._state
        for part in parts:
            if self._interrupted and self._last_ns is not None:
                gap = Gap(self._last_ns, int(part.stamp_ns[0]), self._interrupted)
                state.gaps = (*state.gaps[-MOST_GAPS:], gap)
                state.interruptions += 1
            self._interrupted, self._last_ns = '', int(part.stamp_ns[-1])
            state.samples += len(part)
            self._deliver(part)
        state.clock = self._stamper.clock
        state.repeated, state.squeezed = self._stamper.dropped, self._stamper.squeezed
