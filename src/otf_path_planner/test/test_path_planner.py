# SPDX-License-Identifier: Apache-2.0
"""The planner publishes a path that its machine can drive, and plans anew on request."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from nav_msgs.msg import Path as PathMessage
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from otf_core.config import PlannerConfig
from otf_core.contradictions.recording_checks import check_path
from otf_core.errors import ConfigError
from otf_core.model.machine import load_machine
from otf_core.planning.forecast import Setup
from otf_core.planning.part_choice import planned
from otf_msgs.msg import Plan
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
        said = bench.node.set_parameters_atomically([Parameter('machine_file', value='/none')])
        assert not said.successful and '/none' in said.reason


def test_parts_of_a_machine_with_rotary_axes_are_published_one_by_one_with_one_stamp(tmp_path):
    turning = {'kind': 'rotary', 'min': 0.0, 'max': 6.0, 'table_pitch': 0.5}
    axes = {**SMALL_MACHINE['axes'], 'C': {**turning, 'direction': [0, 0, 1], 'centre': [0, 0, 0]}}
    nest = {'nest': {'link': 'w', 'place': [0.1, 0.0, 0.05], 'u': 1e-3}}
    tracker = {**SMALL_MACHINE['tracker'], 'link': 'b'}
    content = {**SMALL_MACHINE, 'chain': 'w-C-b-X-Y-Z-t', 'axes': axes, 'targets': nest}
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump({**content, 'tracker': tracker}))
    with node_on_bench(PathPlanner, machine_file=file, levels=2) as bench:
        parts = bench.heard(JointTrajectory, 'planner/axes', qos.PARTS)
        plans = bench.heard(Plan, 'planner/plan', qos.PATH)
        bench.wait(lambda: plans and len(parts) >= 3, 'the parts')
    machine = load_machine(file)
    paths = [convert.axes_from_message(part).of(machine) for part in parts]
    wanted = planned(Setup.of(machine), PlannerConfig(levels=2))
    assert [path.target for path in paths] == [part.target for part in wanted.parts]
    for path, part in zip(paths, wanted.parts, strict=True):
        assert np.array_equal(path.positions, part.path.positions)
    assert len({(p.header.stamp.sec, p.header.stamp.nanosec) for p in parts}) == 1
    plan = convert.plan_from_message(plans[0])
    for part, own in zip(plan.parts, wanted.parts, strict=True):
        assert np.array_equal(part.feed, own.feed) and np.array_equal(part.dwell, own.dwell)
    assert list(plans[0].parts) == parts


def test_planner_without_a_machine_says_what_is_missing():
    with (
        pytest.raises(ConfigError, match='machine_file: missing'),
        node_on_bench(PathPlanner),
    ):
        pass
