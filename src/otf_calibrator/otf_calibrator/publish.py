# SPDX-License-Identifier: Apache-2.0
"""What the calibrator tells: its latched state, results, failures, and ``/diagnostics``."""

from __future__ import annotations

import math
import re
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from otf_calibrator.run import Collector, lost_words
from otf_calibrator.session import Session
from otf_calibrator.worker import CalibrationOutput, ChildError, Diagnosis, Request, internal_error
from otf_core.arrays import Array
from otf_core.bags.journal import Journal
from otf_core.calibration.first_sight import FirstSight
from otf_core.errors import Cancelled, OtfError
from otf_core.live.stages import TimeLeft
from otf_core.model.axis_path import PartsTrack
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import CalibratorState, ErrorTables, GapReport, VolumeErrors
from otf_ros import convert, convert_gap, convert_result, qos
from otf_ros.diagnostics import PERIOD, Diagnostics, Finding, Level, disk, memory

try:
    from tf2_ros import StaticTransformBroadcaster
except ImportError:  # a small installation: calibrator/alignment says the same
    StaticTransformBroadcaster = None

REPEAT = 0.5
"""s; the state is published at least so often."""
ACKNOWLEDGED = 500
"""Samples after which it is published too: a simulated or replayed stream waits for that."""
NAMES = {
    getattr(CalibratorState, name): name
    for name in ('WAITING_FOR_PATH', 'BUFFERING', 'ALIGNING', 'SOLVING', 'DONE', 'FAILED')
}
SILENCE = 2.0
"""s without samples that the state speaks of."""
Described = tuple[int, float, str]
NO_DIAGNOSIS = (False, 0.0, '')
ABANDONED = (False, 0.0, 'abandoned; calibrator/diagnose starts it again')


