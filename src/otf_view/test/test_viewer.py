# SPDX-License-Identifier: Apache-2.0
"""The viewer draws a path as soon as there is one."""

import numpy as np
from nav_msgs.msg import Path
from visualization_msgs.msg import MarkerArray

from otf_core.model.path import NominalPath
from otf_ros import convert, qos
from otf_ros.testing import node_on_bench
from otf_view.viewer_node import Viewer

CORNERS = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.3, 0.0]])


def test_path_is_drawn_for_those_who_look_later():
    with node_on_bench(Viewer) as bench:
        publisher = bench.ear.create_publisher(Path, 'planner/path', qos.PATH)
        now = bench.ear.get_clock().now().to_msg()
        publisher.publish(convert.path_to_message(NominalPath(CORNERS), now))
        scenes = bench.heard(MarkerArray, 'view/scene', qos.PICTURE)
        bench.wait(lambda: scenes, 'the picture')
        points = [(p.x, p.y, p.z) for marker in scenes[0].markers for p in marker.points]
        assert {tuple(corner) for corner in CORNERS.tolist()} <= set(points)
