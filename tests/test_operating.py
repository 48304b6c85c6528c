# SPDX-License-Identifier: Apache-2.0
"""Services of the driver over an emulated tracker, its gaps, and what it tells of its health."""

from types import SimpleNamespace

from cells import FAST, SHORT
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from emulated import emulator
from geometry_msgs.msg import PointStamped

from otf_calibrator.publish import _journal as journal
from otf_msgs.msg import TrackerGap, TrackerStatus
from otf_ros import qos
from otf_ros.diagnostics import Finding, Level


def start_driver(graph, port, **given):
    parameters = {'backend': 'emscon', 'wait_for_subscribers': 0, 'emscon.port': port, **given}
    return graph.start('tracker_driver', **parameters)


def test_operator_prepares_the_tracker_then_starts_and_stops_it(graph):
    with emulator() as running:
        start_driver(graph, running.port, auto_start=False)
        answer = graph.trigger('tracker/find_reflector')
        assert not answer.success and 'tracker/start' in answer.message
        assert graph.transition('configure')
        assert (
            graph.trigger('tracker/list_reflectors').message == 'RRR-0.5in, CCR-1.5in, TBR-0.5in'
        )
        assert not graph.trigger('tracker/set_reflector').success
        assert graph.set_parameter('tracker_driver', 'emscon.reflector', 'TBR-0.5in').successful
        assert graph.trigger('tracker/set_reflector').message == 'TBR-0.5in'
        assert graph.trigger('tracker/bird_bath').success
        assert running.tracker.device.seen
        answer = graph.trigger('tracker/two_face_check')
        assert 'horizontal 12.00 urad, vertical -8.00 urad' in answer.message
        assert graph.trigger('tracker/clear_errors').success
        assert not graph.trigger('tracker/stop').success
        points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
        statuses = graph.listen(TrackerStatus, 'tracker/status')
        assert graph.trigger('tracker/start').success
        graph.wait(lambda: points and statuses[-1].clock_settled, 'samples')
        answer = graph.trigger('tracker/bird_bath')
        assert not answer.success and 'stop it first' in answer.message
        assert graph.trigger('tracker/stop').success
        assert graph.lifecycle_state() == 'inactive'


def test_lost_beam_is_told_at_once_and_its_gap_when_samples_come_again(graph):
    gaps = graph.listen(TrackerGap, 'tracker/gap', qos.EVENTS)
    points = graph.listen(PointStamped, 'tracker/point', qos.MEASUREMENT)
    diagnosed = graph.listen(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
    statuses = graph.listen(TrackerStatus, 'tracker/status')
    with emulator('beam_loss=0.3,beam_out=2', seed=3) as running:
        start_driver(graph, running.port)
        graph.wait(lambda: gaps, 'a gap')
        told = [status for status in statuses if status.beam == TrackerStatus.BEAM_SEARCHING]
        assert any('beam lost' in status.message for status in told)
        stamps = [point.header.stamp for point in points]
        assert gaps[0].last in stamps
        assert 'beam lost' in gaps[0].reason and gaps[0].stream_id == statuses[-1].stream_id
        graph.wait(lambda: statuses[-1].interruptions >= 1, 'its count, as it went on')
        graph.wait(lambda: any(levels(one)['beam'] != DiagnosticStatus.OK for one in diagnosed),
                   'a warning of the lost beam')  # fmt: skip
        assert {'link', 'stream', 'clock', 'losses', 'environment', 'memory'} < set(
            levels(diagnosed[-1])
        )


def levels(message):
    return {status.name.rpartition(': ')[2]: status.level for status in message.status}


def test_other_backends_start_again_after_their_end_but_take_no_commands(graph, machine_file):
    given = {'machine_file': machine_file, 'wait_for_subscribers': 0, **FAST}
    graph.start('tracker_driver', **given)
    answer = graph.trigger('tracker/bird_bath')
    assert not answer.success and 'takes no commands' in answer.message
    graph.start('path_planner', machine_file=machine_file, **SHORT, feed=1.0)
    first = graph.wait_for_status('FINISHED')
    assert graph.trigger('tracker/start').success
    graph.wait(lambda: graph.status().stream_id != first.stream_id, 'another stream')


def test_journal_that_cannot_be_written_is_an_error(tmp_path):
    kept = SimpleNamespace(directory=tmp_path, trouble='')
    assert journal(kept).level != Level.ERROR and 'left' in journal(kept).text
    kept.trouble = 'the journal cannot be written (No space left on device)'
    assert journal(kept) == Finding(Level.ERROR, kept.trouble)
