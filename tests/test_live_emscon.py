# SPDX-License-Identifier: Apache-2.0
"""The whole graph over an emulated tracker's TCP connection."""

from pathlib import Path

from cells import SHORT, SMALL, share_left, write_machine, write_truth
from emulated import DRIFT, emulator
from emulator import Cell

from otf_core.config import PlannerConfig
from otf_core.model.machine import load_machine
from otf_core.prediction.calibration_document import load_tables
from otf_msgs.msg import CalibrationResult

PATH = {**SHORT, 'feed': 0.5, 'corner_dwell': 0.1}
DRIVEN = 150.0
"""s; more than twice the time on the path, at its real pace."""


def test_tracker_behind_a_bad_network_gives_the_true_errors(graph, tmp_path):
    machine_file = write_machine(tmp_path, axes=SMALL)
    truth = write_truth(tmp_path, machine_file)
    machine, tables = load_machine(machine_file), load_tables(truth).tables
    cell = Cell(machine, PlannerConfig(**PATH), 1, DRIFT, tables)
    results = graph.listen(CalibrationResult, 'calibrator/result')
    with emulator('split,merge,speed_warning=0.05,unknown=0.02', simulated=cell) as running:
        graph.start('path_planner', machine_file=machine_file, **PATH)
        graph.start('calibrator', machine_file=machine_file, output_directory=tmp_path / 'out')
        graph.start('tracker_driver', backend='emscon', **{'emscon.port': running.port})
        graph.wait(lambda: results, 'the result', DRIVEN)
    result = results[0]
    assert result.status == result.OK
    assert result.samples_lost == 0
    assert share_left(Path(result.output_directory) / 'error_tables.json', truth) < 0.03


def test_driver_says_what_hinders_the_stream_and_that_it_goes_on(graph):
    with emulator('cut_after=6') as running:
        graph.start('tracker_driver', backend='emscon', wait_for_subscribers=0,
                    **{'emscon.port': running.port})  # fmt: skip
        graph.wait_for_status('STREAMING', 'streaming')
        status = graph.wait_for_status('NO_CONNECTION', 'connecting again')
        assert 'the tracker closed the connection' in status.message
        graph.wait_for_status('STREAMING', 'streaming')
