# SPDX-License-Identifier: Apache-2.0
"""The action beside the service: refusal, feedback, cancel, and the result that all others get."""

import math
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from cells import FAST, SHORT
from rclpy.action import ActionClient

from otf_msgs.action import Calibrate
from otf_msgs.msg import CalibrationResult
from otf_ros import qos


class Caller:
    """Sends goals and waits for what comes of them."""

    def __init__(self, graph):
        self._graph = graph
        self._client = ActionClient(graph.ear(), Calibrate, 'calibrator/calibrate')
        graph.wait(self._client.server_is_ready, 'the action')
        self.feedback = []

    def send(self):
        """Send a goal; return its handle once it is accepted."""
        self.feedback.clear()
        sending = self._client.send_goal_async(
            Calibrate.Goal(), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self._graph.wait(sending.done, 'acceptance')
        assert sending.result().accepted
        return sending.result()

    def outcome(self, goal):
        """Wait for the end of a goal; return status and result."""
        asking = goal.get_result_async()
        self._graph.wait(asking.done, 'the result')
        return asking.result().status, asking.result().result

    def close(self):
        self._client.destroy()


@pytest.fixture
def caller(graph, machine_file):
    """Ears for the action of a calibrator that calibrates only when asked to."""
    asked = {'finish_at_stream_end': False, 'finish_at_standstill': False, 'idle_timeout': 0.0}
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out', **asked}
    graph.start('calibrator', **given)
    caller = Caller(graph)
    yield caller
    caller.close()


def test_action_refuses_cancels_and_gives_the_result(graph, machine_file, caller):
    status, result = caller.outcome(caller.send())
    assert status == GoalStatus.STATUS_ABORTED and not result.success and result.code == 2
    assert 'no path yet' in result.message

    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('tracker_driver', machine_file=machine_file, **FAST)
    count = graph.wait_for_status('FINISHED').samples_published
    graph.wait(lambda: graph.state() and graph.state().samples == count, 'all samples')
    goal = caller.send()
    graph.wait(lambda: caller.feedback, 'feedback')
    second, refusal = caller.outcome(caller.send())
    assert second == GoalStatus.STATUS_ABORTED and 'under way' in refusal.message
    cancelling = goal.cancel_goal_async()
    graph.wait(cancelling.done, 'the answer to the cancel')
    status, result = caller.outcome(goal)
    assert status == GoalStatus.STATUS_CANCELED and not result.success
    assert 'cancelled; its samples stay' in result.message
    assert graph.wait_for_state('FAILED').samples == count

    results = graph.listen(CalibrationResult, 'calibrator/result', qos.RESULT)
    status, result = caller.outcome(caller.send())
    assert (status, result.code) == (GoalStatus.STATUS_SUCCEEDED, 0), result.message
    assert {f.stage for f in caller.feedback} == {'aligning', 'solving'}
    assert all(0 <= f.fraction <= 1 for f in caller.feedback)
    assert all(math.isnan(f.time_left) or f.time_left >= 0 for f in caller.feedback)
    graph.wait(lambda: results[-1].run_id == result.run_id, 'the same for all')
    assert results[-1].samples == count and results[-1].message == result.message
    assert (Path(result.output_directory) / 'error_tables.json').exists()
    assert graph.wait_for_state('DONE').stage == ''
