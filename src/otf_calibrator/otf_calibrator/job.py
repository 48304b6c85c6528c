# SPDX-License-Identifier: Apache-2.0
"""One calibration at a time, so that samples and services are served meanwhile.

A thread looks at the track, hands the run to the process that solves, and writes the files.
"""

from __future__ import annotations

import functools
import os
import threading
import traceback
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TypeVar

from otf_calibrator.children import (
    CalibrationTask,
    Solver,
    internal_error,
)
from otf_calibrator.params import CalibratorConfig
from otf_core.bags.bag import BagContent, write_bag
from otf_core.bags.sample_order import Screening, sort_by_time
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import AUTO, NONE, CalibrationConfig
from otf_core.effects.effects_yaml import read_effects
from otf_core.errors import Cancelled, ConfigError, OtfError
from otf_core.files.output_folder import MANIFEST, OutputFolder, write_manifest, written_files
from otf_core.files.writing import DISK_FULL, DiskFull
from otf_core.history.store import add_run
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.sections import SignalSpec
from otf_core.model.signals import Signal
from otf_core.pieces.runs import Recording
from otf_core.reports.calibration import REPORT_FILE, write_calibration, write_later
from otf_core.reports.residual_files import RESIDUALS_FILE
from otf_core.tracking.alignment import FollowedTrack
from otf_core.tracking.path_watch import PartsDriven

Writer = Callable[[Path], object]
A = TypeVar('A')
Seen = FollowedTrack | PartsDriven
Look = Callable[[Samples], Seen | None]
Wake = Callable[[], None]

BAG = 'samples'
"""Name of the bag beside the results, and so of the run in them."""
VERB = 'calibrator'
"""Where the files come from, in their manifest."""
TOPIC = 'tracker/point'


@dataclass(frozen=True)
class Request:
    """What is to be calibrated.

    ``remarks`` and ``screening`` say what happened to the samples, ``journal`` where they are
    written; the run has ended if the request is ``final``.
    """

    samples: Samples
    path: NominalPath
    files: CalibratorConfig
    config: CalibrationConfig
    lost: int
    remarks: tuple[str, ...] = ()
    screening: Screening = field(default_factory=Screening)
    journal: Path | None = None
    final: bool = True
    signals: Mapping[SignalSpec, Signal] = field(default_factory=dict)


@dataclass(frozen=True)
class CalibrationOutput:
    """A calibration that succeeded; ``folder`` is None if its files could not be written.

    ``later`` writes the files into it that take a while, by name. ``missing`` names those that
    did not fit on the disk, and why.
    """

    request: Request
    recording: Recording
    result: CalibrationResult
    folder: Path | None
    later: Mapping[str, Writer]
    problem: str = ''
    missing: Mapping[str, str] = field(default_factory=dict)


class Worker:
    """Runs one request at a time.

    Parameters
    ----------
    warn : callable
        Takes a message about what went wrong after a calibration was done.
    wake : callable, optional
        Called, by another thread, as soon as something that was started has come to its end.

    Attributes
    ----------
    stage, fraction : str and float
        Progress as the core reports it.
    """

    def __init__(self, warn: Callable[[str], None], wake: Wake = lambda: None) -> None:
        self._warn, self._wake = warn, wake
        self._pool = ThreadPoolExecutor(2, 'calibration')  # no end of a run waits for a first look
        self._stop, self._cancelled = threading.Event(), threading.Event()
        self._solver = Solver()
        self._seen: Seen | None = None
        self.stage, self.fraction = '', 0.0

    def start(self, request: Request) -> Future[CalibrationOutput]:
        """Start a calibration; the future raises what went wrong."""
        self.stage, self.fraction = 'aligning', 0.0
        self._cancelled.clear()
        return self._begin(self._calibrate, request)

    def cancel(self) -> None:
        """End the calibration under way at its next step."""
        self._cancelled.set()

    def save(self, outcome: CalibrationOutput) -> Future[CalibrationOutput]:
        """Add the report, residuals, and path and samples as a bag, as far as wanted."""
        self.stage, self.fraction = 'saving report and samples', 0.0
        return self._begin(self._save, outcome)

    def _save(self, outcome: CalibrationOutput) -> CalibrationOutput:
        files, folder = outcome.request.files, outcome.folder
        if not folder:
            return outcome
        problems = [outcome.problem] if outcome.problem else []
        missing = dict(outcome.missing)
        writers = {**outcome.later, BAG: functools.partial(_write_samples, outcome)}
        for name, wanted in (
            (REPORT_FILE, files.report),
            (RESIDUALS_FILE, True),
            (BAG, files.save_bag),
        ):
            try:
                if wanted and name in writers:
                    writers[name](folder)
            except Exception as error:  # noqa: BLE001 - the other files are written
                missing[name] = DISK_FULL if isinstance(error, DiskFull) else self._words(error)
                problems.append(f'{name} not written: {self._words(error)}')
                self._warn(problems[-1])
        with suppress(OtfError):  # no room for it: the state says the same
            write_manifest(folder / MANIFEST, written_files(folder), VERB, missing)
        return replace(outcome, problem='; '.join(problems), missing=missing)

    def _words(self, error: Exception) -> str:
        """What went wrong; the traceback of a defect goes to the log."""
        if isinstance(error, OtfError):
            return str(error)
        self._warn(''.join(traceback.format_exception(error)))
        return internal_error(error)

    def look(self, look: Look, samples: Samples) -> Future[bool]:
        """Find out whether samples follow the path to its end; the solver gets ready meanwhile."""
        self.stage, self.fraction = 'aligning', 0.0  # of what is wanted as soon as the run is over

        def at_the_end(samples: Samples) -> bool:
            self._seen = look(samples)
            return self._seen is not None and self._seen.to_the_end

        return self.ask(at_the_end, samples)

    def ask(self, question: Callable[[Samples], A], samples: Samples) -> Future[A]:
        """Answer a question about samples that takes a while."""
        self._solver.warm_up()
        return self._begin(question, samples)

    def _begin(self, work: Callable[..., A], *given: object) -> Future[A]:
        """Start work in the thread."""
        job = self._pool.submit(work, *given)
        job.add_done_callback(lambda _: self._wake())
        return job

    def close(self) -> None:
        """Stop a calibration under way, but finish writing the bag of one that is done."""
        self._stop.set()
        self._pool.shutdown(wait=True)
        self._solver.close()

    def _progress(self, stage: str, fraction: float) -> None:
        if self._stop.is_set():
            raise Cancelled('the calibrator is shutting down')
        if self._cancelled.is_set():
            raise Cancelled('the calibration was cancelled; its samples stay')
        self.stage, self.fraction = stage, fraction

    def _calibrate(self, request: Request) -> CalibrationOutput:
        recording = recording_of(request)
        if isinstance(self._seen, FollowedTrack):  # saves time
            recording = replace(recording, seen=self._seen)
        files = request.files
        task = CalibrationTask(recording, request.config, files.method, files.effects)
        result = self._solver.solve(task, self._progress)
        later = {
            name: functools.partial(write_later, result, name=name)
            for name in (REPORT_FILE, RESIDUALS_FILE)
        }
        base = _base(files)
        folder = free_folder(base, result.run_id)
        try:
            out = OutputFolder(folder)
            with out.filled(VERB) as partial:
                write_calibration(
                    result, partial, report=False, residuals=False, missing=out.missing
                )
        except Exception as error:  # noqa: BLE001 - the result is published
            problem = f'files not written: {self._words(error)}'
            return CalibrationOutput(request, recording, result, None, later, problem)
        problems = [out.missing_words, _latest(base, folder), _add_to_store(files, folder)]
        problem = '; '.join(text for text in problems if text)
        return CalibrationOutput(request, recording, result, folder, later, problem, out.missing)


