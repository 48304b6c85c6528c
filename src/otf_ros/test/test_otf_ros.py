# SPDX-License-Identifier: Apache-2.0
"""Conversions are exact; parameters say when they act; publishers have their node's name."""

from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.topic_endpoint_info import TopicEndpointInfo

from otf_core.config import Parameters, parameter
from otf_core.model.path import NominalPath
from otf_ros import convert, qos
from otf_ros.convert_gap import gap_to_message
from otf_ros.drain import AT_ONCE, Drain
from otf_ros.params import NodeParameters
from otf_ros.testing import node_on_bench
from otf_ros.topic_watch import name_of


@dataclass(frozen=True)
class Speed(Parameters):
    feed: float = parameter(0.25, 'feed', 'm/s', 0.0, 5.0)
    passes: int = parameter(2, 'laps', '', 1, 20)


class Mover(Node):
    def __init__(self):
        super().__init__('mover')
        self.settings = NodeParameters(self, Speed)
        self.settings.tell_when(lambda names: 'counts later' if 'feed' in names else '')


def changed(node, name, value) -> SetParametersResult:
    return node.set_parameters_atomically([Parameter(name, value=value)])


def test_stamps_and_paths_come_back_as_they_were():
    stamp_ns = 1_795_611_511_123_456_789
    assert convert.ns_from_time(convert.time_from_ns(stamp_ns)) == stamp_ns
    path = NominalPath(np.random.default_rng(1).uniform(0.0, 0.5, (20, 3)))
    message = convert.path_to_message(path, Time(sec=1))
    assert message.header.frame_id == 'machine'
    np.testing.assert_array_equal(convert.path_from_message(message).points, path.points)


def test_parameter_that_acts_later_says_when_and_others_say_nothing():
    with node_on_bench(Mover, feed=0.5) as bench:
        node = bench.node
        assert node.settings.read(Speed) == Speed(0.5, 2)
        later = changed(node, 'feed', 1)
        assert (later.successful, later.reason) == (True, 'counts later')
        assert changed(node, 'passes', 3).reason == ''
        refused = changed(node, 'feed', 9.0)
        assert not refused.successful and 'feed' in refused.reason
        assert node.settings.read(Speed) == Speed(1.0, 3)


class Reader(Node):
    def __init__(self):
        super().__init__('reader')
        self.taken = []
        self.drain = Drain(
            self,
            PointStamped,
            'point',
            lambda new, _: self.taken.append(len(new)),
            qos.MEASUREMENT,
        )


def test_messages_that_pile_up_are_taken_in_turns_or_all_at_once():
    with node_on_bench(Reader) as bench:
        node, point = (
            bench.node,
            bench.ear.create_publisher(PointStamped, 'point', qos.MEASUREMENT),
        )
        bench.wait(point.get_subscription_count, 'the reader')
        for _ in range(2 * AT_ONCE + 500):
            point.publish(PointStamped())
        node.drain.take_turn()
        node.drain.empty()
        assert node.taken == [AT_ONCE, AT_ONCE + 500]


def test_publisher_whose_node_is_not_discovered_has_no_name_of_the_middleware():
    unknown = {'node_name': '_NODE_NAME_UNKNOWN_', 'node_namespace': '_NODE_NAMESPACE_UNKNOWN_'}
    assert name_of(TopicEndpointInfo(**unknown)) == 'an unknown node'
    assert name_of(TopicEndpointInfo(node_name='planner', node_namespace='/')) == 'planner'


def test_place_of_a_gap_on_a_machine_with_rotary_axes_has_the_positions_of_its_linear_axes():
    row = {'kind': 'path piece', 'label': 'leg 0', 'rms_um': 8.0, 'expected_um': 0.5, 'legs': 1}
    row |= {'significance': 67.0, 'pieces': 52, 'leg': 0, 'time': [0.3, 1.75]}
    row |= {'from': [0.1, 0.2, 0.3, 0.4, 0.5], 'to': [0.2] * 5, 'mean_um': [-4.7, 5.9, 0.0]}
    data = dict.fromkeys(('sentence', 'verdict'), 'none')
    data |= {name: [] for name in ('runs', 'causes', 'not_visible', 'considered')}
    data['gap'] = dict.fromkeys(
        ('measured_um', 'simulated_um', 'before_um', 'after_um', 'shrink_percent'), 0.0
    ) | {'shrink_interval_percent': [0.0, 0.0]}
    data |= {'unexplained': {'rms_um': 0.0, 'where': ''}, 'smallest_found_um': {}}
    data |= {'table_change_um': 0.0, 'where': {'summary': '', 'by_path_piece': [row]}}
    (place,) = gap_to_message(data, Time()).places
    assert (place.start.x, place.start.y, place.start.z) == (0.1, 0.2, 0.3)
