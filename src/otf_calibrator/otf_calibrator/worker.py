# SPDX-License-Identifier: Apache-2.0
"""Calibrations, diagnoses and looks at a run, so that samples and services are served meanwhile.

Threads look at tracks and write files. What solves runs in a process of its own, which may copy
itself (``otf_core.aside``), which the process of a node must not, and which can be ended at once,
whatever it does. It is started as soon as a run is examined, so it is there when the run ends.
"""

from __future__ import annotations

import functools
import gc
import os
import shutil
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

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
from otf_core.live.stages import Progress
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_core.model.sections import SignalSpec
from otf_core.model.signals import Signal
from otf_core.pieces.runs import Recording
from otf_core.reports.calibration import (
    REPORT_FILE,
    RESIDUALS_FILE,
    write_calibration,
    write_later,
)
from otf_core.tracking.alignment import FollowedTrack
from otf_core.tracking.path_watch import PartsDriven

A = TypeVar('A')
Seen = FollowedTrack | PartsDriven
Wake = Callable[[], None]
BAG = 'samples'
"""Name of the bag beside the results, and so of the run in them."""
VERB = 'calibrator'
"""Where the files come from, in their manifest."""
TOPIC = 'tracker/point'
LOOK = 0.05
"""s; interval at which to check that the work of a process is still wanted."""
THREADS = 3
"""The calibration, and two looks at a run: no end of a run waits for a look."""
OF_A_CAUSE = ('effects*.yaml', 'calibration_plain', 'calibration_with_effects')
"""What a diagnosis writes only if it names a cause."""


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

    ``missing`` names the files that did not fit on the disk, and why.
    """

    request: Request
    recording: Recording
    result: CalibrationResult
    folder: Path | None
    problem: str = ''
    missing: Mapping[str, str] = field(default_factory=dict)


class ChildError(Exception):
    """A defect in a child; the text is its traceback."""


def internal_error(error: BaseException) -> str:
    """A defect in one line; its traceback belongs into the log."""
    text = str(error).strip().splitlines()[-1] if isinstance(error, ChildError) else repr(error)
    return f'internal error: {text}'


class Child:
    """A process that does one piece of work after another, told by ``do`` in a thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._end: Connection | None = None

    def begin(self) -> None:
        """Start the process if there is none; OtfError if the system does not let it."""
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._leave()
            self._end, end = Pipe()
            command = [sys.executable, '-m', 'otf_calibrator.child', str(end.fileno())]
            with end:
                try:
                    self._process = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        pass_fds=[end.fileno()],
                        start_new_session=True,  # Ctrl-C reaches the node only, which ends both
                    )
                except OSError as error:
                    raise OtfError(f'the calibration cannot be started: {error}') from None

    def do(
        self, work: str, given: tuple[object, ...], progress: Progress, stage: str = 'aligning'
    ) -> Any:
        """Have a function of ``otf_calibrator.child`` called; return its answer.

        Parameters
        ----------
        progress : callable(stage, fraction)
            Called again and again; what it raises ends the work.
        stage : str
            What it is at first.

        Raises
        ------
        OtfError
            As the function does; or if the process was ended.
        ChildError
            If it failed for any other reason.
        """
        self.begin()
        assert self._end is not None and self._process is not None, 'just begun'
        now = stage, 0.0
        try:
            self._end.send((work, given))
            while True:
                progress(*now)
                if not self._end.poll(LOOK):
                    continue
                kind, answer = self._end.recv()
                if kind != 'progress':
                    break
                now = answer
        except (EOFError, OSError):
            raise _ended(self._process.wait()) from None
        except BaseException:  # given up, or no answer that can be read
            self.close()  # whatever it was at
            raise
        if kind == 'error':
            raise answer
        return answer

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._lock:
            self._leave()

    def _leave(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        if self._end is not None:
            self._end.close()
            self._end = None


def _ended(code: int) -> OtfError:
    """Error about a process that has ended on its own."""
    if code >= 0:  # the traceback is on standard error
        return OtfError(f'internal error: the calibration ended, code {code}')
    return OtfError(
        f'the calibration was ended by the system (signal {-code}), as it is when memory is '
        f'short; the samples stay: call calibrator/calibrate to try again'
    )


def serve(node: Connection, works: Mapping[str, Callable[..., object]]) -> None:
    """Do what the node of a child asks for until it is gone."""
    gc.set_threshold(1_000_000)  # looking for cycles takes a twelfth of the time otherwise
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            work, given = node.recv()
            try:
                said = works[work](*given, lambda *stage: node.send(('progress', stage)))
                answer: tuple[str, object] = 'answer', said
            except (BrokenPipeError, ConnectionResetError):
                raise
            except OtfError as error:
                answer = 'error', error
            except Exception:  # noqa: BLE001 - a defect, which the node reports
                answer = 'error', ChildError(traceback.format_exc())
            node.send(answer)
            del given, answer  # the next one may be hours away
            gc.collect()


class Diagnosis:
    """The diagnosis of one calibrated run, in a process of its own.

    Attributes
    ----------
    stage, fraction : str and float
        What is being done, and the share of the whole that is done.
    """

    def __init__(self, calibrated: CalibrationOutput, wake: Wake) -> None:
        assert calibrated.folder is not None, 'asked before'
        self.calibrated, self._folder, self._child = calibrated, calibrated.folder, Child()
        self.stage, self.fraction = 'starting', 0.0
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(1, 'diagnosis')
        self.answer: Future[dict[str, Any]] = self._pool.submit(self._diagnose)
        self.answer.add_done_callback(lambda _: wake())

    def close(self) -> None:
        """End it, whatever it does, and leave nothing half-written."""
        self._stop.set()
        self._pool.shutdown()

    def _progress(self, stage: str, fraction: float) -> None:
        if self._stop.is_set():
            raise Cancelled('the diagnosis was abandoned')
        self.stage, self.fraction = stage, fraction

    def _diagnose(self) -> dict[str, Any]:
        recording = replace(self.calibrated.recording, name=self._folder.name)
        with TemporaryDirectory(prefix='.diagnosis-', dir=self._folder) as partial:
            given = recording, self.calibrated.request.config, Path(partial)
            try:
                answer: dict[str, Any] = self._child.do(
                    'diagnose', given, self._progress, 'starting'
                )
            finally:
                self._child.close()
            written = sorted(Path(partial).iterdir(), key=lambda p: p.name == 'gap.json')
            earlier = [p for pattern in OF_A_CAUSE for p in self._folder.glob(pattern)]
            try:
                for path in earlier:  # of an earlier diagnosis of this run
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                for path in written:  # gap.json last
                    os.replace(path, self._folder / path.name)
            except OSError as error:
                raise ConfigError(
                    f'{self._folder}: cannot be written ({error.strerror})'
                ) from None
        return answer


class Worker:
    """Runs one calibration at a time, and looks at runs under way.

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
        self._pool = ThreadPoolExecutor(THREADS, 'calibration')
        self._stop, self._cancelled = threading.Event(), threading.Event()
        self._child = Child()
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

    def diagnose(self, calibrated: CalibrationOutput) -> Diagnosis:
        """Start a diagnosis of a calibrated run that has files."""
        return Diagnosis(calibrated, self._wake)

    def look(self, look: Callable[[Samples], Seen | None], samples: Samples) -> Future[bool]:
        """Find out whether samples follow the path to its end; the child gets ready meanwhile."""
        self.stage, self.fraction = 'aligning', 0.0  # of what is wanted as soon as the run is over

        def at_the_end(samples: Samples) -> bool:
            self._seen = look(samples)
            return self._seen is not None and self._seen.to_the_end

        return self.ask(at_the_end, samples)

    def ask(self, question: Callable[[Samples], A], samples: Samples) -> Future[A]:
        """Answer a question about samples that takes a while."""
        with suppress(OtfError):  # reported when there is something to calibrate
            self._child.begin()
        return self._begin(question, samples)

    def _begin(self, work: Callable[..., A], *given: object) -> Future[A]:
        """Start work in a thread."""
        job = self._pool.submit(work, *given)
        job.add_done_callback(lambda _: self._wake())
        return job

    def close(self) -> None:
        """Stop a calibration under way, but finish writing the bag of one that is done."""
        self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._child.close()

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
        given = recording, request.config, files.method, files.effects
        result = self._child.do('calibrate', given, self._progress)
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
            return CalibrationOutput(request, recording, result, None, problem)
        problems = [out.missing_words]
        try:
            point_latest(base / 'latest', folder.name)
        except OtfError as error:
            problems.append(f'not shown as latest: {error}')
        if files.history_directory:
            try:
                store = Path(files.history_directory).expanduser()
                add_run(store, folder / 'error_tables.json')
            except OtfError as error:
                problems.append(f'not added to the history: {error}')
        problem = '; '.join(text for text in problems if text)
        return CalibrationOutput(request, recording, result, folder, problem, out.missing)

    def _save(self, outcome: CalibrationOutput) -> CalibrationOutput:
        files, folder, result = outcome.request.files, outcome.folder, outcome.result
        if not folder:
            return outcome
        problems = [outcome.problem] if outcome.problem else []
        missing = dict(outcome.missing)
        later = functools.partial(write_later, result, folder)
        for name, wanted, write in (
            (REPORT_FILE, files.report, functools.partial(later, REPORT_FILE)),
            (RESIDUALS_FILE, True, functools.partial(later, RESIDUALS_FILE)),
            (BAG, files.save_bag, functools.partial(_write_samples, outcome, folder)),
        ):
            try:
                if wanted:
                    write()
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


def _write_samples(outcome: CalibrationOutput, folder: Path) -> None:
    """Write path and samples of a run as a bag."""
    recording, signals = outcome.recording, outcome.request.signals
    content = BagContent(recording.samples, recording.path, signals=signals)
    write_bag(folder / BAG, content)


def recording_of(request: Request) -> Recording:
    """Samples in order with the remarks on them; InputError if they are not usable."""
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
        if files.effects not in (NONE, AUTO):
            read_effects(files.effects, machine)
    if not files.history_directory:
        wanted.discard('history_directory')
    for name, place in places.items():
        if name in wanted:
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


def point_latest(link: Path, target: str) -> None:
    """Let a link point to another folder, at no time to none."""
    partial = link.with_name(f'.latest-{os.getpid()}')
    try:
        partial.unlink(missing_ok=True)
        partial.symlink_to(target)
        os.replace(partial, link)
    except OSError as error:
        raise ConfigError(f'{link}: cannot be made a link ({error.strerror})') from None
