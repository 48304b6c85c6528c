# SPDX-License-Identifier: Apache-2.0
"""Services of planner and calibrator; what fails says so, and the node lives on."""

import re

import numpy as np
from cells import FAST, SHORT, write_machine
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path

from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_msgs.msg import Plan
from otf_ros import convert, qos


def test_replan_publishes_a_new_path_with_new_parameters_machine_and_path_file(
    graph, machine_file
):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    paths = graph.listen(Path, 'planner/path', qos.PATH)
    plans = graph.listen(Plan, 'planner/plan', qos.PATH)
    graph.wait(lambda: paths and plans, 'path and plan')
    assert graph.set_parameter('path_planner', 'feed', 1).successful
    write_machine(graph.folder, name='another')
    answer = graph.trigger('planner/replan')
    assert answer.success and 'another' in answer.message and 'points' in answer.message
    graph.wait(lambda: len(paths) == 2 and len(plans) == 2, 'new path and plan')
    assert plans[1].machine == 'another'
    assert set(plans[1].feed) == {1.0} != set(plans[0].feed)
    assert len(plans[1].parts[0].points) == len(paths[1].poses)

    points = [(0.0, 0.0, 0.0), (0.3, 0.1, -0.2), (0.0, 0.15, -0.1)]
    text = 'x,y,z\n' + '\n'.join(','.join(map(str, p)) for p in points)
    file = graph.folder / 'path.csv'
    file.write_text(text)
    assert graph.set_parameter('path_planner', 'path_file', str(file)).successful
    assert graph.trigger('planner/replan').success
    graph.wait(lambda: len(paths) == 3, 'path of the file')
    assert convert.path_from_message(paths[2]).points.tolist() == [list(p) for p in points]

    machine_file.write_text('name: broken\n')
    answer = graph.trigger('planner/replan')
    assert not answer.success and 'machine.yaml' in answer.message
    assert graph.trigger('planner/replan').message == answer.message


def publish_samples(graph, samples):
    """Publish samples as a driver without any status would."""
    publisher = graph.ear().create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)
    graph.wait(lambda: publisher.get_subscription_count() > 0, 'the calibrator')
    for message in convert.points_to_messages(samples):
        publisher.publish(message)
    graph.wait(lambda: graph.state().samples == len(samples), 'all samples')


def test_broken_path_and_failed_calibration_leave_the_node_alive(graph, machine_file):
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out'}
    node = graph.start('calibrator', **given, save_bag=False, idle_timeout=0.0)
    publisher = graph.ear().create_publisher(Path, 'planner/path', qos.PATH)
    graph.wait_for_state('WAITING_FOR_PATH')

    def sender_named():  # from when its node is discovered, which may come after the publisher
        publisher.publish(Path())
        return 'planner/path of test_ear ignored' in node.log.read_text()

    graph.wait(sender_named, 'the complaint')
    senders = set(re.findall('planner/path of (.*) ignored', node.log.read_text()))
    assert senders <= {'test_ear', 'an unknown node'}
    assert graph.state().name == 'WAITING_FOR_PATH'
    now = graph.ear().get_clock().now().to_msg()
    square = NominalPath(np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.15, 0], [0, 0, 0.0]]))
    publisher.publish(convert.path_to_message(square, now))
    graph.wait_for_state('BUFFERING')
    still = Samples(np.arange(500) * 2_000_000, np.ones((500, 3)))
    publish_samples(graph, still)
    assert graph.trigger('calibrator/calibrate').success
    result, state = graph.wait_for_result()
    assert state.name == 'FAILED' and 'hardly moved' in state.message
    assert result.status == result.INPUT_UNUSABLE and not result.run_id
    answer = graph.trigger('calibrator/reset')
    assert answer.success and '500' in answer.message
    graph.wait_for_state('BUFFERING')
    graph.ear().destroy_publisher(publisher)

    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('tracker_driver', machine_file=machine_file, **FAST)
    result, _ = graph.wait_for_result(2)
    assert result.status == result.OK, result.message
