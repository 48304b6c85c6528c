# SPDX-License-Identifier: Apache-2.0
"""Machines with rotary axes in the graph: several parts, broken beam, and who looks on."""

from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import serialize_message
from visualization_msgs.msg import MarkerArray

from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import decode_axes
from otf_core.model.observation import Samples
from otf_msgs.msg import TrackerGap
from otf_ros import convert, qos

CELL = Path(__file__).parents[1] / 'bags' / 'trunnion'
TARGETS = ['tool', 'long', 'nest-1', 'nest-2', 'nest-3']


def stood(samples, count):
    """Samples, and so many more of a target that stands at the end."""
    step = round(samples.step_ns)
    stamps = samples.stamp_ns[-1] + step * np.arange(1, count + 1)
    noise = np.random.default_rng(8).normal(scale=1e-6, size=(count, 3))
    return Samples(
        np.concatenate([samples.stamp_ns, stamps]),
        np.concatenate([samples.xyz, samples.xyz[-1] + noise]),
    )


def test_trajectory_of_a_node_is_read_as_it_is_recorded():
    for part in read_bag(CELL / 'bag').axis_paths:
        data = serialize_message(convert.axes_to_message(part, Time()))
        frame, names, positions = decode_axes(data)
        assert (frame, names) == (part.target, part.axes)
        assert np.array_equal(positions, part.positions)


def test_simulated_cell_with_a_move_by_hand_is_driven_and_shown(graph, tmp_path):
    machine = {'machine_file': CELL / 'machine.yaml'}
    path = tmp_path / 'path.csv'
    lines = ['target,x,y,z,a,c']
    for part in read_bag(CELL / 'bag').axis_paths:
        if part.target in ('tool', 'nest-1'):
            lines += [','.join([part.target, *map(str, q)]) for q in part.positions.tolist()]
    path.write_text('\n'.join(lines))
    graph.start('viewer')
    page = graph.start('page', port=0)
    gaps = graph.listen(TrackerGap, 'tracker/gap', qos.EVENTS)
    early = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
    tracks = graph.listen(PathMessage, 'calibrator/track', qos.PATH)
    live = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
    graph.start('path_planner', **machine, path_file=path)
    asked = {'finish_at_stream_end': False, 'finish_at_standstill': False, 'idle_timeout': 0.0}
    graph.start('calibrator', **machine, **asked)
    simulated = {'simulated.rate': 100.0, 'time_scale': 50.0}
    driver = graph.start('tracker_driver', **machine, **simulated)
    graph.wait_for_status('FINISHED')
    said = driver.log.read_text(encoding='utf-8')
    assert "BEAM_BROKEN: the reflector is moved by hand to the target 'nest-1'" in said
    graph.wait(lambda: gaps, 'the gap')
    assert gaps[0].reason == "the reflector is moved by hand to the target 'nest-1'"
    graph.wait(lambda: (graph.state().part, graph.state().target) == (2, 'nest-1'), 'its state')
    graph.wait(lambda: early, 'the place of the tracker')

    def of_all_parts() -> list:  # the first of them may be of the part that arrived first
        return [t for t in tracks if len(t.poses) == len(tracks[-1].poses) > 1200]

    graph.wait(lambda: len(of_all_parts()) >= 2, 'the track with the places that were found')
    graph.wait(lambda: live and any(m.ns == 'tracker' for m in live[-1].markers), 'the picture')
    assert 'live view at' in page.last_lines()
