# SPDX-License-Identifier: Apache-2.0
"""The tracker driver as a lifecycle node."""

import time

from cells import SHORT
from geometry_msgs.msg import PointStamped

from otf_ros import qos
from otf_ros.convert import ns_from_time

SLOW = {'simulated.rate': 200.0, 'time_scale': 1.0, 'wait_for_subscribers': 0}
NEAR = 20_000_000_000
"""ns; longer than a busy computer takes to simulate."""


def test_every_transition_does_what_its_name_says(graph, machine_file):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('tracker_driver', machine_file=machine_file, auto_start=False, **SLOW)
    assert graph.lifecycle_state() == 'unconfigured'
    assert not graph.transition('activate')
    assert graph.transition('configure')
    assert graph.lifecycle_state() == 'inactive'
    points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
    assert graph.transition('activate')
    streams = []
    for _ in range(2):
        points.clear()
        begun = time.time_ns()
        status = graph.wait_for_status('STREAMING')
        streams.append(status.stream_id)
        graph.wait(lambda: len(points) > 100, 'samples')
        assert graph.transition('deactivate')
        status = graph.wait_for_status('IDLE', 'stopped')
        graph.wait(lambda n=status: len(points) == n.samples_published, 'the last samples')
        assert status.last == points[-1].header.stamp
        stamps = [ns_from_time(point.header.stamp) for point in points[:100]]
        assert status.first == points[0].header.stamp
        assert -NEAR < begun - stamps[0] < NEAR, 'simulated samples are of now'
        streams.append([stamp - stamps[0] for stamp in stamps])
        assert graph.transition('activate')
    assert streams[0] != streams[2] and streams[1] == streams[3]
    assert graph.transition('deactivate')
    assert graph.transition('cleanup')
    assert graph.lifecycle_state() == 'unconfigured'
    assert graph.transition('configure')
    assert graph.transition('shutdown')
    assert graph.lifecycle_state() == 'finalized'


def test_stop_and_start_are_answered_and_told_as_they_are(graph, machine_file):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('calibrator', machine_file=machine_file)
    graph.start('tracker_driver', machine_file=machine_file, **SLOW)
    graph.wait(lambda: graph.state() and graph.state().samples > 50, 'samples')
    assert graph.trigger('tracker/stop').success
    graph.wait(lambda: 'the stream has ended' in graph.state().message, 'the end in the state')
    assert not [s for s in graph.heard['calibrator/state'] if 'run goes on' in s.message]
    answer = graph.trigger('tracker/start')
    assert answer.success and answer.message == 'IDLE: activated; the stream is about to begin'
