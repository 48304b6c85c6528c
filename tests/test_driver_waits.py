# SPDX-License-Identifier: Apache-2.0
"""A driver that waits: for a tracker that is off, for calibrators, for samples."""

import socket

import pytest
from cells import SHORT
from diagnostic_msgs.msg import DiagnosticArray
from emulated import emulator
from geometry_msgs.msg import PointStamped
from other_tracker import other_tracker

from otf_msgs.msg import CalibratorState
from otf_ros import qos

LOGGED = 6
"""Times that ten seconds of silence are logged, at the most."""


@pytest.fixture
def port():
    """A port of this computer at which nobody listens."""
    with socket.create_server(('127.0.0.1', 0)) as free:
        return free.getsockname()[1]


def emscon(graph, port, **given):
    given = {'wait_for_subscribers': 0, **given}
    return graph.start('tracker_driver', backend='emscon', **{'emscon.port': port}, **given)


def test_tracker_that_is_off_at_launch_is_waited_for_and_streams_once_it_is_on(graph, port):
    points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
    emscon(graph, port, longest_retry=2.0)
    status = graph.wait_for_status('NO_CONNECTION', 'next one in')
    assert f'127.0.0.1:{port}: no connection' in status.message and 'it is on' in status.message
    assert graph.lifecycle_state() == 'unconfigured'
    graph.wait_for_status('NO_CONNECTION', '3 attempts')
    assert not graph.transition('configure')
    with other_tracker(port=port):
        graph.wait_for_status('STREAMING')
        graph.wait(lambda: points, 'samples')
        assert graph.transition('deactivate') and graph.transition('cleanup')
        assert graph.lifecycle_state() == 'unconfigured'


def test_driver_that_was_configured_by_hand_meanwhile_is_left_to_people(graph, port):
    emscon(graph, port, longest_retry=600.0)
    graph.wait_for_status('NO_CONNECTION', '3 attempts')
    with other_tracker(port=port):
        assert graph.transition('configure')
        status = graph.wait_for_status('IDLE', 'not activated')
        assert 'emScon 3.8.1' in status.message
        assert graph.lifecycle_state() == 'inactive'


def test_driver_that_shall_not_wait_ends_with_the_error(graph, port):
    node = emscon(graph, port, longest_retry=0.0)
    graph.nodes.remove(node)
    assert node.wait(timeout=60.0) == 3
    said = [line for line in node.last_lines(100).splitlines() if line.startswith('error: ')]
    assert len(said) == 1 and 'no connection' in said[0]


def test_recorders_are_no_calibrators_but_every_node_that_publishes_a_state_is(graph):
    points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
    with emulator() as running:
        emscon(graph, running.port, wait_for_subscribers=1)
        status = graph.wait_for_status('IDLE', 'waiting for calibrators')
        assert '0 of 1' in status.message and 'wait_for_subscribers' in status.message
        ear = graph.ear()
        graph.wait(lambda: ear.count_publishers('tracker/point'), 'the publisher')
        graph.wait(lambda: len(graph.heard['tracker/status']) > 8, 'a while')
        assert not points and graph.status().name == 'IDLE'
        state = ear.create_publisher(CalibratorState, 'somewhere/else', qos.STATUS)
        graph.wait_for_status('STREAMING')
        ear.destroy_publisher(state)


def test_silence_is_told_with_its_duration_and_restarts_and_is_a_fault_in_the_end(graph):
    diagnosed = graph.listen(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
    with other_tracker(silent=True) as tracker:
        driver = emscon(graph, tracker.port)
        graph.wait_for_status('SILENT', 'sends nothing')
        status = graph.wait_for_status('FAULT', 'no samples for')
        assert status.silent_for > 10.0 and status.restarts >= 3
        assert f'{status.restarts} restarts' in status.message
        assert status.interruptions == status.samples_published == 0
        assert not [s for s in graph.heard['tracker/status'] if s.name == 'STREAMING']
        said = [line for line in driver.last_lines(1000).splitlines() if 'no samples for' in line]
        assert 2 <= len(said) <= LOGGED
        tracker.silent = False
        status = graph.wait_for_status('STREAMING')
        assert status.silent_for == status.restarts == 0
    assert {one.hardware_id for message in diagnosed for one in message.status} >= {'tracker 99'}
    assert all(one.hardware_id for message in diagnosed for one in message.status)


def test_setting_what_counts_later_says_when(graph, machine_file):
    given = {'machine_file': machine_file, 'wait_for_subscribers': 0, 'auto_start': False}
    graph.start('tracker_driver', **given)
    assert graph.set_parameter('tracker_driver', 'time_scale', 2.0).reason == ''
    assert graph.transition('configure')
    answer = graph.set_parameter('tracker_driver', 'backend', 'replay')
    assert answer.successful and 'configured next; it is inactive now' in answer.reason
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    answer = graph.set_parameter('path_planner', 'feed', 0.1)
    assert answer.successful and 'planner/replan' in answer.reason
