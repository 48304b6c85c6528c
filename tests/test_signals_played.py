# SPDX-License-Identifier: Apache-2.0
"""Signals of the machine as they arrive beside the samples."""

import numpy as np
from cells import write_machine
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from otf_calibrator.inputs import listen
from otf_calibrator.params import CalibratorConfig
from otf_calibrator.session import Session
from otf_core.config import CalibrationConfig
from otf_core.model.observation import Samples
from otf_ros import convert, qos

START, STEP = 1_600_000_000_000_000_000, 1_000_000_000
"""ns, years ago."""


def test_value_without_a_stamp_has_the_time_of_a_bag_that_is_played(graph, tmp_path):
    signals = {'/spindle': {'unit': 'K', 'type': 'std_msgs/msg/Float64'}}
    files = CalibratorConfig(
        machine_file=str(write_machine(tmp_path, signals=signals)), journal_directory='none'
    )
    node = graph.ear()
    node.set_parameters([Parameter('use_sim_time', value=True)])
    intake = Session(lambda: (files, CalibrationConfig()), print).intake
    listen(node, intake, files)
    clock = node.create_publisher(Clock, '/clock', qos.STATUS)
    spindle = node.create_publisher(Float64, '/spindle', 10)
    graph.wait(lambda: spindle.get_subscription_count(), 'the subscription')
    taken, take = [], intake.signals.add
    intake.signals.add = lambda *value: (take(*value), taken.append(value))
    stamps = [START + k * STEP for k in range(20)]
    for k, stamp in enumerate(stamps):
        clock.publish(Clock(clock=convert.time_from_ns(stamp)))
        graph.wait(lambda at=stamp: node.get_clock().now().nanoseconds == at, 'the clock')
        spindle.publish(Float64(data=20.0 + k))
        graph.wait(lambda count=k: len(taken) > count, 'the value')
    (found,) = intake.signals.of(Samples(np.array(stamps), np.zeros((20, 3)))).values()
    assert found.stamp_ns.tolist() == stamps and found.value.tolist() == list(range(20, 40))
