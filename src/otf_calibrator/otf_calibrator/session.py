# SPDX-License-Identifier: Apache-2.0
"""When to calibrate: watches a run until it is complete, calibrates it, waits for the next one.

The last calibrated run can be diagnosed meanwhile; the next calibration ends that.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial

from otf_calibrator.intake import Batch, Intake
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.run import Collector
from otf_calibrator.worker import (
    CalibrationOutput,
    Diagnosis,
    Request,
    Wake,
    Worker,
    internal_error,
)
from otf_core.calibration.first_sight import (
    FirstSight,
    first_legs,
    first_sight,
)
from otf_core.config import CalibrationConfig
from otf_core.model.axis_path import PartsTrack
from otf_core.tracking.path_watch import PathWatcher

INTERIM = 'interim result: the run continues, and its samples are still collected'
Settings = Callable[[], tuple[CalibratorConfig, CalibrationConfig]]
LOOK_SHARE, MOST_LOOKS = 0.05, 4
"""Share of the path between two looks at where the tracker stands, and the most in a run."""


class Session:
    """Runs and their calibrations, one after another; never waits.

    Parameters
    ----------
    settings : callable
        Returns the present parameters.
    warn : callable
        Takes messages for the user.
    wake : callable, optional
        Called, by another thread, as soon as there is something to look at.
    collect : callable, optional
        Takes the samples that have arrived, before a calibration that is asked for.

    Attributes
    ----------
    diagnosis : Diagnosis or None
        The diagnosis under way.
    """

    def __init__(
        self,
        settings: Settings,
        warn: Callable[[str], None],
        wake: Wake = lambda: None,
        collect: Callable[[], None] = lambda: None,
    ) -> None:
        self._settings, self._collect = settings, collect
        self.collector = Collector(lambda: settings()[1], lambda why: self.intake.set_aside(why))
        self.intake = Intake(self.collector, warn)
        self.worker = Worker(warn, wake)
        self._job: Future[CalibrationOutput] | None = None
        self._saving: Future[CalibrationOutput] | None = None
        self._first_look: Future[FirstSight] | None = None
        self._looks = (0, 0)
        self._unplaced = ''
        self._verdict: Future[bool] | None = None
        self._judged: tuple[PathWatcher | None, int | None] = None, None
        self.diagnosis: Diagnosis | None = None
        self._last: CalibrationOutput | None = None
        self._asked = (-1, 0)

    @property
    def busy(self) -> bool:
        """True from when a calibration is asked for until its samples are saved."""
        return bool(self._job or self._saving)

    @property
    def progress(self) -> tuple[str, float]:
        """What a calibration asked for is at, and the part of that which is done."""
        return self.worker.stage, self.worker.fraction

    @property
    def answered(self) -> bool:
        """True if a calibration was asked for and no sample has come since."""
        return self._asked == self._present

    @property
    def _present(self) -> tuple[int, int]:
        return self.collector.run, len(self.collector.buffer)

    def take(self, batch: Batch) -> bool:
        """Collect samples; return whether the run may have ended with them."""
        self.intake.take_samples(batch, not self.busy)
        collector, watcher = self.collector, self.collector.watcher
        if watcher is None or collector.taken:
            return False
        return watcher.worth_judging or self.judging

    def calibrate(self) -> tuple[bool, str]:
        """Calibrate the samples so far; return whether that has started, and a message.

        The run goes on with what comes after, unless it was over.
        """
        self._collect()
        if self.busy:
            return False, 'a calibration is under way; wait for DONE or FAILED on calibrator/state'
        if self.collector.path is None:
            return False, 'no path yet: start the path planner or publish planner/path (axes)'
        if not len(self.collector.buffer):
            return False, 'no samples yet: activate the tracker driver and drive the path'
        self._asked, now = self._present, time.monotonic()
        if self.collector.over(now):
            return True, self.start('requested') + '; follow calibrator/state'
        remarks = (INTERIM,) if self.collector.goes_on(now) else ()
        return True, self._start('requested', False, remarks) + '; follow calibrator/state'

    def start_due(self) -> str:
        """Start the calibration of a run that has ended; return what was started, in words."""
        self.intake.decide(not self.busy)
        reason = self.reason_to_end()
        return self.start(reason) if reason else ''

    def start(self, reason: str) -> str:
        """Calibrate the samples of a complete run; return what was started, in words."""
        self.intake.decide(may_end=False)  # it has all that is here
        started = self._start(reason, final=True)
        self.collector.taken = True
        return started

    def _start(self, reason: str, final: bool, remarks: tuple[str, ...] = ()) -> str:
        self.abandon()
        request = self.request(final, remarks)
        self._job = self.worker.start(request)
        return f'calibration of {len(request.samples)} samples started: {reason}'

    def request(self, final: bool = True, remarks: tuple[str, ...] = ()) -> Request:
        """Return the samples so far and all that is known of them."""
        collector = self.collector
        samples = collector.buffer.snapshot()
        path, not_driven = collector.driven_parts()
        return Request(
            samples,
            path,
            *self._settings(),
            collector.count_lost(time.monotonic()),
            (*self.intake.remarks(), *not_driven, *remarks),
            copy.deepcopy(collector.screening),
            self.intake.journal.folder if self.intake.journal else None,
            final,
            self.intake.signals.of(samples),
        )

    def cancel(self) -> None:
        """Cancel a calibration under way at its next step; its samples are kept."""
        if self.busy:
            self.worker.cancel()

    def first_look(self) -> Future[FirstSight] | None:
        """Look early in a run where the tracker stands; return a look that has shown it."""
        look = self._first_look
        if look is None and not self.busy and not self.collector.taken:
            self._begin_first_look()
        if look is None or not look.done():
            return None
        self._first_look, (run, looks) = None, self._looks
        if look.exception() is None:
            self._looks, self._unplaced = (run, MOST_LOOKS), ''
            return look
        if looks > 1:  # the first legs often do not determine anything yet
            self._unplaced = f'the place of the tracker is not known yet: {look.exception()}'
        return None

    def troubles(self) -> list[str]:
        """What is wrong with samples, journal and set-up, in words."""
        here = self._looks[0] == self.collector.run and not self.collector.taken
        return [*self.intake.troubles(), *([self._unplaced] if here and self._unplaced else ())]

    def _begin_first_look(self) -> None:
        collector, path, watcher = self.collector, self.collector.path, self.collector.watcher
        travelled = collector.travelled
        looks = self._looks[1] if self._looks[0] == collector.run else 0
        if path is None or looks >= MOST_LOOKS:
            return
        if isinstance(path, PartsTrack) and watcher is not None:
            count = len(watcher.starts)
            if count <= looks:
                return
            samples = collector.buffer.snapshot(stop=watcher.starts[-1])
            path = path.first_parts(count)
        else:
            due = travelled > (looks + 1) * LOOK_SHARE * path.length
            if not due or travelled < first_legs(path):
                return
            samples = collector.buffer.snapshot()
        config = self._settings()[1]
        question = partial(first_sight, path=path, travelled=travelled, config=config)
        self._looks = collector.run, looks + 1
        self._first_look = self.worker.ask(question, samples)

    def forget(self) -> tuple[bool, str]:
        """Drop the run; return True and what was dropped, in words."""
        count, place = len(self.collector.buffer), self.intake.forget()
        self.abandon()
        return True, f'{count} samples discarded{place}; ready for a run'

    def take_finished(self) -> Future[CalibrationOutput] | None:
        """Return a calibration that has ended, once."""
        if not self._job or not self._job.done():
            return None
        job, self._job = self._job, None
        if job.exception() is None:
            self._last = job.result()
            self._saving = self.worker.save(self._last)
            self.intake.settle(self._last.request, self._last.folder)
        return job

    def take_saved(self) -> CalibrationOutput | None:
        """Return a calibrated run once its samples are saved beside its results."""
        if not self._saving or not self._saving.done():
            return None
        saving, self._saving = self._saving, None
        if error := saving.exception():  # a defect; the tables are there
            assert self._last is not None, 'it is being saved'
            return replace(self._last, problem=f'report and samples: {internal_error(error)}')
        return saving.result()

    def diagnose(self) -> tuple[bool, str]:
        """Diagnose the last calibrated run; return whether that has started, and a message."""
        if self.diagnosis:
            return False, 'a diagnosis is under way; wait for calibrator/gap_report'
        if self.busy:
            return False, 'a calibration is under way; wait for DONE or FAILED on calibrator/state'
        if self._last is None:
            return False, 'no run is calibrated yet: drive the path, or call calibrator/calibrate'
        if self._last.folder is None:
            return False, f'{self._last.problem}; correct it and call calibrator/calibrate'
        self.diagnosis = self.worker.diagnose(self._last)
        return True, f'diagnosis of run {self._last.result.run_id} started'

    def take_diagnosed(self) -> Diagnosis | None:
        """Return a diagnosis that has ended, once."""
        diagnosis = self.diagnosis
        if diagnosis is None or not diagnosis.answer.done():
            return None
        diagnosis.close()
        self.diagnosis = None
        return diagnosis

    def abandon(self) -> None:
        """Stop a diagnosis under way, if there is one."""
        if self.diagnosis:
            self.diagnosis.close()
            self.diagnosis = None

    def close(self) -> None:
        """Stop all work; files are complete or absent, the samples are in the journal."""
        self.abandon()
        self.intake.close()
        self.worker.close()

    @property
    def judging(self) -> bool:
        """Whether it is being found out if the run has ended at its end point."""
        watcher = self.collector.watcher
        return self._verdict is not None and watcher is not None and watcher.stood

    def reason_to_end(self) -> str:
        """Return why the run is complete and can be calibrated; empty if it is not."""
        now = time.monotonic()
        if self.busy or self.answered or self.collector.undecided(now):
            return ''
        files, collector, watcher = self._settings()[0], self.collector, self.collector.watcher
        if self._at_the_end():
            self.intake.end_run()
            return 'standstill at the end point'
        if not self._verdict and watcher and (samples := collector.take_end_to_judge()):
            if files.finish_at_standstill:
                self._verdict = self.worker.look(watcher.look, samples)
                self._judged = watcher, watcher.end
            else:
                watcher.dismiss()
        reason = collector.reason_to_end(now, files.finish_at_stream_end, files.idle_timeout)
        return '' if self.judging and not collector.stream_over(now) else reason

    def _at_the_end(self) -> bool:
        """Return whether the run has ended at a standstill at the end point, once."""
        if not self._verdict or not self._verdict.done():
            return False
        watcher = self.collector.watcher
        same = not self.collector.taken and self._judged == (watcher, watcher and watcher.end)
        if not same or watcher is None:
            self._verdict = None
            return False
        if self._verdict.exception() or not self._verdict.result():
            self._verdict = None
            watcher.dismiss()
            return False
        if not watcher.stood:
            return False  # it may move on
        self._verdict = None
        return True
