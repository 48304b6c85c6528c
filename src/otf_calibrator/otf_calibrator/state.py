# SPDX-License-Identifier: Apache-2.0
"""The latched state of the calibrator: what it does, how far it is, what to do next."""

from __future__ import annotations

import math
import re
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node

from otf_calibrator.children import Answer, Failure
from otf_calibrator.collector import Collector
from otf_calibrator.job import CalibrationOutput
from otf_calibrator.session import Session
from otf_core.live.stages import TimeLeft
from otf_core.model.axis_path import PartsTrack
from otf_msgs.msg import CalibratorState
from otf_ros import qos

REPEAT = 0.5
"""s; the state is published at least so often."""
ACKNOWLEDGED = 500
"""Samples after which it is published too: a simulated or replayed stream waits for that."""
NAMES = {
    CalibratorState.WAITING_FOR_PATH: 'WAITING_FOR_PATH',
    CalibratorState.BUFFERING: 'BUFFERING',
    CalibratorState.ALIGNING: 'ALIGNING',
    CalibratorState.SOLVING: 'SOLVING',
    CalibratorState.DONE: 'DONE',
    CalibratorState.FAILED: 'FAILED',
}
SILENCE = 2.0
"""s without samples that the state speaks of."""
STAGES = {
    'aligning': CalibratorState.ALIGNING,
    'solving': CalibratorState.SOLVING,
}
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

    def diagnosed(self, outcome: CalibrationOutput, answer: Answer) -> None:
        """Remember what the diagnosis of the run gave."""
        logger = self._node.get_logger()
        if isinstance(answer, Failure):
            text = f'no diagnosis: {answer.text}; correct it and call calibrator/diagnose'
            self._diagnosis = (False, 0.0, text)
            logger.error(text)
            return
        text = f'{answer["verdict"]}: {answer["sentence"]} Files in {outcome.folder}'
        self._diagnosis = (False, 1.0, text)
        logger.info(f'diagnosis: {text}')

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
        now, shown = time.monotonic(), (state, job is not None)
        stage = _stage(session)
        work = stage, collector.run
        time_left = self._time_left.estimate(work, progress, now) if stage else math.nan
        due = now - self._at >= REPEAT or self._unsaid >= ACKNOWLEDGED
        if shown == self._shown and not due:
            return
        if state != self._shown[0]:
            if state == CalibratorState.FAILED:  # rclpy wants one severity per line of code
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
        message.header.stamp = self._node.get_clock().now().to_msg()
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
            state = STAGES.get(stage, CalibratorState.SOLVING)
            return state, fraction, f'{stage}, samples are still collected'
        if collector.taken or collector.beginning or session.answered:
            return self._outcome
        if collector.path is None:
            return (
                CalibratorState.WAITING_FOR_PATH,
                0.0,
                'waiting for planner/path or planner/axes: start the path planner, or replay a '
                'bag with a path',
            )
        if not len(collector.buffer):
            text = 'waiting for tracker/point: activate the tracker driver'
            if collector.ended and collector.published:
                text = (
                    f'no samples: the stream of the tracker driver has ended, and none of the '
                    f'{collector.published} samples that it published has arrived; drive again'
                )
            return CalibratorState.BUFFERING, 0.0, text
        length = collector.path.length
        silence = collector.silence(time.monotonic())
        text = f'{collector.travelled:.2f} of {length:.2f} m driven; '
        parts = _part(collector)
        if parts['parts'] > 1:
            text += f"part {parts['part']} of {parts['parts']}, target '{parts['target']}'; "
        if session.judging:
            return CalibratorState.BUFFERING, _driven(collector), text + 'the end is being judged'
        if silence > SILENCE and collector.ended:
            text += 'the stream has ended: call calibrator/calibrate, or drive again; '
            text += 'a new stream sets these samples aside'
            return CalibratorState.BUFFERING, _driven(collector), text
        text += 'calibrates once the target stands still at the end point; '
        text += 'or call calibrator/calibrate'
        if silence > SILENCE:
            text += f'; no sample for {silence:.0f} s, the run continues with the next'
        return CalibratorState.BUFFERING, _driven(collector), text


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


def _stage(session: Session) -> str:
    """What takes its time now; empty if nothing does."""
    if session.busy:
        return session.progress[0]
    collector = session.collector
    driving = collector.path is not None and len(collector.buffer) and not collector.taken
    return 'driving' if driving else ''
