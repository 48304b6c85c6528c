# SPDX-License-Identifier: Apache-2.0
"""What calibrations and diagnoses end with: results, failures, states."""

from __future__ import annotations

import traceback
from concurrent.futures import Future

from rclpy.node import Node

from otf_calibrator.diagnosis_job import Answer
from otf_calibrator.diagnosis_task import Failure
from otf_calibrator.job import Calibrated
from otf_calibrator.results import ResultPublishers
from otf_calibrator.session import Session
from otf_calibrator.state import StatePublisher
from otf_core.errors import Cancelled, OtfError


class OutcomePublisher:
    """Publishes what a calibration or a diagnosis ended with."""

    def __init__(self, node: Node, session: Session, state: StatePublisher) -> None:
        self._log, self._session, self._state = node.get_logger(), session, state
        self.results = ResultPublishers(node, session.intake)

    def finish(self, job: Future[Calibrated]) -> None:
        """Publish the result of a calibration, or why there is none."""
        error = job.exception()
        if error is None:
            for text in self.results.publish(job.result()):
                self._log.warning(text)
            return
        if not isinstance(error, OtfError):
            self._log.error(''.join(traceback.format_exception(error)))
        text = self.results.publish_failure(error) + self._session.intake.kept()
        if isinstance(error, Cancelled):
            self._state.cancelled(text, self._session)
        else:
            self._state.failed(text)

    def complete(self, outcome: Calibrated) -> None:
        """State that all files of a calibration are there; diagnose it if that is wanted."""
        self._state.done(outcome)
        if outcome.request.files.diagnose:
            started, text = self._session.diagnose()
            if not started:
                self.publish_diagnosis(outcome, Failure(2, text))

    def publish_diagnosis(self, outcome: Calibrated, answer: Answer) -> None:
        """Publish what a diagnosis gave."""
        self.results.publish_gap(outcome, answer)
        self._state.diagnosed(outcome, answer)
