# SPDX-License-Identifier: Apache-2.0
"""Nothing foreign ends a run: stray paths, a second planner and a second publisher of samples."""

from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage

from otf_core.bags.bag import read_bag
from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_ros import convert, qos

CELL = Path(__file__).parents[1] / 'bags' / 'y-carries-the-table'
LATE_NS = 49 * 10**9


class Publishers:
    """Publishes a path and samples as one node."""

    def __init__(self, graph, name):
        self._graph = graph
        self.node = rclpy.create_node(name, context=graph.ear().context)
        self._path = self.node.create_publisher(PathMessage, 'planner/path', qos.PATH)
        self._point = None

    def path(self, points):
        now = self.node.get_clock().now().to_msg()
        self._path.publish(convert.path_to_message(NominalPath(points), now))

    def samples(self, samples):
        if self._point is None:
            self._point = self.node.create_publisher(
                PointStamped, 'tracker/point', qos.MEASUREMENT
            )
            self._graph.wait(self._point.get_subscription_count, 'the calibrator')
        for message in convert.points_to_messages(samples):
            self._point.publish(message)


def test_stray_paths_and_a_second_publisher_cost_nothing(graph, tmp_path):
    whole = read_bag(CELL / 'bag')
    points = whole.path.points
    samples = Samples(whole.samples.stamp_ns[::4], whole.samples.xyz[::4])
    count = len(samples)
    given = {'machine_file': CELL / 'machine.yaml', 'output_directory': tmp_path / 'out'}
    calibrator = graph.start('calibrator', **given, idle_timeout=3.0)
    own, stray = Publishers(graph, 'own_planner'), Publishers(graph, 'stray_planner')

    def heard(*parts):
        graph.wait(lambda: all(part in calibrator.log.read_text() for part in parts), parts)

    own.path(points)
    graph.wait_for_state('BUFFERING')

    def both_named():  # from when both nodes are discovered, which may come after publishers
        stray.path(1000 * points)
        return 'planner/path of own_planner or stray_planner ignored' in calibrator.log.read_text()

    graph.wait(both_named, 'both names')
    heard('the path seems to be in mm')
    stray.path(points * [1.0, 1.3, 1.0])
    heard('leaves the range of axis Y by')
    part = count // 2
    own.samples(samples.part(0, part))
    graph.wait(lambda: graph.state().samples == part, 'the first half')
    stray.path(points * [0.9, 0.8, 0.7])
    heard('another path, of', 'was published in mid-run by own_planner or stray_planner')
    heard('it is kept for the next run')
    stray.path(points)  # a planner that was started again
    foreign = samples.part(0, 2000)
    foreign = Samples(foreign.stamp_ns - LATE_NS, foreign.xyz)
    for at in range(0, 2000, 200):
        stray.samples(foreign.part(at, at + 200))
        own.samples(samples.part(part + at, part + at + 200))
        graph.wait(lambda n=part + at + 200: graph.state().samples == n, 'its samples')
    own.samples(samples.part(part + 2000, count))
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    used = result.samples  # until the target stood at the end
    assert count - 200 < used <= count and result.samples_lost == 0
    warnings = ' '.join(result.warnings)
    assert '2000 samples of a second publisher on /tracker/point, stray_planner, are' in warnings
    assert 'was published in mid-run by' in warnings
    (journal,) = (p for p in (tmp_path / 'out' / 'journal').iterdir() if p.is_dir())
    recorded = read_bag(journal)
    assert recorded.samples.xyz.tobytes() == samples.xyz[:used].tobytes()
    assert np.array_equal(recorded.path.points, points)
    own.node.destroy_node()
    stray.node.destroy_node()
