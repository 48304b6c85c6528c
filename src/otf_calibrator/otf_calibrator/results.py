# SPDX-License-Identifier: Apache-2.0
"""What calibrations and diagnoses end with: latched results, failures, states."""

from __future__ import annotations

import traceback
from concurrent.futures import Future

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from std_msgs.msg import Header

from otf_calibrator.children import Answer, Failure
from otf_calibrator.intake import Intake
from otf_calibrator.job import CalibrationOutput
from otf_calibrator.losses import lost_words
from otf_calibrator.messages import messages_of
from otf_calibrator.session import Ahead, Session
from otf_calibrator.state import StatePublisher
from otf_core.calibration.first_sight import FirstSight
from otf_core.errors import Cancelled, OtfError
from otf_msgs.msg import CalibrationResult as ResultMessage
from otf_msgs.msg import ErrorTables, GapReport, VolumeErrors
from otf_ros import convert_gap, convert_result, qos
from otf_ros.convert import ns_from_time, time_from_ns

try:
    from tf2_ros import StaticTransformBroadcaster
except ImportError:  # a small installation: calibrator/alignment says the same
    StaticTransformBroadcaster = None


class SharedTracker:
    """One tracker for several machines: whose run the samples were.

    Every calibrator hears all samples of its tracker, also while another machine drives. When a
    run is calibrated, the calibrator of its machine publishes on ``tracker/calibrated`` the stamp
    of the last sample and, as frame_id, the topic of the path, which distinguishes machines. The
    others set aside the samples up to then.
    """

    def __init__(self, node: Node, intake: Intake) -> None:
        self._intake, self._path = intake, node.resolve_topic_name('planner/path')
        self._publisher = node.create_publisher(Header, 'tracker/calibrated', qos.COMMAND)
        node.create_subscription(Header, 'tracker/calibrated', self._on_other, qos.COMMAND)

    def tell(self, outcome: CalibrationOutput) -> None:
        """Announce that a run was that of this machine; not of an interim result."""
        if outcome.request.final:
            stamp = time_from_ns(int(outcome.request.samples.stamp_ns[-1]))
            self._publisher.publish(Header(stamp=stamp, frame_id=self._path))

    def _on_other(self, message: Header) -> None:
        if message.frame_id != self._path:
            why = f'they belong to the run along {message.frame_id}'
            self._intake.set_aside_until(ns_from_time(message.stamp), why)


class ResultPublishers:
    """Topics below ``calibrator/``.

    Attributes
    ----------
    latest : CalibrationResult message or None
        The result that was published last.
    """

    def __init__(self, node: Node, intake: Intake) -> None:
        self._clock = node.get_clock()
        self._shared = SharedTracker(node, intake)
        self.latest: ResultMessage | None = None
        self._tables = node.create_publisher(ErrorTables, 'calibrator/error_tables', qos.RESULT)
        self._result = node.create_publisher(ResultMessage, 'calibrator/result', qos.RESULT)
        self._provisional = node.create_publisher(
            ResultMessage, 'calibrator/provisional', qos.RESULT
        )
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
        messages = messages_of(result, now, outcome.request.files.method)
        tables, message = messages.tables, messages.result
        tables.output_directory = str(outcome.folder or '')
        self._tables.publish(tables)
        self._alignment.publish(messages.alignment)
        self._tell_tf(messages.alignment)
        self._volume.publish(messages.volume)
        message.samples_lost, message.output_directory = lost, str(outcome.folder or '')
        message.samples_lost_is_lower_bound = outcome.request.lost_at_least
        warnings = [*result.warnings, outcome.problem]
        warnings.append(lost_words(lost, outcome.request.lost_at_least) if lost else '')
        message.warnings = [text for text in warnings if text]
        self._tell(message)
        self._shared.tell(outcome)
        return list(message.warnings)

    def publish_provisional(self, job: Future[Ahead], method: str) -> str:
        """Publish what the samples of a run say so far; return what to tell of it."""
        error, now = job.exception(), self._clock.now().to_msg()
        if isinstance(error, Cancelled):
            return 'the run is over before its provisional result'
        if error:
            code = error.exit_code if isinstance(error, OtfError) else 1
            self._provisional.publish(convert_result.failure_to_message(code, str(error), now))
            return f'no provisional result: {error}'
        result = job.result()
        if isinstance(result, FirstSight):
            place = result.T_machine_tracker
            self._tell_tf(convert_result.alignment_to_message(place, now))
            self._provisional.publish(convert_result.sight_to_message(result, now))
            return f'provisional: {result.words}'
        messages = messages_of(result, now, method, provisional=True)
        self._tell_tf(messages.alignment)
        self._volume.publish(messages.volume)
        self._provisional.publish(messages.result)
        return f'provisional: {messages.result.message}'

    def _tell_tf(self, alignment: TransformStamped) -> None:
        """Tell tf of the place of the tracker."""
        if self._broadcaster:
            self._broadcaster.sendTransform(alignment)

    def publish_failure(self, error: BaseException) -> str:
        """Publish that there is no result unless it was cancelled; return why there is none.

        The tables published before stay.
        """
        text, code = f'internal error: {error!r}', 1
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
        self.results = ResultPublishers(node, session.intake)

    def finish(self, job: Future[CalibrationOutput]) -> None:
        """Publish the result of a calibration, or why there is none."""
        error = job.exception()
        if error is None:
            for text in self.results.publish(job.result()):
                self._log.warning(text)
            return
        if not isinstance(error, OtfError):
            self._log.error(''.join(traceback.format_exception(error)))
        text = self.results.publish_failure(error) + self._session.intake.journal_words()
        if isinstance(error, Cancelled):
            self._state.cancelled(text, self._session)
        else:
            self._state.failed(text)

    def complete(self, outcome: CalibrationOutput) -> None:
        """State that all files of a calibration are there; diagnose it if that is wanted."""
        self._state.done(outcome)
        if outcome.request.files.diagnose:
            started, text = self._session.diagnose()
            if not started:
                self.publish_diagnosis(outcome, Failure(2, text))

    def publish_diagnosis(self, outcome: CalibrationOutput, answer: Answer) -> None:
        """Publish what a diagnosis gave."""
        self.results.publish_gap(outcome, answer)
        self._state.diagnosed(outcome, answer)
