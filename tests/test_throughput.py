# SPDX-License-Identifier: Apache-2.0
"""No sample is lost: at the rate of a tracker, beyond it, when a node is held up or killed."""

import signal
from pathlib import Path

import pytest
from cells import SHORT

ASKED = {'finish_at_standstill': False, 'finish_at_stream_end': False, 'idle_timeout': 0.0}
QUICK = {'feed': 2.0, 'corner_dwell': 0.0, 'end_dwell': 1.5}

UDP_ONLY = {
    'FASTRTPS_DEFAULT_PROFILES_FILE': Path(__file__).with_name('udp_only.xml'),
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',  # LOCALHOST brings back shared memory
}


@pytest.fixture
def graph_by_udp(graph):
    """Nodes that may be stopped: within shared memory, Fast DDS may stay deaf to them.

    One that is not heard of for 6 s is out of the graph.
    """
    graph.environment.update(UDP_ONLY)
    return graph


def start_cell(graph, machine_file, rate, **driver):
    """Start a cell that collects samples until it is asked; returns the calibrator."""
    graph.start('path_planner', machine_file=machine_file, **SHORT, **QUICK)
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out'}
    node = graph.start('calibrator', **given, **ASKED)
    simulated = {'simulated.rate': rate, 'simulated.acceleration': 20.0}
    graph.start('tracker_driver', machine_file=machine_file, **simulated, **driver)
    return node


def test_no_sample_is_lost_however_fast_they_are_wanted(graph, machine_file):
    start_cell(graph, machine_file, rate=2000.0, time_scale=50.0)
    status, state = wait_for_the_end(graph)
    assert state.samples == status.samples_published == status.samples_expected
    assert state.samples_lost == 0 and state.stream_id == status.stream_id
    assert 0.0 < status.real_time_factor < 25.0


def wait_for_the_end(graph):
    """Wait until all samples are published and the last is taken; return both states."""
    status = graph.wait_for_status('FINISHED', 'times as fast as measured')
    graph.wait(lambda: graph.state().taken == status.last, 'the last sample')
    return status, graph.state()


def wait_for_samples(graph):
    graph.wait(lambda: graph.status() and graph.status().samples_published > 1000, 'samples')


def wait_for_standstill(graph):
    """Wait until the driver publishes nothing for two seconds; return how much it has."""
    heard = graph.heard['tracker/status']
    graph.wait(lambda: len({s.samples_published for s in heard[-5:]}) == 1, 'a standstill')
    return heard[-1].samples_published


def test_source_waits_for_a_calibrator_that_is_held_up(graph_by_udp, machine_file):
    graph = graph_by_udp
    node = start_cell(graph, machine_file, rate=1000.0, time_scale=20.0)
    wait_for_samples(graph)
    node.interrupt(signal.SIGSTOP)
    published = wait_for_standstill(graph)
    node.interrupt(signal.SIGCONT)
    status, state = wait_for_the_end(graph)
    assert state.samples == status.samples_published > published and state.samples_lost == 0


def test_lost_samples_are_counted_and_reported(graph_by_udp, machine_file):
    graph = graph_by_udp
    node = start_cell(graph, machine_file, rate=5000.0, time_scale=2.0)
    wait_for_samples(graph)
    node.interrupt(signal.SIGSTOP)  # until it is out of the graph, and its queue has run over
    until = graph.status().samples_published + 45_000
    graph.wait(lambda: graph.status().samples_published > until, 'further samples')
    node.interrupt(signal.SIGCONT)
    published = graph.wait_for_status('FINISHED').samples_published

    def all_accounted():  # the last may be lost too: the calibrator is found again after them
        state = graph.state()
        return 0 < state.samples_lost == published - state.samples

    graph.wait(all_accounted, 'what was lost')
