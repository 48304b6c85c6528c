# SPDX-License-Identifier: Apache-2.0
"""Action and service refuse with a reason; the action can be cancelled."""

from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus
from caller import Caller
from cells import FAST, SHORT
from rclpy.action import CancelResponse

from otf_calibrator import action


@pytest.fixture
def caller(graph, machine_file):
    """Ears for the action of a calibrator that calibrates only when asked to."""
    asked = {'finish_at_stream_end': False, 'finish_at_standstill': False, 'idle_timeout': 0.0}
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out', **asked}
    graph.start('calibrator', **given)
    caller = Caller(graph)
    yield caller
    caller.close()


def test_both_refuse_with_a_reason_and_the_action_can_be_cancelled(graph, machine_file, caller):
    status, result = caller.outcome(caller.send())
    assert status == GoalStatus.STATUS_ABORTED and not result.success and result.code == 2
    assert 'no path yet' in result.message
    answer = graph.trigger('calibrator/calibrate')
    assert not answer.success and 'no path yet' in answer.message
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.wait_for_state('BUFFERING')
    answer = graph.trigger('calibrator/calibrate')
    assert not answer.success and 'no samples yet' in answer.message

    graph.start('tracker_driver', machine_file=machine_file, **FAST)
    count = graph.wait_for_status('FINISHED').samples_published
    graph.wait(lambda: graph.state() and graph.state().samples == count, 'all samples')
    goal = caller.send()
    graph.wait(lambda: caller.feedback, 'feedback')
    second = caller.send()
    cancelling = goal.cancel_goal_async()
    graph.wait(cancelling.done, 'the answer to the cancel')
    status, refusal = caller.outcome(second)
    assert status == GoalStatus.STATUS_ABORTED and 'under way' in refusal.message
    status, result = caller.outcome(goal)
    assert status == GoalStatus.STATUS_CANCELED and not result.success and result.code == 130
    assert 'cancelled; its samples stay' in result.message
    graph.wait(lambda: 'was cancelled' in graph.state().message, 'the state')
    assert graph.state().name == 'BUFFERING' and graph.state().samples == count
    assert not graph.heard['calibrator/result']  # nothing is wrong, and no result came


def test_cancel_of_a_goal_that_is_refused_leaves_the_one_under_way_alone(graph, monkeypatch):
    cancelled, answers = [], iter([(True, 'started'), (False, 'under way')])
    session = SimpleNamespace(calibrate=lambda: next(answers), cancel=lambda: cancelled.append(1))
    offered, executed = {}, []
    monkeypatch.setattr(action, 'ActionServer', lambda *given, **calls: offered.update(calls))
    action.CalibrateAction(graph.ear(), session, lambda: None)
    first, second = (SimpleNamespace(execute=executed.append) for _ in range(2))
    offered['handle_accepted_callback'](first)
    offered['handle_accepted_callback'](second)
    assert len(executed) == 1  # in the next turn of the executor
    assert offered['cancel_callback'](second) == CancelResponse.REJECT and not cancelled
    assert offered['cancel_callback'](first) == CancelResponse.ACCEPT and cancelled
