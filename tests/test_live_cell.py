# SPDX-License-Identifier: Apache-2.0
"""Planner, simulated tracker and calibrator together, against the known errors of the machine."""

import json
from pathlib import Path as FilePath

from cells import FAST, SHORT, share_left, write_truth
from geometry_msgs.msg import TransformStamped
from graph import offline, without_date
from nav_msgs.msg import Path

from otf_core.model.motions import MOTIONS
from otf_core.prediction.calibration_document import load_tables
from otf_msgs.msg import ErrorTables, TrackerStatus
from otf_ros import qos
from otf_ros.convert import ns_from_time


def start_all(graph, machine_file, truth, **driver):
    graph.start('path_planner', machine_file=machine_file, **SHORT)
    graph.start('calibrator', machine_file=machine_file, output_directory=graph.folder / 'out')
    given = {'machine_file': machine_file, 'simulated.truth_tables': truth, **FAST, **driver}
    return graph.start('tracker_driver', **given)


def test_finds_the_true_errors_of_one_run_after_another_and_every_reader_gets_the_tables(
    graph, machine_file, tmp_path
):
    truth, other = (write_truth(tmp_path, machine_file, seed) for seed in (3, 4))
    start_all(graph, machine_file, truth)
    result, state = graph.wait_for_result()
    assert (result.status, state.name) == (result.OK, 'DONE'), state.message
    status = graph.wait_for_status('FINISHED')
    assert status.samples_published == status.samples_expected > 10_000
    assert result.samples_lost == 0
    folder = FilePath(result.output_directory)
    assert share_left(folder / 'error_tables.json', truth) < 0.03
    assert (tmp_path / 'out' / 'latest').resolve() == folder

    tables = load_tables(folder / 'error_tables.json').tables
    together = graph.listen(ErrorTables, 'calibrator/error_tables', qos.RESULT)
    alignment = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
    graph.wait(lambda: together and alignment, 'the latched tables')
    (all_of_it,) = together
    assert [message.motion for message in all_of_it.tables] == list(MOTIONS)
    for message in all_of_it.tables:
        table = tables.motions[message.motion]
        assert list(message.value) == table.value.tolist()
        assert list(message.u) == table.u.tolist()
    for k, name in enumerate(all_of_it.squareness):
        assert all_of_it.squareness_value[k] == tables.squareness[name].value
        assert all_of_it.squareness_u[k] == tables.squareness[name].u
    assert len(all_of_it.squareness) == 3 and all(all_of_it.squareness_identifiable)
    stated = json.loads((folder / 'error_tables.json').read_text())['provenance']
    (run,) = stated['runs']
    assert (all_of_it.run_sha256, all_of_it.samples) == (run['sha256'], run['samples'])
    assert ns_from_time(all_of_it.first) == run['first_stamp_ns']
    assert ns_from_time(all_of_it.last) == run['last_stamp_ns']
    assert all_of_it.machine_sha256 == stated['machines'][0]['sha256']
    assert (all_of_it.run_id, all_of_it.output_directory) == (result.run_id, str(folder))
    assert (alignment[0].header.frame_id, alignment[0].child_frame_id) == ('machine', 'tracker')

    graph.wait((folder / 'samples').exists, 'the bag of the samples')
    again = offline(folder / 'samples', machine_file, tmp_path / 'offline')
    assert again == without_date((folder / 'error_tables.json').read_bytes())

    assert graph.transition('deactivate')
    assert graph.transition('cleanup')
    changed = ('simulated.truth_tables', str(other))
    assert graph.set_parameter('tracker_driver', *changed).successful
    assert graph.transition('configure')
    assert graph.transition('activate')
    second, _ = graph.wait_for_result(2)
    assert second.run_id != result.run_id and second.samples_lost == 0
    assert share_left(FilePath(second.output_directory) / 'error_tables.json', other) < 0.03


def test_standstill_method_uses_the_stops_and_frames_are_called_as_the_graph_wants(
    graph, machine_file, tmp_path
):
    frames = {'machine_frame': 'left/machine', 'tracker_frame': 'leica'}
    truth = write_truth(tmp_path, machine_file)
    stops = {'corner_dwell': 2.0, 'feed': 1.0}
    given = {'machine_file': machine_file, **frames}
    alignment = graph.listen(TransformStamped, 'calibrator/alignment', qos.RESULT)
    paths = graph.listen(Path, 'planner/path', qos.PATH)
    statuses = graph.listen(TrackerStatus, 'tracker/status')
    graph.start('path_planner', **given, **SHORT, **stops)
    graph.start('calibrator', **given, output_directory=tmp_path / 'out', method='standstill')
    graph.start('tracker_driver', **given, **{'simulated.truth_tables': truth, **FAST})
    result, state = graph.wait_for_result()
    graph.wait(lambda: alignment and paths, 'alignment and path')
    names = alignment[-1].header.frame_id, alignment[-1].child_frame_id
    assert names == ('left/machine', 'leica') and paths[-1].header.frame_id == 'left/machine'
    assert statuses[-1].header.frame_id == 'leica'
    assert (result.method, state.name) == ('standstill', 'DONE'), state.message
    folder = FilePath(result.output_directory)
    graph.wait((folder / 'samples').exists, 'the bag of the samples')
    again = offline(folder / 'samples', machine_file, tmp_path / 'offline', '--method=standstill')
    assert again == without_date((folder / 'error_tables.json').read_bytes())
