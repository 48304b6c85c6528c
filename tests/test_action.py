# SPDX-License-Identifier: Apache-2.0
"""The action beside the service refuses, tells how far it is, and can be cancelled."""

import pytest
from action_msgs.msg import GoalStatus
from caller import Caller
from cells import FAST, SHORT


@pytest.fixture
def caller(graph, machine_file):
    """Ears for the action of a calibrator that calibrates only when asked to."""
    asked = {'finish_at_stream_end': False, 'finish_at_standstill': False, 'idle_timeout': 0.0}
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out', **asked}
    graph.start('calibrator', **given)
    caller = Caller(graph)
    yield caller
    caller.close()


def test_action_refuses_with_a_reason_and_can_be_cancelled(graph, machine_file, caller):
    status, result = caller.outcome(caller.send())
    assert status == GoalStatus.STATUS_ABORTED and not result.success and result.code == 2
    assert 'no path yet' in result.message

    graph.start('path_planner', machine_file=machine_file, **SHORT)
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