class StatePublisher:
    """Publishes ``calibrator/state``."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(CalibratorState, 'calibrator/state', qos.STATUS)
        self._outcome: Described = (CalibratorState.FAILED, 0.0, '')
        self._diagnosis = NO_DIAGNOSIS
        self._shown = (-1, False)
        self._at = 0.0
        self._warned: set[str] = set()
        self._time_left = TimeLeft()
        self._taken, self._unsaid = Time(), 0

    def take(self, last: Time, count: int) -> None:
        """Remember that so many samples were taken, and the stamp of the last of them."""
        self._taken, self._unsaid = last, self._unsaid + count

    def done(self, outcome: CalibrationOutput) -> None:
        """Remember that the run was calibrated."""
        places = [f'files in {outcome.folder}' if outcome.folder else '', outcome.problem]
        place = '; '.join(text for text in places if text)
        text = f'{outcome.result.sentence}; for another run just drive again; {place}'
        self._outcome = (CalibratorState.DONE, 1.0, text)
        self._diagnosis = NO_DIAGNOSIS

    def failed(self, reason: str) -> None:
        """Remember why the run could not be calibrated."""
        text = f'{reason}; correct it and call calibrator/calibrate, or drive again'
        self._outcome = (CalibratorState.FAILED, 0.0, text)

    def cancelled(self, reason: str, session: Session) -> None:
        """Remember that the run was not calibrated as nobody wanted it any more."""
        text = f'{reason}; call calibrator/calibrate, or drive on'
        self._outcome = (CalibratorState.BUFFERING, _driven(session.collector), text)

    def diagnosed(self, share: float, text: str) -> None:
        """Remember what the diagnosis of the run gave; a share of 0 if nothing."""
        self._diagnosis = (False, share, text)
        if share:  # rclpy wants one severity per line of code
            self._node.get_logger().info(f'diagnosis: {text}')
        else:
            self._node.get_logger().error(text)

    def publish(self, session: Session, troubles: list[str]) -> None:
        """Publish the state, and what is wrong, if it has changed or was published long ago."""
        collector, job = session.collector, session.diagnosis
        state, progress, text = self._describe(session)
        troubles = [*troubles, *session.troubles()]
        self._warn(troubles)
        text = '; attention: '.join([text, *troubles])
        diagnosis = self._diagnosis
        if job:
            diagnosis = (True, job.fraction, job.stage)
            self._diagnosis = ABANDONED  # as long as it has not told what it gave
        driving = collector.path is not None and len(collector.buffer) and not collector.taken
        stage = session.progress[0] if session.busy else 'driving' if driving else ''
        now, shown = time.monotonic(), (state, job is not None)
        work = stage, collector.run
        time_left = self._time_left.estimate(work, progress, now) if stage else math.nan
        due = now - self._at >= REPEAT or self._unsaid >= ACKNOWLEDGED
        if shown == self._shown and not due:
            return
        if state != self._shown[0]:
            if state == CalibratorState.FAILED:
                self._node.get_logger().error(f'{NAMES[state]}: {text}')
            else:
                self._node.get_logger().info(f'{NAMES[state]}: {text}')
        self._shown, self._at, self._unsaid = shown, now, 0
        message = CalibratorState(
            state=state,
            name=NAMES[state],
            stage=stage,
            progress=progress,
            time_left=time_left,
            samples=len(collector.buffer),
            samples_lost=collector.count_lost(now),
            path_length=collector.path.length if collector.path else 0.0,
            travelled=collector.travelled,
            **_part(collector),
            message=text,
            diagnosing=diagnosis[0],
            diagnosis_progress=diagnosis[1],
            diagnosis=diagnosis[2],
            stream_id=collector.stream_id,
            taken=self._taken,
        )
        message.header.stamp = convert.now(self._node)
        self._publisher.publish(message)

    def _warn(self, troubles: list[str]) -> None:
        """Log what is wrong, but not anew whenever a number changes."""
        said = {re.sub(r'\d+', '', text): text for text in troubles}
        for text in (said[key] for key in said.keys() - self._warned):
            self._node.get_logger().warning(text)
        self._warned = set(said)

    def _describe(self, session: Session) -> Described:
        collector = session.collector
        if session.busy:
            stage, fraction = session.progress
            aligning = stage == 'aligning'
            state = CalibratorState.ALIGNING if aligning else CalibratorState.SOLVING
            return state, fraction, f'{stage}, samples are still collected'
        if collector.taken or collector.beginning or session.answered:
            return self._outcome
        if collector.path is None:
            text = 'waiting for planner/path or planner/axes: start the path planner, or replay a '
            return CalibratorState.WAITING_FOR_PATH, 0.0, text + 'bag with a path'
        if not len(collector.buffer):
            text = 'waiting for tracker/point: activate the tracker driver'
            if collector.ended and collector.published:
                text = (
                    f'no samples: the stream of the tracker driver has ended, and none of the '
                    f'{collector.published} samples that it published has arrived; drive again'
                )
            return CalibratorState.BUFFERING, 0.0, text
        text = f'{collector.travelled:.2f} of {collector.path.length:.2f} m driven; '
        parts = _part(collector)
        if parts['parts'] > 1:
            text += f"part {parts['part']} of {parts['parts']}, target '{parts['target']}'; "
        return CalibratorState.BUFFERING, _driven(collector), text + _awaited(session)


def _awaited(session: Session) -> str:
    """State what a run waits for, and what to do."""
    collector = session.collector
    silence = collector.silence(time.monotonic())
    if session.judging:
        return 'the end is being judged'
    if silence > SILENCE and collector.ended:
        return (
            'the stream has ended: call calibrator/calibrate, or drive again; a new stream sets '
            'these samples aside'
        )
    text = 'calibrates once the target stands still at the end point; or call calibrator/calibrate'
    if silence > SILENCE:
        text += f'; no sample for {silence:.0f} s, the run continues with the next'
    return text


def _driven(collector: Collector) -> float:
    """Share of the path that is driven, by time where parts differ in speed."""
    return collector.watcher.time_share if collector.path and collector.watcher else 0.0


def _part(collector: Collector) -> dict[str, Any]:
    """Fields of the state on the parts of the path."""
    path, watcher = collector.path, collector.watcher
    if not isinstance(path, PartsTrack) or watcher is None:
        return {'parts': int(path is not None)}
    driven = len(collector.buffer) > 0
    return {
        'parts': len(path.parts),
        'part': watcher.part if driven else 0,
        'target': path.parts[watcher.part - 1].target if driven else '',
    }


def places_of(job: Future[Any]) -> Mapping[str, Array] | None:
    """Where a calibration or a look found the reflectors; None if it tells nothing of them."""
    if job.exception():
        return None
    found = job.result()
    if isinstance(found, FirstSight):
        return found.places
    return {name: own.place for name, own in found.result.targets.items()} or None


class OutcomePublisher:
    """Publishes what a calibration, a look or a diagnosis ended with.

    Attributes
    ----------
    latest : CalibrationResult message or None
        The result that was published last.
    """

    def __init__(self, node: Node, session: Session, state: StatePublisher) -> None:
        self._node, self._log = node, node.get_logger()
        self._session, self._state = session, state
        self.latest: ResultMessage | None = None
        self._unpublished: Request | None = None
        publisher = node.create_publisher
        self._tables = publisher(ErrorTables, 'calibrator/error_tables', qos.RESULT)
        self._result = publisher(ResultMessage, 'calibrator/result', qos.RESULT)
        self._volume = publisher(VolumeErrors, 'calibrator/volume', qos.RESULT)
        self._alignment = publisher(TransformStamped, 'calibrator/alignment', qos.RESULT)
        self._gap = publisher(GapReport, 'calibrator/gap_report', qos.RESULT)
        broadcaster = StaticTransformBroadcaster
        self._broadcaster = broadcaster(node) if broadcaster else None

    def finish(self, job: Future[CalibrationOutput]) -> None:
        """Publish the result of a calibration, or why there is none; earlier tables stay."""
        error = job.exception()
        if error is None:
            try:
                self._publish(job.result())
                return
            except Exception as defect:  # noqa: BLE001 - the files are there
                error, self._unpublished = defect, job.result().request
        text, code = self._words(error)
        if not isinstance(error, Cancelled):
            now = convert.now(self._node)
            self._tell(convert_result.failure_to_message(code, text, now))
        text += self._session.intake.journal_words()
        if isinstance(error, Cancelled):
            self._state.cancelled(text, self._session)
        else:
            self._state.failed(text)

    def _publish(self, outcome: CalibrationOutput) -> None:
        """Publish a calibration, tables first, the result last."""
        now, request, result = convert.now(self._node), outcome.request, outcome.result
        messages = convert_result.messages_of(
            result, now, request.files.method, provisional=not request.final
        )
        message, folder = messages.result, str(outcome.folder or '')
        messages.tables.output_directory = message.output_directory = folder
        self._tables.publish(messages.tables)
        self._place_tracker(messages.alignment)
        self._volume.publish(messages.volume)
        message.samples_lost = request.lost
        lost = lost_words(request.lost) if request.lost else ''
        message.warnings = [t for t in (*result.warnings, outcome.problem, lost) if t]
        self._tell(message)
        for text in message.warnings:
            self._log.warning(text)

    def complete(self, outcome: CalibrationOutput) -> None:
        """State that all files of a calibration are there; diagnose it if that is wanted."""
        if outcome.request is self._unpublished:
            return  # the state says what failed
        self._state.done(outcome)
        if outcome.request.files.diagnose:
            started, text = self._session.diagnose()
            if not started:
                self._undiagnosed(outcome, 2, text)

    def publish_sight(self, sight: FirstSight) -> None:
        """Publish where the tracker stands."""
        now = convert.now(self._node)
        self._place_tracker(convert_result.alignment_to_message(sight.T_machine_tracker, now))
        self._log.info(sight.words)

    def publish_diagnosis(self, diagnosis: Diagnosis) -> None:
        """Publish what a diagnosis of a calibrated run gave, or why it gave nothing."""
        outcome, error = diagnosis.calibrated, diagnosis.answer.exception()
        if error:
            self._undiagnosed(outcome, *reversed(self._words(error)))
            return
        answer = diagnosis.answer.result()
        message = convert_gap.gap_to_message(answer, convert.now(self._node))
        message.output_directory = str(outcome.folder)
        self._tell_gap(message, outcome)
        text = f'{answer["verdict"]}: {answer["sentence"]} Files in {outcome.folder}'
        self._state.diagnosed(1.0, text)

    def _undiagnosed(self, outcome: CalibrationOutput, code: int, text: str) -> None:
        now = convert.now(self._node)
        self._tell_gap(convert_gap.gap_failure_to_message(code, text, now), outcome)
        words = f'no diagnosis: {text}; correct it and call calibrator/diagnose'
        self._state.diagnosed(0.0, words)

    def _words(self, error: BaseException) -> tuple[str, int]:
        """Why there is no result, and the exit code; the traceback of a defect is logged."""
        if isinstance(error, OtfError):
            return str(error), error.exit_code
        child = isinstance(error, ChildError)
        self._log.error(str(error) if child else ''.join(traceback.format_exception(error)))
        return internal_error(error), 1

    def _place_tracker(self, alignment: TransformStamped) -> None:
        self._alignment.publish(alignment)
        if self._broadcaster:
            self._broadcaster.sendTransform(alignment)

    def _tell(self, message: ResultMessage) -> None:
        self.latest = message
        self._result.publish(message)

    def _tell_gap(self, message: GapReport, outcome: CalibrationOutput) -> None:
        message.run_id, message.machine = outcome.result.run_id, outcome.recording.machine.name
        self._gap.publish(message)


def diagnose_node(
    node: Node, session: Session, folder: Callable[[], str], machine: Callable[[], str]
) -> Diagnostics:
    """Publish on ``/diagnostics`` what a calibrator finds.

    Parameters
    ----------
    folder : callable
        Returns where results go.
    machine : callable
        Returns the name of the machine.
    """
    before = [0]

    def samples() -> Finding:
        count = len(session.collector.buffer)
        came, before[0] = max(0, count - before[0]), count
        values = {'samples of the run': count, 'rate [Hz]': came / PERIOD}
        return Finding(Level.OK, f'{count} samples of the present run', values)

    def losses() -> Finding:
        lost = session.collector.count_lost(time.monotonic())
        level, text = (Level.WARN, lost_words(lost)) if lost else (Level.OK, 'nothing is lost')
        return Finding(level, text, {'lost': lost})

    def work() -> Finding:
        if session.busy:
            stage, fraction = session.progress
            return Finding(Level.OK, stage, {'done': fraction})
        return Finding(Level.OK, 'waits' if session.collector.taken else 'collects')

    tasks = {
        'samples': samples,
        'losses': losses,
        'work': work,
        'disk': lambda: disk(folder()),
        'journal': lambda: _journal(session.intake.journal),
        'memory': memory,
    }
    return Diagnostics(node, machine, tasks)


def _journal(writer: Journal | None) -> Finding:
    """Whether samples are on the disk as they come, and the room left there."""
    if writer is None:
        return Finding(Level.OK, 'no journal is kept')
    if writer.trouble:
        return Finding(Level.ERROR, writer.trouble)
    return disk(str(writer.directory))
