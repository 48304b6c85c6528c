# SPDX-License-Identifier: Apache-2.0
"""The calibrator takes a path that fits its machine, refuses others and states what it has."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage
from std_srvs.srv import Trigger

from otf_calibrator.node import Calibrator
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_msgs.msg import CalibratorState
from otf_ros import convert, qos
from otf_ros.testing import SMALL_MACHINE, node_on_bench


@pytest.fixture
def machine_file(tmp_path) -> Path:
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(SMALL_MACHINE))
    return file


CORNERS = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.3, 0.0]])


def test_path_in_millimetres_is_refused_and_samples_are_kept(machine_file, tmp_path):
    given = {'machine_file': machine_file, 'output_directory': tmp_path / 'out'}
    with node_on_bench(Calibrator, **given) as bench:
        states = bench.heard(CalibratorState, 'calibrator/state', qos.STATUS)
        path = bench.ear.create_publisher(PathMessage, 'planner/path', qos.PATH)
        point = bench.ear.create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)
        bench.wait(lambda: states and states[-1].name == 'WAITING_FOR_PATH', 'the first state')
        assert not bench.call(Trigger, 'calibrator/calibrate').success
        now = bench.ear.get_clock().now().to_msg()
        path.publish(convert.path_to_message(NominalPath(1000.0 * CORNERS), now))
        path.publish(convert.path_to_message(NominalPath(CORNERS), now))
        bench.wait(lambda: states[-1].path_length == pytest.approx(0.6), 'the path')
        samples = Samples(np.arange(1, 201) * 10**6, np.full((200, 3), 0.5))
        for message in convert.points_to_messages(samples):
            point.publish(message)
        bench.wait(lambda: states[-1].samples == 200, 'the samples')
        assert bench.call(Trigger, 'calibrator/reset').success
        bench.wait(lambda: states[-1].samples == 0, 'the reset')