def _write_samples(outcome: CalibrationOutput, folder: Path) -> None:
    """Write path and samples of a run as a bag."""
    recording, signals = outcome.recording, outcome.request.signals
    content = BagContent(recording.samples, recording.path, signals=signals)
    write_bag(folder / BAG, content)


def recording_of(request: Request) -> Recording:
    """Samples in order, and what was said of them; InputError if they are not usable."""
    machine = load_machine(request.files.machine_file)
    request.screening.check(TOPIC)
    remarks = [*request.remarks, *request.screening.remarks()]
    # in the order in which the offline command takes them from a bag
    samples = sort_by_time(TOPIC, request.samples.stamp_ns, request.samples.xyz, remarks)
    signals = {spec.name: signal for spec, signal in request.signals.items()}
    return Recording(samples, request.path, machine, BAG, tuple(remarks), signals)


def check_files(files: CalibratorConfig, changed: Collection[str] | None = None) -> None:
    """Refuse descriptions that cannot be read, and places that cannot be written.

    Parameters
    ----------
    changed : collection of str, optional
        Only what these parameters name.
    """
    places = {
        'output_directory': free_folder(_base(files), 'results'),
        'history_directory': Path(files.history_directory).expanduser().absolute() / 'results',
    }
    wanted = {*places, 'machine_file', 'effects'} if changed is None else set(changed)
    if wanted & {'machine_file', 'effects'}:
        if not files.machine_file:
            raise ConfigError('parameter machine_file: missing; give the path of machine.yaml')
        machine = load_machine(files.machine_file)
        if files.effects != NONE and machine.rotary_names:
            raise ConfigError(
                f'parameter effects: not available for machines with rotary axes ({machine.name})'
            )
        if files.effects not in (NONE, AUTO):
            read_effects(files.effects, machine)
    if not files.history_directory:
        wanted.discard('history_directory')
    for name, place in places.items():
        if name not in wanted:
            continue
        try:
            OutputFolder(place)
        except ConfigError as error:
            raise ConfigError(f'parameter {name}: {error}') from None


def _base(files: CalibratorConfig) -> Path:
    return Path(files.output_directory).expanduser().absolute()


def free_folder(base: Path, run_id: str) -> Path:
    """Name of a folder for a calibration that is done now; of this second there may be more."""
    name = f'{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}-{run_id}'
    names = (name, *(f'{name}-{k}' for k in range(2, 1000)))
    return next(base / n for n in names if not os.path.lexists(base / n))


def _add_to_store(files: CalibratorConfig, folder: Path) -> str:
    """Add the tables to the store of calibrations if one is named; what went wrong, or ''."""
    if not files.history_directory:
        return ''
    try:
        add_run(Path(files.history_directory).expanduser(), folder / 'error_tables.json')
    except OtfError as error:
        return f'not added to the history: {error}'
    return ''


def _latest(base: Path, folder: Path) -> str:
    """Let ``latest`` show the folder; what went wrong, or ''."""
    try:
        point_latest(base / 'latest', folder.name)
    except OtfError as error:
        return f'not shown as latest: {error}'
    return ''


def point_latest(link: Path, target: str) -> None:
    """Let a link point to another folder, at no time to none."""
    partial = link.with_name(f'.latest-{os.getpid()}')
    try:
        partial.unlink(missing_ok=True)
        partial.symlink_to(target)
        os.replace(partial, link)
    except OSError as error:
        raise ConfigError(f'{link}: cannot be made a link ({error.strerror})') from None
