# SPDX-License-Identifier: Apache-2.0
"""A plain tracker, and a calibrator that is killed in the middle of a run."""

import json
import signal
import time
from pathlib import Path

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import Temperature

from otf_core.bags.bag import read_bag
from otf_core.bags.bag_signals import read_signals
from otf_core.model.machine import load_machine
from otf_core.model.observation import Samples
from otf_core.model.provenance import origin_of
from otf_ros import convert, qos

CELL = Path(__file__).parents[1] / 'bags' / 'y-carries-the-table'
TOPIC = '/spindle/temperature'


class PlainTracker:
    """Publishes points as a driver that knows nothing of this project."""

    def __init__(self, graph):
        self._graph = graph
        self._publisher = graph.ear().create_publisher(
            PointStamped, 'tracker/point', qos.MEASUREMENT
        )

    def publish(self, samples, expected, readers=1):
        """Publish samples, and wait until the calibrator has so many."""
        graph = self._graph
        graph.wait(lambda: self._publisher.get_subscription_count() >= readers, 'the calibrator')
        for message in convert.points_to_messages(samples):
            self._publisher.publish(message)
        graph.wait(lambda: graph.state() and graph.state().samples == expected, 'all samples')


class Thermometer:
    """Publishes a temperature beside the samples."""

    def __init__(self, graph):
        self._graph, self.said = graph, {}
        self._publisher = graph.ear().create_publisher(Temperature, TOPIC, qos.EVENTS)

    def publish(self, stamps, readers=1):
        """Publish one value at each stamp, ns."""
        publisher = self._publisher
        self._graph.wait(lambda: publisher.get_subscription_count() >= readers, 'its reader')
        for stamp in stamps.tolist():
            value = self.said.setdefault(stamp, 20.0 + 0.1 * len(self.said))
            message = Temperature(temperature=value)
            message.header.stamp = convert.time_from_ns(stamp)
            publisher.publish(message)


def signal_in(bag, machine_file):
    """What a bag says of the temperature, by stamps."""
    found = read_signals(bag, load_machine(machine_file).signals).values()
    pairs = (zip(f.stamp_ns.tolist(), f.value.tolist(), strict=True) for f in found)
    return dict(next(pairs, ()))


def test_killed_calibrator_goes_on_with_its_run(graph, tmp_path):
    whole = read_bag(CELL / 'bag')
    samples = Samples(whole.samples.stamp_ns[::4], whole.samples.xyz[::4])
    machine_file, count, part = tmp_path / 'machine.yaml', len(samples), 5000
    section = f'signals:\n  {TOPIC}: {{unit: K}}\n'
    machine_file.write_text((CELL / 'machine.yaml').read_text() + section)
    given = {'machine_file': machine_file, 'output_directory': tmp_path / 'out'}
    given |= {'finish_at_standstill': False, 'idle_timeout': 2.0}
    path = graph.ear().create_publisher(PathMessage, 'planner/path', qos.PATH)
    path.publish(convert.path_to_message(whole.path, graph.ear().get_clock().now().to_msg()))
    tracker = PlainTracker(graph)

    node = graph.start('calibrator', **given)
    thermometer = Thermometer(graph)
    graph.wait_for_state('BUFFERING')  # it has its path
    tracker.publish(samples.part(0, part), part)
    thermometer.publish(samples.stamp_ns[:part:500])
    assert graph.trigger('calibrator/calibrate').success
    interim, state = graph.wait_for_result()
    assert interim.status == interim.QUALITY_GATE_FAILED and interim.coverage < 0.8
    assert 'interim' in ' '.join(interim.warnings)
    (folder,) = (p for p in (tmp_path / 'out' / 'journal').iterdir() if p.is_dir())
    graph.wait(lambda: len(read_bag(folder).samples) == part, 'the journal')
    before = thermometer.said.copy()
    graph.wait(lambda: signal_in(folder, machine_file) == before, 'the temperatures')
    time.sleep(2.5)  # longer than idle_timeout

    node.interrupt(signal.SIGKILL)
    node.wait()
    graph.nodes.remove(node)
    graph.heard['calibrator/state'].clear()
    graph.start('calibrator', **given)
    assert graph.wait_for_state('BUFFERING').samples == part
    rest = samples.stamp_ns[part::500]
    graph.wait(  # one alone until it is taken: best effort, and the dead reader counts as well
        lambda: thermometer.publish(rest[:1]) or int(rest[0]) in signal_in(folder, machine_file),
        'a reader after the crash',
    )
    thermometer.publish(rest[1:])
    graph.wait(lambda: signal_in(folder, machine_file) == thermometer.said, 'the other ones')
    tracker.publish(samples.part(part, count), count)
    result, state = graph.wait_for_result(2)
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    tables = json.loads((Path(result.output_directory) / 'error_tables.json').read_text())
    (used,) = tables['provenance']['runs']  # equal input gives equal tables, see test_live_cell
    assert used['sha256'] == origin_of('', samples, whole.path).sha256
    assert read_bag(folder).samples.xyz.tobytes() == samples.xyz.tobytes()
    assert signal_in(Path(result.output_directory) / 'samples', machine_file) == thermometer.said
