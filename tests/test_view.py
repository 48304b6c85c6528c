# SPDX-License-Identifier: Apache-2.0
"""What viewers see of a run, against path, result and true errors; latched for latecomers."""

import math

import numpy as np
from cells import ERROR_SIZE, write_truth
from nav_msgs.msg import Path
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker, MarkerArray

from otf_core.live.numbers import NUMBERS
from otf_msgs.msg import VolumeErrors
from otf_ros import convert, qos

SLOW = {'simulated.rate': 200.0, 'time_scale': 8.0}
"""Parameters of the driver that leave time to look."""
MOST = 10_000
"""Points of a picture: what any viewer draws without effort."""


def start_cell(graph, machine_file, tmp_path):
    """Start planner, calibrator and driver for a run of two laps."""
    truth = write_truth(tmp_path, machine_file)
    graph.start('path_planner', machine_file=machine_file, passes=2, levels=2)
    graph.start('calibrator', machine_file=machine_file, output_directory=tmp_path / 'out')
    simulated = {'simulated.truth_tables': truth, **SLOW}
    graph.start('tracker_driver', machine_file=machine_file, **simulated)


def layers(message):
    """Markers of a picture by namespace; checked as RViz and Foxglove want them."""
    first, *drawn = message.markers
    assert first.action == Marker.DELETEALL
    assert len({(m.ns, m.id) for m in drawn}) == len(drawn)
    for marker in drawn:
        assert (marker.header.frame_id, marker.action) == ('machine', Marker.ADD)
        assert marker.ns and marker.pose.orientation.w == 1.0 and 0 < marker.color.a <= 1
        scale = marker.scale
        if marker.type == Marker.TEXT_VIEW_FACING:
            assert scale.z > 0 and marker.text and not marker.points
            continue
        assert scale.x > 0 and len(marker.points) > (marker.type == Marker.LINE_STRIP)
        assert marker.type != Marker.SPHERE_LIST or scale.x == scale.y == scale.z
        assert marker.type != Marker.LINE_LIST or len(marker.points) % 2 == 0
        assert all(math.isfinite(v) for p in marker.points for v in (p.x, p.y, p.z))
    assert sum(len(marker.points) for marker in drawn) < MOST
    return {marker.ns: marker for marker in drawn}


def array(points):
    """Coordinates of points or vectors, shape (n, 3), m."""
    return np.array([(p.x, p.y, p.z) for p in points])


def legend(message):
    """Words about the errors of the grid."""
    return layers(message)['error_legend'].text


def times(marker):
    """How enlarged errors are, as a legend says it."""
    return float(marker.text.split('x ')[1].split(':')[0].replace(',', ''))


def test_markers_and_numbers_show_the_run(graph, machine_file, tmp_path):
    graph.start('viewer')
    live = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
    heard = {name: graph.listen(Float64, f'view/{name}', qos.SCALAR) for name in NUMBERS}
    paths = graph.listen(Path, 'planner/path', qos.PATH)
    volumes = graph.listen(VolumeErrors, 'calibrator/volume', qos.RESULT)
    start_cell(graph, machine_file, tmp_path)
    graph.wait(lambda: volumes, 'errors so far')
    assert volumes[0].provisional
    graph.wait(lambda: heard['distance_from_path'], 'the distance from the path')
    result, _ = graph.wait_for_result()
    assert result.samples_lost == 0
    graph.wait(lambda: not volumes[-1].provisional, 'the errors')

    # everything a viewer that starts now gets
    scenes = graph.listen(MarkerArray, 'view/scene', qos.PICTURE)
    shown = convert.transform_from_message(result.alignment)
    graph.wait(lambda: scenes and 'so far' not in legend(scenes[-1]), 'the scene')
    graph.wait(lambda: 'tracker' in layers(live[-1]), 'the tracker')
    scene, now = layers(scenes[-1]), layers(live[-1])
    corners = array([pose.pose.position for pose in paths[0].poses])
    assert np.array_equal(array(scene['path'].points), corners)
    assert np.allclose(array(now['tracker'].points), shown.translation, atol=1e-5)

    # arrows of the grid are the errors, as many times as large as the legend says
    begin, end = array(scene['errors'].points).reshape(-1, 2, 3).swapaxes(0, 1)
    assert np.allclose(begin, array(volumes[-1].points))
    factor = times(scene['error_legend'])
    assert np.allclose(end - begin, factor * array(volumes[-1].errors), rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(array(volumes[-1].u), axis=1).max() < ERROR_SIZE / 5

    # deviations are small, start on the path, and are measured: no larger than the errors
    begin, end = array(now['deviations'].points).reshape(-1, 2, 3).swapaxes(0, 1)
    assert len(begin) > 20
    lengths = np.linalg.norm(end - begin, axis=1) / times(now['deviation_legend'])
    assert ERROR_SIZE / 20 < lengths.mean() < 3 * ERROR_SIZE

    numbers = {name: [m.data for m in messages] for name, messages in heard.items()}
    assert all(numbers.values())
    assert 0 < np.median(numbers['distance_from_path']) < 3 * ERROR_SIZE
    assert max(numbers['samples']) == result.samples
    assert numbers['residual'][-1] == result.path_mae_after
    assert max(numbers['samples_lost']) < result.samples / 100
    assert 0.3 * 1600 < np.median([r for r in numbers['sample_rate'] if r]) < 3 * 1600


def test_viewer_alone_says_nothing_and_a_broken_path_does_no_harm(graph):
    node = graph.start('viewer')
    publisher = graph.ear().create_publisher(Path, 'planner/path', qos.PATH)
    live = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
    publisher.publish(Path())
    graph.wait(lambda: 'planner/path ignored' in node.last_lines(), 'the complaint')
    assert not live
