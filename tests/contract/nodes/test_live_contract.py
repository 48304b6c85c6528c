# SPDX-License-Identifier: Apache-2.0
"""The live graph: three axes, five axes, a calibrator that is killed; as it is offline."""

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from command import HERE, ROOT, otf, read
from geometry_msgs.msg import PointStamped
from golden import departures, golden_file, reduced
from nav_msgs.msg import Path as PathMessage
from stated import MACHINE

import otf_core
from otf_msgs.msg import ErrorTables
from otf_ros import convert, qos

SMALL = {'X': (0.0, 0.15), 'Y': (0.0, 0.12), 'Z': (-0.1, 0.0)}


def without_date(file):
    """Content of a result but for the moment of writing and the name of the recording."""
    text = re.sub(r'"written": "[^"]*"', '"written": ""', Path(file).read_text(encoding='utf-8'))
    return json.loads(re.sub(r'"name": "(?:bag|samples)"', '"name": ""', text))


def offline(bag, machine, folder):
    """error_tables.json that the command makes of a bag."""
    done = otf('calibrate', bag, '--machine', machine, '--out', folder)
    assert done.code == 0, done.said
    return folder / 'error_tables.json'


def test_three_axes_live_are_what_the_command_makes_of_the_same_samples(graph, tmp_path):
    machine_file = tmp_path / 'machine.yaml'
    axes = {a: {'min': low, 'max': high, 'table_pitch': 0.05} for a, (low, high) in SMALL.items()}
    machine_file.write_text(json.dumps({**MACHINE, 'axes': axes}))
    tables = graph.listen(ErrorTables, 'calibrator/error_tables', qos.RESULT)
    graph.start('path_planner', machine_file=machine_file, passes=2, levels=2)
    graph.start('calibrator', machine_file=machine_file, finish_at_standstill=False)
    fast = {'simulated.rate': 50.0, 'time_scale': 30.0}
    graph.start('tracker_driver', machine_file=machine_file, **fast)
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    status = graph.wait_for_status('FINISHED')
    assert status.samples_published == status.samples_expected
    assert (result.samples_lost, result.samples) == (0, status.samples_published)
    folder = Path(result.output_directory)
    graph.wait((folder / 'samples').exists, 'the bag of the samples')
    live = folder / 'error_tables.json'
    again = offline(folder / 'samples', machine_file, tmp_path / 'offline')
    assert without_date(live) == without_date(again)
    graph.wait(lambda: tables, 'the latched tables')
    told, written = tables[-1], read(live)
    assert {t.motion: list(t.value) for t in told.tables} == {
        name: own['value'] for name, own in written['motions'].items()
    }
    # stamps are those of the tracker's clock: 20 ms apart, though they came 30 times as fast
    stamps = otf_core.read_bag(folder / 'samples', otf_core.load_machine(machine_file)).samples
    assert np.median(np.diff(stamps.stamp_ns)) == pytest.approx(20e6, rel=1e-3)


def test_five_axes_replayed_give_the_golden_tables(graph):
    place = ROOT / 'bags' / 'trunnion'
    graph.start('calibrator', machine_file=place / 'machine.yaml', finish_at_standstill=False)
    replay = {'backend': 'replay', 'replay.bag': place / 'bag'}
    graph.start('tracker_driver', **replay, time_scale=50.0)
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    assert (result.samples_lost, result.samples) == (0, 17370)
    assert list(result.not_identifiable) == ['ECX', 'ECZ']
    document = read(Path(result.output_directory) / 'error_tables.json')
    said, _ = departures(read(golden_file('trunnion')), reduced(0, document))
    assert not said, '\n'.join(said)


def test_killed_calibrator_goes_on_and_loses_nothing(graph, tmp_path):
    place = HERE / 'recordings' / 'two-targets'
    machine_file = place / 'machine.yaml'
    whole = otf_core.read_bag(place / 'run1', otf_core.load_machine(machine_file))
    samples, half = whole.samples, 2500
    given = {'machine_file': machine_file, 'finish_at_standstill': False, 'idle_timeout': 2.0}
    ear = graph.ear()
    path = ear.create_publisher(PathMessage, 'planner/path', qos.PATH)
    path.publish(convert.path_to_message(whole.path, ear.get_clock().now().to_msg()))
    points = ear.create_publisher(PointStamped, 'tracker/point', qos.MEASUREMENT)

    def publish(first, last, readers):
        graph.wait(lambda: points.get_subscription_count() >= readers, 'the calibrator')
        own = otf_core.Samples(samples.stamp_ns[first:last], samples.xyz[first:last])
        for message in convert.points_to_messages(own):
            points.publish(message)
        graph.wait(lambda: graph.state() and graph.state().samples >= last, 'the samples')

    node = graph.start('calibrator', **given)
    graph.wait_for_state('BUFFERING')
    publish(0, half, 1)
    journals = graph.folder / 'out' / 'journal'
    graph.wait(lambda: any(journals.glob('*/metadata.yaml')), 'the journal')
    (journal,) = (file.parent for file in journals.glob('*/metadata.yaml'))
    machine = otf_core.load_machine(machine_file)
    written = lambda: len(otf_core.read_bag(journal, machine).samples)  # noqa: E731
    graph.wait(lambda: written() == half, 'the journal')
    node.interrupt(signal.SIGKILL)
    node.wait()
    graph.nodes.remove(node)
    graph.heard['calibrator/state'].clear()
    graph.start('calibrator', **given)
    graph.wait(lambda: graph.state() and graph.state().samples == half, 'the run before')
    publish(half, len(samples), 2)
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    kept = otf_core.read_bag(journal, machine).samples
    assert kept.xyz.tobytes() == samples.xyz.tobytes()
    assert kept.stamp_ns.tobytes() == samples.stamp_ns.tobytes()
    live = read(Path(result.output_directory) / 'error_tables.json')
    again = offline(place / 'run1', machine_file, tmp_path / 'offline')
    assert live['motions'] == read(again)['motions']
