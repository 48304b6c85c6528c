# SPDX-License-Identifier: Apache-2.0
"""Viewer node: markers for RViz and Foxglove, the distance from the path for plots."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Float64
from visualization_msgs.msg import MarkerArray

from otf_core.live.layers import moving, scene
from otf_ros import qos
from otf_ros.params import NodeParameters
from otf_ros.timers import create_timer
from otf_view.listening import LiveRunListener
from otf_view.markers import to_markers
from otf_view.params import ViewerConfig

PERIOD = 0.5
"""s between pictures."""


class Viewer(Node):
    """Publishes ``view/scene`` when something in it changes, the rest twice per second."""

    def __init__(self) -> None:
        super().__init__('viewer')
        self._settings = NodeParameters(self, ViewerConfig)
        self._scene = self.create_publisher(MarkerArray, 'view/scene', qos.PICTURE)
        self._live = self.create_publisher(MarkerArray, 'view/live', qos.PICTURE)
        self._distance = self.create_publisher(Float64, 'view/distance_from_path', qos.SCALAR)
        self._ears = LiveRunListener(self)
        self._drawn = 0
        create_timer(self, PERIOD, self._publish)

    def _publish(self) -> None:
        run = self._ears.run
        if math.isfinite(run.track.distance):
            self._distance.publish(Float64(data=float(run.track.distance)))
        if run.path is None:
            return
        if self._drawn != self._ears.news:
            self._drawn = self._ears.news
            self._scene.publish(to_markers(scene(run.path, run.volume), Time()))
        scale = self._settings.read(ViewerConfig).scale
        layers = moving(run.path, run.progress.travelled, run.track, run.pose, scale)
        self._live.publish(to_markers(layers, Time()))
