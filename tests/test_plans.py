# SPDX-License-Identifier: Apache-2.0
"""Plans that cannot be driven: the driver says why, lives on and drives the next good one."""

import math

import pytest
from cells import SHORT
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from otf_msgs.msg import Plan
from otf_ros import qos

DRIVER = {'wait_for_subscribers': 0, 'simulated.rate': 200.0, 'time_scale': 1.0}
PLAN = {'points': [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)], 'feed': [0.1], 'dwell': [1.0, 1.0]}
MALFORMED = [
    ({'feed': []}, 'feed: a plan of 2 points needs shape (1,), got (0,)'),
    ({'feed': [0.0]}, 'feed: leg 0: must be above 0'),
    ({'feed': [math.nan]}, 'feed: leg 0: must be finite'),
    ({'dwell': [1.0]}, 'dwell: a plan of 2 points needs shape (2,), got (1,)'),
    ({'dwell': [0.0, -1.0]}, 'dwell: point 1: must not be negative'),
    ({'points': []}, 'axis positions: 0 corners without any motion'),
    (
        {'points': [(0.0, 0.0, 0.0), (0.1, math.inf, 0.0)]},
        'axis positions: corner 1 is not finite',
    ),
    (
        {'points': [(0.0, 0.0, 0.0), (100.0, 0.0, 0.0)]},
        'axis positions: corner 1 leaves the range of axis X',
    ),
]


def message(**change):
    content = {**PLAN, **change}
    corners = [JointTrajectoryPoint(positions=p) for p in content.pop('points')]
    return Plan(parts=[JointTrajectory(joint_names=list('XYZ'), points=corners)], **content)


@pytest.fixture
def publisher(graph, machine_file):
    """Publisher of plans in a graph with a driver that waits for one."""
    graph.start('tracker_driver', machine_file=machine_file, **DRIVER)
    graph.wait_for_status('IDLE', 'waiting for planner/plan')
    return graph.ear().create_publisher(Plan, 'planner/plan', qos.PATH)


def test_malformed_plans_are_refused_one_by_one_and_the_next_good_one_is_driven(graph, publisher):
    for change, words in MALFORMED:
        publisher.publish(message(**change))
        graph.wait_for_status('FAULT', f'planner/plan cannot be driven: {words}')
    publisher.publish(message())
    status = graph.wait_for_status('STREAMING')
    assert status.header.frame_id == 'tracker'
    for change, words in MALFORMED:
        assert graph.logs().count(words) == 1, change


def test_fault_stays_on_show_until_a_planner_comes(graph, machine_file, publisher):
    publisher.publish(message(feed=[-1.0]))
    graph.wait_for_status('FAULT', 'must be above 0')
    heard = graph.listen(type(graph.status()), 'tracker/status')
    heard.clear()
    graph.wait(lambda: len(heard) > 2, 'the status again')
    assert {status.name for status in heard} == {'FAULT'}
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.wait_for_status('STREAMING')
