# SPDX-License-Identifier: Apache-2.0
"""Action ``calibrator/calibrate``: what the service of that name does, with feedback and cancel.

A goal waits without a thread or a coroutine of its own; for the latter rclpy would keep a
processor busy. It stays accepted, the node looks at it now and then, and it is executed when the
outcome is known.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from otf_calibrator.session import Session
from otf_core.errors import Cancelled
from otf_core.live.stages import TimeLeft
from otf_msgs.action import Calibrate
from otf_msgs.msg import CalibrationResult

REPEAT = 0.5
"""s; feedback is published at least so often."""
REFUSED = 2
"""Status of a goal that cannot start: that of wrong usage of the command line."""


class CalibrateAction:
    """Offers the action; ``look`` has to be called now and then.

    Parameters
    ----------
    latest : callable
        Returns the result that was published last, None before the first.
    """

    def __init__(
        self, node: Node, session: Session, latest: Callable[[], CalibrationResult | None]
    ) -> None:
        self._node, self._session, self._latest = node, session, latest
        self._goal: ServerGoalHandle | None = None
        self._before: CalibrationResult | None = None
        self._shown: tuple[str, float] = ('', 0.0)
        self._at = 0.0
        self._time_left = TimeLeft()
        self._server = ActionServer(
            node,
            Calibrate,
            'calibrator/calibrate',
            execute_callback=self._refuse,
            handle_accepted_callback=self._begin,
            cancel_callback=self._cancel,
        )

    def close(self) -> None:
        """Offer it no longer."""
        self._server.destroy()

    def look(self) -> None:
        """Determine how far the calibration is, or what it gave."""
        if self._goal is None:
            return
        if not self._session.busy:
            goal, self._goal, latest = self._goal, None, self._latest()
            result = None if latest is self._before else latest
            goal.execute(lambda goal: self._end(goal, result) if result else self._give_up(goal))
            return
        shown, now = self._session.progress, time.monotonic()
        if shown != self._shown or now - self._at > REPEAT:
            self._shown, self._at = shown, now
            remaining = self._time_left.estimate(*shown, now)
            feedback = Calibrate.Feedback(stage=shown[0], fraction=shown[1], time_left=remaining)
            self._goal.publish_feedback(feedback)

    def _begin(self, goal: ServerGoalHandle) -> None:
        before = self._latest()
        started, text = self._session.calibrate()
        self._node.get_logger().info(f'calibrator/calibrate: {text}')
        if started:
            self._goal, self._before = goal, before
        else:
            goal.execute(lambda goal: self._refuse(goal, text))

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if goal is not self._goal:  # refused, or it has just ended
            return CancelResponse.REJECT
        self._session.cancel()
        return CancelResponse.ACCEPT

    @staticmethod
    def _refuse(goal: ServerGoalHandle, text: str = '') -> Calibrate.Result:
        goal.abort()
        return Calibrate.Result(code=REFUSED, message=text)

    @staticmethod
    def _give_up(goal: ServerGoalHandle) -> Calibrate.Result:
        goal.canceled()
        text = 'the calibration was cancelled; its samples stay'
        return Calibrate.Result(code=Cancelled.exit_code, message=text)

    @staticmethod
    def _end(goal: ServerGoalHandle, outcome: CalibrationResult) -> Calibrate.Result:
        success = bool(outcome.run_id)
        if success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return Calibrate.Result(
            success=success,
            code=outcome.status,
            message=outcome.message,
            run_id=outcome.run_id,
            output_directory=outcome.output_directory,
        )
