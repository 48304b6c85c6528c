# SPDX-License-Identifier: Apache-2.0
"""Machines with rotary axes in the graph: several parts, broken beam, and who looks on."""

import json
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from cells import share_left
from geometry_msgs.msg import PointStamped, TransformStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import decode_axes
from otf_core.inputs.recordings import read_recording
from otf_core.model.observation import Samples
from otf_core.model.provenance import origin_of
from otf_msgs.msg import ErrorTables, TrackerGap
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


def test_run_ends_at_standstill_after_the_last_part_with_all_that_it_finds(graph, tmp_path):
    whole = read_bag(CELL / 'bag')
    samples, half = stood(whole.samples, 80), 2000
    ear = graph.ear()
    axes = ear.create_publisher(JointTrajectory, 'planner/axes', qos.PARTS)
    for part in whole.axis_paths:  # each with a stamp of its own, as other planners may
        axes.publish(convert.axes_to_message(part, ear.get_clock().now().to_msg()))
    points = ear.create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)

    def publish(these):
        for message in convert.points_to_messages(these):
            points.publish(message)

    tables = graph.listen(ErrorTables, 'calibrator/error_tables', qos.RESULT)
    given = {'machine_file': CELL / 'machine.yaml', 'output_directory': tmp_path / 'out'}
    graph.start('calibrator', **given)
    graph.wait(lambda: graph.state() and graph.state().parts == 5, 'the parts')
    graph.wait(points.get_subscription_count, 'the calibrator')
    publish(samples.part(0, half))
    graph.wait(lambda: graph.state().samples == half, 'its samples')
    assert (graph.state().part, graph.state().target) == (1, 'tool')
    publish(samples.part(half, len(samples)))
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    assert (state.parts, result.not_identifiable) == (5, ['ECX', 'ECZ'])
    assert all('spindle axis' in need for need in result.needs)
    folder = Path(result.output_directory)
    graph.wait((folder / 'samples').exists, 'the bag of the samples')
    (journal,) = (p for p in (tmp_path / 'out' / 'journal').iterdir() if p.is_dir())
    assert read_bag(journal).samples.xyz.tobytes() == samples.xyz[: result.samples].tobytes()
    assert len(whole.samples) - 5 < result.samples < len(samples)
    live = (folder / 'error_tables.json').read_bytes()
    (used,) = json.loads(live)['provenance']['runs']  # equal input gives equal tables
    content = read_recording([journal], CELL / 'machine.yaml')
    assert used['sha256'] == origin_of('', content.samples, content.path).sha256
    assert [p.target for p in read_bag(folder / 'samples').axis_paths] == TARGETS

    graph.wait(lambda: tables, 'all tables in one message')
    told, written = tables[-1], json.loads(live)
    assert [table.motion for table in told.tables] == list(written['motions'])
    units = {table.axis: table.position_unit for table in told.tables}
    assert units == {'X': 'm', 'Y': 'm', 'Z': 'm', 'A': 'rad', 'C': 'rad'}
    for k, name in enumerate(told.location):
        one = written['location'][name]
        assert told.location_value[k] == one['value'] == result.location_value[k]
        assert (told.location_u[k], told.location_identifiable[k]) == (one['u'], True)
    assert len(told.location) == 8 and told.tracker_link == 'b'
    for target in told.targets:
        place = written['targets'][target.name]['place']
        assert [target.place.x, target.place.y, target.place.z] == place
        assert target.link == written['machine']['targets'].get(target.name, {'link': 't'})['link']
    assert share_left(folder / 'error_tables.json', CELL / 'truth.json') < 0.1


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
