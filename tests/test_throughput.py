# SPDX-License-Identifier: Apache-2.0
"""No sample is lost: at the rate of a fast tracker, beyond it, and when a node is held up."""

import signal
from pathlib import Path

import pytest
from cells import SHORT

QUICK = {'feed': 2.0, 'corner_dwell': 0.0, 'end_dwell': 1.5}


UDP_ONLY = {
    'FASTRTPS_DEFAULT_PROFILES_FILE': Path(__file__).with_name('udp_only.xml'),
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',  # LOCALHOST brings back shared memory
}


@pytest.fixture
def graph_by_udp(graph):
    """Nodes that may be stopped: within shared memory, Fast DDS may stay deaf to them."""
    graph.environment.update(UDP_ONLY)
    return graph


def start_cell(graph, machine_file, rate, **driver):
    """Start a cell that calibrates when the stream has ended; returns the calibrator."""
    graph.start('path_planner', machine_file=machine_file, **SHORT, **QUICK)
    given = {'machine_file': machine_file, 'output_directory': graph.folder / 'out'}
    node = graph.start('calibrator', **given, save_bag=False, finish_at_standstill=False)
    simulated = {'simulated.rate': rate, 'simulated.acceleration': 20.0}
    graph.start('tracker_driver', machine_file=machine_file, **simulated, **driver)
    return node


@pytest.mark.parametrize(('rate', 'time_scale'), [(1000.0, 1.0), (1000.0, 5.0)])
def test_no_sample_is_lost(graph, machine_file, rate, time_scale):
    start_cell(graph, machine_file, rate=rate, time_scale=time_scale)
    result, state = graph.wait_for_result()
    status = graph.wait_for_status('FINISHED')
    assert result.samples_lost == 0
    assert state.samples == status.samples_published == status.samples_expected


def hold_up(graph, node, samples):
    """Stop a node soon after the start, while the driver publishes this many samples."""
    graph.wait(lambda: graph.status().samples_published > 1000, 'samples')
    node.interrupt(signal.SIGSTOP)
    until = graph.status().samples_published + samples
    graph.wait(lambda: graph.status().samples_published > until, 'further samples')
    node.interrupt(signal.SIGCONT)


def test_no_sample_is_lost_when_the_calibrator_is_held_up_for_a_while(graph_by_udp, machine_file):
    graph = graph_by_udp
    node = start_cell(graph, machine_file, rate=1000.0, time_scale=2.0)
    graph.wait_for_status('STREAMING')
    hold_up(graph, node, 4000)
    result, _ = graph.wait_for_result()
    assert result.samples_lost == 0


def test_lost_samples_are_counted_and_reported(graph_by_udp, machine_file):
    graph = graph_by_udp
    node = start_cell(graph, machine_file, rate=5000.0, time_scale=2.0, max_rate=10000.0)
    graph.wait_for_status('STREAMING')
    hold_up(graph, node, 45_000)
    result, state = graph.wait_for_result()
    status = graph.wait_for_status('FINISHED')
    assert result.samples_lost == status.samples_published - state.samples > 0
    assert f'{result.samples_lost} samples were lost' in ' '.join(result.warnings)
