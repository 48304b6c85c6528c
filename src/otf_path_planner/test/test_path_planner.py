# SPDX-License-Identifier: Apache-2.0
"""The planner publishes a path that its machine can drive, and plans anew on request."""

from pathlib import Path

import pytest
import yaml
from nav_msgs.msg import Path as PathMessage
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from otf_core.contradictions.recording_checks import check_path
from otf_core.errors import ConfigError
from otf_core.model.machine import load_machine
from otf_path_planner.node import PathPlanner
from otf_ros import convert, qos
from otf_ros.testing import SMALL_MACHINE, node_on_bench


@pytest.fixture
def machine_file(tmp_path) -> Path:
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(SMALL_MACHINE))
    return file


def test_path_fits_the_machine_and_another_feed_takes_effect_at_replan(machine_file):
    with node_on_bench(PathPlanner, machine_file=machine_file, passes=1) as bench:
        paths = bench.heard(PathMessage, 'planner/path', qos.PATH)
        bench.wait(lambda: paths, 'the path')
        check_path(convert.path_from_message(paths[0]), load_machine(machine_file))
        said = bench.node.set_parameters_atomically([Parameter('passes', value=2)])
        assert said.reason == 'counts when planner/replan is called' and len(paths) == 1
        assert bench.call(Trigger, 'planner/replan').success
        bench.wait(lambda: len(paths) == 2, 'the new path')
        assert len(paths[1].poses) > len(paths[0].poses)


def test_planner_without_a_machine_says_what_is_missing():
    with (
        pytest.raises(ConfigError, match='machine_file: missing'),
        node_on_bench(PathPlanner),
    ):
        pass
