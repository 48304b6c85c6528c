# SPDX-License-Identifier: Apache-2.0
"""What viewers see of a run, against path, result and true errors; latched for latecomers."""

import json
import math
import re
import threading
import time
import urllib.request
from pathlib import Path as FilePath

import numpy as np
import policies
from action_msgs.msg import GoalStatus
from caller import Caller
from cells import ERROR_SIZE, FAST, write_truth
from geometry_msgs.msg import PointStamped, TransformStamped
from nav_msgs.msg import Path
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker, MarkerArray

from otf_core.model.observation import Samples
from otf_core.model.path import NominalPath
from otf_msgs.msg import CalibratorState, VolumeErrors
from otf_ros import convert, qos

ASKED = {'finish_at_stream_end': False, 'finish_at_standstill': False, 'idle_timeout': 0.0}
"""Parameters of a calibrator that waits until it is asked, so that there is time to look."""
MOST = 10_000
"""Points of a picture: what any viewer draws without effort."""


class Reader:
    """Asks a page as a browser does, in a thread, until it is told that this is the end."""

    def __init__(self, graph, page):
        def address():
            return re.search(r'live view at (http://\S+)', page.last_lines())

        graph.wait(address, 'the page')
        self.url = address()[1]
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        while not self.latest().get('ended'):
            time.sleep(0.5)

    def latest(self):
        """What the page says."""
        with urllib.request.urlopen(f'{self.url}state.json', timeout=10) as answer:
            return json.load(answer)

    def ended(self):
        """Wait for the thread; True if it was told the end."""
        self._thread.join(10)
        return not self._thread.is_alive()


def start_cell(graph, machine_file, truth):
    """Start planner, calibrator and driver for a run of two laps."""
    graph.start('path_planner', machine_file=machine_file, passes=2, levels=2)
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out'}
    graph.start('calibrator', **given, **ASKED)
    simulated = {'simulated.truth_tables': truth, **FAST, 'time_scale': 20.0}
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


def times(marker):
    """How enlarged errors are, as a legend says it."""
    return float(marker.text.split('x ')[1].split(':')[0].replace(',', ''))


def arrows(marker):
    """Begin and end of the lines of a marker, each (n, 3), m."""
    return array(marker.points).reshape(-1, 2, 3).swapaxes(0, 1)


def test_run_is_shown_while_it_is_driven_and_afterwards(graph, machine_file, tmp_path):
    graph.start('viewer')
    page = graph.start('page', port=0)
    early = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
    states = graph.listen(CalibratorState, 'calibrator/state')
    live = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
    distances = graph.listen(Float64, 'view/distance_from_path', qos.SCALAR)
    paths = graph.listen(Path, 'planner/path', qos.PATH)
    volumes = graph.listen(VolumeErrors, 'calibrator/volume', qos.RESULT)
    reader = Reader(graph, page)
    assert reader.latest()['scene'] == {'path': None, 'volume': None, 'solved': None}
    start_cell(graph, machine_file, write_truth(tmp_path, machine_file))
    graph.wait(lambda: early, 'a first look')
    graph.wait(lambda: reader.latest()['now']['distance_um'] is not None, 'it in the page')
    assert reader.latest()['scene']['solved'] is None
    length = states[-1].path_length
    graph.wait(lambda: states[-1].travelled > 0.6 * length, 'more than a lap')
    halfway = reader.latest()
    published = graph.wait_for_status('FINISHED').samples_published
    graph.wait(lambda: states[-1].samples == published, 'the last samples')
    for node in ('path_planner', 'tracker_driver', 'calibrator', 'viewer', 'page'):
        policies.check(graph.ear(), node)
    caller = Caller(graph)
    ended = caller.outcome(caller.send())
    caller.close()
    result, _ = graph.wait_for_result()
    graph.wait(lambda: volumes, 'the errors')
    graph.wait(lambda: reader.latest()['scene']['solved'], 'them in the page')
    assert volumes[0].provisional == any('interim' in text for text in result.warnings)
    graph.wait(lambda: reader.latest()['now']['state'] == 'DONE', 'the end in the page')

    late = graph.listen(MarkerArray, 'view/scene', qos.PICTURE)
    graph.wait(lambda: late and 'so far' not in layers(late[-1])['error_legend'].text, 'the scene')
    graph.wait(lambda: 'tracker' in layers(live[-1]), 'the tracker')
    check_action(caller.feedback, *ended, result)
    check_first_look(early[0], result, states)
    check_scene(layers(late[-1]), paths[0], volumes[-1])
    check_run(layers(live[-1]), result)
    assert 0 < np.median([m.data for m in distances]) < 3 * ERROR_SIZE
    check_page(halfway, reader.latest(), result)
    graph.stop(page)
    assert reader.ended()


