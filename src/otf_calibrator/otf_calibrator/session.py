# SPDX-License-Identifier: Apache-2.0
"""When to calibrate: watches a run until it is complete, calibrates it, waits for the next one."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future

from otf_calibrator.collector import Collector
from otf_calibrator.job import Outcome, Request, Worker
from otf_calibrator.params import CalibratorConfig
from otf_core.config import CalibrationConfig

Settings = Callable[[], tuple[CalibratorConfig, CalibrationConfig]]


class Session:
    """Runs and their calibrations, one after another; never waits.

    Parameters
    ----------
    settings : callable
        Returns the present parameters.
    warn : callable
        Takes messages for the user.

    Attributes
    ----------
    collector : Collector
    worker : Worker
    """

    def __init__(self, settings: Settings, warn: Callable[[str], None]) -> None:
        self._settings = settings
        self.collector = Collector(lambda: settings()[1])
        self.worker = Worker(warn)
        self._job: Future[Outcome] | None = None
        self._verdict: Future[bool] | None = None
        self._judged_run = 0

    @property
    def busy(self) -> bool:
        """True while a calibration is under way."""
        return self._job is not None

    def obstacle(self) -> str:
        """Say why a calibration cannot start now and what to do; empty if it can."""
        if self.busy:
            return 'a calibration is under way; wait for DONE or FAILED on calibrator/state'
        if self.collector.path is None:
            return 'no path yet: start the path planner or publish planner/path'
        if not len(self.collector.buffer):
            return 'no samples yet: activate the tracker driver and drive the path'
        return ''

    def start(self, reason: str) -> str:
        """Calibrate the samples so far; return what was started."""
        collector = self.collector
        samples, path = collector.buffer.snapshot(), collector.path
        assert path is not None, 'obstacle() comes first'
        self._job = self.worker.start(Request(samples, path, *self._settings(), collector.lost))
        collector.taken = True
        return f'calibration of {len(samples)} samples started: {reason}'

    def finished(self) -> Future[Outcome] | None:
        """Return a calibration that has come to its end, once."""
        if not self._job or not self._job.done():
            return None
        job, self._job = self._job, None
        return job

    def complete(self) -> str:
        """Say why the run is complete and can be calibrated; empty if it is not."""
        if self.busy:
            return ''
        files = self._settings()[0]
        if self._verdict and self._verdict.done():
            at_end = self._verdict.exception() is None and self._verdict.result()
            self._verdict = None
            if at_end and not self.collector.taken and self._judged_run == self.collector.run:
                return 'standstill at the end point'
        if files.finish_at_standstill and not self._verdict:
            samples = self.collector.end_to_judge()
            if samples is not None:
                self._verdict = self.worker.ask(self.collector.at_end, samples)
                self._judged_run = self.collector.run
        now = time.monotonic()
        return self.collector.complete(now, files.finish_at_stream_end, files.idle_timeout)
