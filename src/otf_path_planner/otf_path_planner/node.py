# SPDX-License-Identifier: Apache-2.0
"""Path planner node: publishes the nominal path and the plan, latched; plans anew on request."""

from __future__ import annotations

from collections.abc import Collection

from nav_msgs.msg import Path
from rclpy.node import Node

from otf_core.config import PlannerConfig
from otf_core.errors import OtfError
from otf_msgs.msg import Plan
from otf_path_planner.params import PlannerFiles
from otf_path_planner.planning import make_plan
from otf_ros import app, convert, qos, services
from otf_ros.params import NodeParameters


class PathPlanner(Node):
    """Publishes ``planner/path`` and ``planner/plan``; service ``planner/replan``.

    Raises
    ------
    OtfError
        If parameters or files are wrong at start. Later the service says so, and the plan that
        was published last stays.
    """

    def __init__(self) -> None:
        super().__init__('path_planner')
        self._settings = NodeParameters(self, PlannerFiles, PlannerConfig)
        self._settings.tell_when(_when)
        self._path_publisher = self.create_publisher(Path, 'planner/path', qos.PATH)
        self._plan_publisher = self.create_publisher(Plan, 'planner/plan', qos.PATH)
        self.get_logger().info(self._plan())
        services.offer(self, 'planner/replan', self._replan)

    def _plan(self) -> str:
        """Plan with the present parameters, publish, and say what was planned."""
        config = self._settings.read(PlannerConfig)
        machine, plan, passes = make_plan(self._settings.read(PlannerFiles), config)
        now = self.get_clock().now().to_msg()
        self._path_publisher.publish(convert.path_to_message(plan.path, now))
        self._plan_publisher.publish(convert.plan_to_message(plan, machine.name, passes, now))
        return (
            f'planned for {machine.name}: {len(plan.path.points)} points, '
            f'{plan.path.length:.2f} m, {plan.duration:.0f} s without acceleration'
        )

    def _replan(self) -> tuple[bool, str]:
        try:
            return True, self._plan()
        except OtfError as error:
            return False, f'{error}; the plan published before stays'


def _when(names: Collection[str]) -> str:
    """State when parameters count that are set now."""
    return 'counts when planner/replan is called' if set(names) - {'use_sim_time'} else ''


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return app.run(PathPlanner, args)


if __name__ == '__main__':
    raise SystemExit(main())
