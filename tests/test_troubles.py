# SPDX-License-Identifier: Apache-2.0
"""What is wrong with graph or stream is said in the state while it is wrong, and logged."""

import numpy as np
from cells import write_machine
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.qos import qos_profile_sensor_data

from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_msgs.msg import TrackerStatus
from otf_ros import convert, qos


def test_foreign_frames_second_publishers_and_quality_of_service_are_said(graph, tmp_path):
    given = {'machine_file': write_machine(tmp_path), 'output_directory': tmp_path / 'out'}
    node = graph.start('calibrator', **given)
    ear = graph.ear()

    def said(*parts):
        graph.wait(
            lambda: graph.state() and all(part in graph.state().message for part in parts), parts
        )

    best_effort = ear.create_publisher(PointStamped, 'tracker/point', qos_profile_sensor_data)
    said('nothing comes from test_ear on tracker/point', 'quality of service does not fit')
    reliable = ear.create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)
    volatile = ear.create_publisher(Path, 'planner/path', 10)
    said('2 publishers on tracker/point', 'nothing comes from test_ear on planner/path')
    ear.destroy_publisher(best_effort)
    ear.destroy_publisher(volatile)
    graph.wait(lambda: reliable.get_subscription_count() == 1, 'the calibrator')
    samples = Samples(np.arange(10) * 10**6, np.full((10, 3), 0.5))
    for message in convert.points_to_messages(samples):
        message.header.frame_id = 'lab'
        reliable.publish(message)
    said('dropped 10 of 10 points in another frame', "frame_id is 'lab', expected 'tracker'")
    graph.wait(lambda: 'quality of service' not in graph.state().message, 'the end of trouble')
    assert graph.state().samples == 0
    log = node.log.read_text()
    for part in ('quality of service does not fit', '2 publishers on', "frame_id is 'lab'"):
        assert part in log


def test_samples_on_their_way_are_not_told_as_lost(graph, machine_file):
    graph.start('calibrator', machine_file=machine_file)
    points = graph.ear().create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)
    status = graph.ear().create_publisher(TrackerStatus, 'tracker/status', qos.STATUS)
    found = graph.listen(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
    graph.wait(lambda: points.get_subscription_count(), 'the calibrator')
    announced = {'stream_id': 'one', 'samples_published': 30}
    status.publish(TrackerStatus(state=TrackerStatus.STREAMING, **announced))
    samples = Samples(np.arange(10) * 10**6, np.full((10, 3), 0.5))
    for message in convert.points_to_messages(samples):
        points.publish(message)

    def losses():
        told = [s for s in found[-1].status if s.name.endswith('losses')] if found else []
        return {v.key: v.value for s in told for v in s.values}

    graph.wait(lambda: graph.state() and graph.state().samples == 10, 'the samples')
    graph.wait(lambda: losses() == {'lost': '0'}, 'nothing')
    assert {state.samples_lost for state in graph.heard['calibrator/state']} == {0}
    status.publish(TrackerStatus(state=TrackerStatus.FINISHED, **announced))
    graph.wait(lambda: graph.state().samples_lost == 20, 'the loss')
    graph.wait(lambda: losses() == {'lost': '20'}, 'the same')


def test_stream_of_which_nothing_has_arrived_is_said(graph, machine_file):
    graph.start('calibrator', machine_file=machine_file)
    path = graph.ear().create_publisher(Path, 'planner/path', qos.PATH)
    corners = NominalPath([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.1, 0.0]])
    path.publish(convert.path_to_message(corners, graph.ear().get_clock().now().to_msg()))
    assert 'activate the tracker driver' in graph.wait_for_state('BUFFERING').message
    status = graph.ear().create_publisher(TrackerStatus, 'tracker/status', qos.STATUS)
    announced = {'stream_id': 'one', 'samples_published': 36670}
    status.publish(TrackerStatus(state=TrackerStatus.FINISHED, **announced))
    graph.wait(lambda: graph.state().samples_lost == 36670, 'the loss')
    assert 'none of the 36670 samples that it published has arrived' in graph.state().message
