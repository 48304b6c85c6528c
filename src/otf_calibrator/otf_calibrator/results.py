# SPDX-License-Identifier: Apache-2.0
"""What calibrations and diagnoses end with: latched results, failures, states."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from otf_calibrator.children import Answer, Failure, internal_error
from otf_calibrator.job import CalibrationOutput, Request
from otf_calibrator.losses import lost_words
from otf_calibrator.session import Session
from otf_calibrator.state import StatePublisher
from otf_core.arrays import Array
from otf_core.calibration.first_sight import FirstSight
from otf_core.errors import Cancelled, OtfError
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import ErrorTables, GapReport, VolumeErrors
from otf_ros import convert_gap, convert_result, qos

try:
    from tf2_ros import StaticTransformBroadcaster
except ImportError:  # a small installation: calibrator/alignment says the same
    StaticTransformBroadcaster = None


def places_of(job: Future[Any]) -> Mapping[str, Array] | None:
    """Where a calibration or a look found the reflectors; None if it tells nothing of them."""
    if job.exception():
        return None
    found = job.result()
    if isinstance(found, FirstSight):
        return found.places
    return {name: own.place for name, own in found.result.targets.items()} or None


class ResultPublishers:
    """Topics below ``calibrator/``.

    Attributes
    ----------
    latest : CalibrationResult message or None
        The result that was published last.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self.latest: ResultMessage | None = None
        self._tables = node.create_publisher(ErrorTables, 'calibrator/error_tables', qos.RESULT)
        self._result = node.create_publisher(ResultMessage, 'calibrator/result', qos.RESULT)
        self._volume = node.create_publisher(VolumeErrors, 'calibrator/volume', qos.RESULT)
        self._alignment = node.create_publisher(
            TransformStamped, 'calibrator/alignment', qos.RESULT
        )
        self._gap = node.create_publisher(GapReport, 'calibrator/gap_report', qos.RESULT)
        self._broadcaster = (
            StaticTransformBroadcaster(node) if StaticTransformBroadcaster else None
        )

    def publish(self, outcome: CalibrationOutput) -> list[str]:
        """Publish a calibration, tables first, the result last; return all warnings."""
        now = self._clock.now().to_msg()
        result, lost = outcome.result, outcome.request.lost
        request = outcome.request
        messages = convert_result.messages_of(
            result, now, request.files.method, provisional=not request.final
        )
        tables, message = messages.tables, messages.result
        tables.output_directory = str(outcome.folder or '')
        self._tables.publish(tables)
        self._place_tracker(messages.alignment)
        self._volume.publish(messages.volume)
        message.samples_lost, message.output_directory = lost, str(outcome.folder or '')
        warnings = [*result.warnings, outcome.problem]
        warnings.append(lost_words(lost) if lost else '')
        message.warnings = [text for text in warnings if text]
        self._tell(message)
        return list(message.warnings)

    def publish_sight(self, look: Future[FirstSight]) -> str:
        """Publish where the tracker stands; return what to tell of it."""
        sight, now = look.result(), self._clock.now().to_msg()
        self._place_tracker(convert_result.alignment_to_message(sight.T_machine_tracker, now))
        return sight.words

    def _place_tracker(self, alignment: TransformStamped) -> None:
        self._alignment.publish(alignment)
        if self._broadcaster:
            self._broadcaster.sendTransform(alignment)

    def publish_failure(self, error: BaseException) -> str:
        """Publish that there is no result unless it was cancelled; return why there is none.

        The tables published before stay.
        """
        text, code = internal_error(error), 1
        if isinstance(error, OtfError):
            text, code = str(error), error.exit_code
        if not isinstance(error, Cancelled):
            now = self._clock.now().to_msg()
            self._tell(convert_result.failure_to_message(code, text, now))
        return text

    def _tell(self, message: ResultMessage) -> None:
        self.latest = message
        self._result.publish(message)

    def publish_gap(self, outcome: CalibrationOutput, answer: Answer) -> None:
        """Publish what a diagnosis of a calibrated run gave, or why it gave nothing."""
        now = self._clock.now().to_msg()
        if isinstance(answer, Failure):
            message = convert_gap.gap_failure_to_message(answer.exit_code, answer.text, now)
        else:
            message = convert_gap.gap_to_message(answer, now)
            message.output_directory = str(outcome.folder)
        message.run_id, message.machine = outcome.result.run_id, outcome.recording.machine.name
        self._gap.publish(message)


class OutcomePublisher:
    """Publishes what a calibration or a diagnosis ended with."""

    def __init__(self, node: Node, session: Session, state: StatePublisher) -> None:
        self._log, self._session, self._state = node.get_logger(), session, state
        self.results = ResultPublishers(node)
        self._unpublished: Request | None = None

    def finish(self, job: Future[CalibrationOutput]) -> None:
        """Publish the result of a calibration, or why there is none."""
        error = job.exception()
        if error is None:
            try:
                for text in self.results.publish(job.result()):
                    self._log.warning(text)
                return
            except Exception as defect:  # noqa: BLE001 - the files are there
                error, self._unpublished = defect, job.result().request
        if not isinstance(error, OtfError):
            self._log.error(''.join(traceback.format_exception(error)))
        text = self.results.publish_failure(error) + self._session.intake.journal_words()
        if isinstance(error, Cancelled):
            self._state.cancelled(text, self._session)
        else:
            self._state.failed(text)

    def complete(self, outcome: CalibrationOutput) -> None:
        """State that all files of a calibration are there; diagnose it if that is wanted."""
        if outcome.request is self._unpublished:
            return  # the state says what failed
        self._state.done(outcome)
        if outcome.request.files.diagnose:
            started, text = self._session.diagnose()
            if not started:
                self.publish_diagnosis(outcome, Failure(2, text))

    def publish_diagnosis(self, outcome: CalibrationOutput, answer: Answer) -> None:
        """Publish what a diagnosis gave."""
        if isinstance(answer, Failure) and answer.traceback:
            self._log.error(answer.traceback)
        self.results.publish_gap(outcome, answer)
        self._state.diagnosed(outcome, answer)
