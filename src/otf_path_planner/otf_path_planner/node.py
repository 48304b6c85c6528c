# SPDX-License-Identifier: Apache-2.0
"""Path planner node: publishes the nominal path and the plan, latched; plans anew on request.

A machine with rotary axes or several targets has a trajectory of axis positions for every part
instead of a path.
"""

from __future__ import annotations

from collections.abc import Collection

from nav_msgs.msg import Path
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from otf_core.config import ForecastConfig, PlannerConfig
from otf_core.errors import OtfError
from otf_msgs.msg import Plan
from otf_path_planner.params import PlannerFiles
from otf_path_planner.planning import check_files, make_plan, read_machine
from otf_ros import convert, qos, services
from otf_ros.params import NodeParameters


class PathPlanner(Node):
    """Publishes ``planner/path`` or ``planner/axes``, and ``planner/plan``; ``planner/replan``.

    Raises
    ------
    OtfError
        If parameters or files are wrong at start. Later the service says so, and the plan that
        was published last stays.
    """

    def __init__(self) -> None:
        super().__init__('path_planner')
        self._settings = NodeParameters(self, PlannerFiles, PlannerConfig)
        self._settings.check_also(PlannerFiles, check_files)
        self._settings.tell_when(_when)
        self._path_publisher = self.create_publisher(Path, 'planner/path', qos.PATH)
        self._axes_publisher = self.create_publisher(JointTrajectory, 'planner/axes', qos.PARTS)
        self._plan_publisher = self.create_publisher(Plan, 'planner/plan', qos.PATH)
        self.get_logger().info(self._plan())
        services.offer(self, 'planner/replan', self._replan)

    def _plan(self) -> str:
        """Plan with the present parameters, publish, and say what was planned."""
        files, config = self._settings.read(PlannerFiles), self._settings.read(PlannerConfig)
        machine = read_machine(files)
        plan, track = make_plan(machine, files, config)
        now = convert.now(self)
        if plan.is_plain:
            self._path_publisher.publish(convert.path_to_message(plan.path, now))
        for part in () if plan.is_plain else plan.parts:
            self._axes_publisher.publish(convert.axes_to_message(part.path, now))
        duration = plan.duration(machine, ForecastConfig.acceleration)
        self._plan_publisher.publish(
            convert.plan_to_message(plan, machine.name, track.length, duration, now)
        )
        corners = sum(len(part.path.positions) for part in plan.parts)
        targets = ', '.join(part.target for part in plan.parts)
        return (
            f'planned for {machine.name}: {corners} points in {len(plan.parts)} part(s) '
            f'({targets}), {track.length:.2f} m, {duration:.0f} s without moves by hand'
        )

    def _replan(self) -> tuple[bool, str]:
        try:
            return True, self._plan()
        except OtfError as error:
            return False, f'{error}; the plan published before stays'


def _when(names: Collection[str]) -> str:
    """State when parameters count that are set now."""
    return 'counts when planner/replan is called' if set(names) - {'use_sim_time'} else ''
