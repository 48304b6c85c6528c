# SPDX-License-Identifier: Apache-2.0
"""The driver streams when it is activated, not before."""

from geometry_msgs.msg import PointStamped

from otf_core.config import PlannerConfig
from otf_core.model.machine import machine_from_dict
from otf_core.planning.path_creation import plan_path
from otf_msgs.msg import Plan, TrackerStatus
from otf_ros import convert, qos
from otf_ros.testing import node_on_bench
from otf_tracker_driver.node import TrackerDriver

MACHINE = {
    'name': 'small',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        name: {'min': low, 'max': low + 0.3, 'table_pitch': 0.1}
        for name, low in {'X': 0.0, 'Y': 0.0, 'Z': -0.3}.items()
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}


WAITING = {'auto_start': False, 'wait_for_subscribers': 0}


def test_samples_come_once_the_driver_is_active(tmp_path):
    file = tmp_path / 'machine.yaml'
    file.write_text(str(MACHINE).replace("'", '"'))
    with node_on_bench(TrackerDriver, machine_file=file, **WAITING) as bench:
        plan = plan_path(machine_from_dict(MACHINE), PlannerConfig(passes=1))
        now = bench.ear.get_clock().now().to_msg()
        bench.ear.create_publisher(Plan, 'planner/plan', qos.PATH).publish(
            convert.plan_to_message(plan, 'small', 1.0, 1.0, now)
        )
        points = bench.heard(PointStamped, 'tracker/point', qos.MEASUREMENT)
        said = bench.heard(TrackerStatus, 'tracker/status', qos.STATUS)
        bench.wait(lambda: said, 'the first status')
        assert bench.node.lifecycle_state == 'unconfigured' and not points
        bench.node.trigger_configure()
        bench.node.trigger_activate()
        bench.wait(lambda: len(points) > 50, 'samples')
        assert {p.header.frame_id for p in points} == {'tracker'}
        bench.node.trigger_deactivate()
        assert bench.node.lifecycle_state == 'inactive'