def check_action(feedback, status, ended, result):
    """Who asked by the action is told what all are told, when the files are there."""
    assert (status, ended.success, ended.code) == (GoalStatus.STATUS_SUCCEEDED, True, 0)
    assert (ended.run_id, ended.message) == (result.run_id, result.message)
    assert (FilePath(ended.output_directory) / 'samples').exists()
    assert {f.stage for f in feedback} >= {'aligning', 'solving'}
    assert all(0 <= f.fraction <= 1 for f in feedback)
    assert all(math.isnan(f.time_left) or f.time_left >= 0 for f in feedback)


def check_first_look(early, result, states):
    """The tracker is found where it is at the end, about as well as the machine follows."""
    place, final = early.transform.translation, result.alignment.translation
    away = np.subtract((place.x, place.y, place.z), (final.x, final.y, final.z))
    assert np.linalg.norm(away) < 20 * ERROR_SIZE
    assert result.status == result.OK and result.samples_lost == 0
    stages = [state.stage for state in states]
    assert stages.index('driving') < stages.index('solving') and stages[-1] == ''
    left = [s.time_left for s in states if s.stage == 'driving' and math.isfinite(s.time_left)]
    assert left and left[-1] < left[0] / 2
    assert math.isnan(states[-1].time_left)


def check_scene(scene, path, volume):
    """The path as published; arrows that are the errors, as enlarged as the legend says."""
    corners = array([pose.pose.position for pose in path.poses])
    assert np.array_equal(array(scene['path'].points), corners)
    begin, end = arrows(scene['errors'])
    assert np.allclose(begin, array(volume.points))
    enlarged = times(scene['error_legend']) * array(volume.errors)
    assert np.allclose(end - begin, enlarged, rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(array(volume.u), axis=1).max() < ERROR_SIZE / 5


def check_run(now, result):
    """Tracker where the result says; deviations as large as the errors of the machine."""
    place = result.alignment.translation
    assert np.allclose(array(now['tracker'].points), [[place.x, place.y, place.z]], atol=1e-9)
    begin, end = arrows(now['deviations'])
    lengths = np.linalg.norm(end - begin, axis=1) / times(now['deviation_legend'])
    assert len(begin) > 10 and ERROR_SIZE / 20 < lengths.mean() < 3 * ERROR_SIZE


def check_page(halfway, end, result):
    """The page says what the messages say, in um."""
    now, solved = halfway['now'], end['scene']['solved']
    assert now['state'] == 'BUFFERING' and 0.3 < now['fraction'] <= 1
    assert len(now['places']) == len(now['deviations_um']) > 5
    assert solved['ok'] and solved['residual_rms_um'] == 1e6 * result.residual_rms
    assert end['now']['fraction'] == 1.0 and end['now']['samples'] == result.samples
    assert solved['squareness']['C0Y'] == [1e6 * result.c0y, 1e6 * result.u_c0y]
    u = {name: None if math.isnan(v) else 1e6 * v
         for name, v in zip(result.motions, result.motion_u, strict=True)}  # fmt: skip
    assert {name: v for name, (_, v) in solved['motions'].items()} == u


def test_bad_set_up_is_said_while_the_run_goes_on(graph, machine_file):
    graph.start('calibrator', machine_file=machine_file, output_directory=graph.folder, **ASKED)
    early = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
    paths = graph.ear().create_publisher(Path, 'planner/path', qos.PATH)
    points = graph.ear().create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)
    square = NominalPath([[0, 0, 0], [0.3, 0, 0], [0.3, 0.15, 0], [0, 0.15, -0.1], [0, 0, 0]])
    paths.publish(convert.path_to_message(square, graph.ear().get_clock().now().to_msg()))
    graph.wait_for_state('BUFFERING')
    graph.wait(points.get_subscription_count, 'the calibrator')
    turns = np.linspace(0, 30, 1500)
    elsewhere = np.stack([1 + 0.02 * turns, 0.03 * np.cos(turns), 0.03 * np.sin(turns)], axis=1)
    coil = Samples(1_700_000_000_000_000_000 + np.arange(1500) * 10_000_000, elsewhere)
    for message in convert.points_to_messages(coil):
        points.publish(message)
    words = 'the place of the tracker is not known yet'
    graph.wait(lambda: words in graph.state().message, 'what is wrong')
    said = graph.state().message
    assert 'do not follow the path' in said or 'followed only' in said
    assert graph.state().name == 'BUFFERING' and not early


def test_viewer_alone_says_nothing_and_a_broken_path_does_no_harm(graph):
    node = graph.start('viewer')
    publisher = graph.ear().create_publisher(Path, 'planner/path', qos.PATH)
    live = graph.listen(MarkerArray, 'view/live', qos.PICTURE)
    publisher.publish(Path())
    graph.wait(lambda: 'planner/path ignored' in node.last_lines(), 'the complaint')
    assert not live
