# SPDX-License-Identifier: Apache-2.0
"""What is wrong with graph or stream is said in the state while it is wrong, and logged."""

import numpy as np
from cells import write_machine
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.qos import qos_profile_sensor_data

from otf_core.model.observation import Samples
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
