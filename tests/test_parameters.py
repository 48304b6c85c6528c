# SPDX-License-Identifier: Apache-2.0
"""Wrong parameters are refused with one clear message; descriptions reach the tools."""

import re
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.srv import DescribeParameters, ListParameters

from otf_bringup import params_file
from otf_core.config import PlannerConfig

WRONG = [
    ('path_planner', {'feed': -1.0}, 'feed: -1 is out of range'),
    ('path_planner', {'passes': 'two'}, 'passes: expected a whole number'),
    ('path_planner', {'machine_file': ''}, 'machine_file: missing'),
    ('path_planner', {'machine_file': '/no/such/machine.yaml'}, '/no/such/machine.yaml'),
    ('path_planner', {'path_file': '/no/such/path.csv'}, '/no/such/path.csv'),
    ('tracker_driver', {'backend': 'laser'}, 'possible: simulated, replay'),
    ('tracker_driver', {'time_scale': 1000.0}, 'time_scale: 1000 is out of range'),
    ('tracker_driver', {'machine_file': ''}, 'machine_file: missing'),
    ('tracker_driver', {'backend': 'replay'}, 'parameter replay.bag: missing'),
    ('tracker_driver', {'simulated.rate': 1e5}, 'simulated.rate: 100000 is out of range'),
    ('tracker_driver', {'simulated.truth_tables': '/no/such/tables.json'}, '/no/such/tables.json'),
    ('calibrator', {'piece_length': 5.0}, 'piece_length: 5 is out of range'),
    ('calibrator', {'machine_file': ''}, 'machine_file: missing'),
    ('calibrator', {'effects': '/no/such/effects.yaml'}, '/no/such/effects.yaml'),
    ('calibrator', {'output_directory': '/dev/null/x'}, 'output_directory: /dev/null/x/'),
]


@pytest.mark.parametrize(('name', 'wrong', 'message'), WRONG)
def test_wrong_value_at_start_gives_one_message_and_exit_code_2(
    run_here, machine_file, name, wrong, message
):
    code, said = run_here(name, **{'machine_file': machine_file, **wrong})
    errors = [line for line in said.splitlines() if line.startswith('error: ')]
    assert code == 2 and len(errors) == 1 and message in errors[0], said
    assert 'Traceback' not in said


@pytest.mark.parametrize('argument', ['feed:=:', 'feed'])
def test_arguments_that_are_none_give_exit_code_2(graph, argument):
    node = graph.start('path_planner', ['-p', argument])
    graph.nodes.remove(node)
    assert node.wait(timeout=60.0) == 2
    assert 'Traceback' not in node.last_lines(100)


def test_parameters_are_described_checked_and_converted(graph, machine_file):
    node = graph.start('path_planner', ['-p', 'feeed:=1.0'], machine_file=machine_file)
    names = graph.call(ListParameters, 'path_planner/list_parameters').result.names
    infos = {info.name: info for info in PlannerConfig.infos()}
    assert set(infos) < set(names)
    request = DescribeParameters.Request(names=list(infos))
    answer = graph.call(DescribeParameters, 'path_planner/describe_parameters', request)
    for described in answer.descriptors:
        info = infos[described.name]
        assert info.meaning in described.description and info.unit in described.description
        limits = described.floating_point_range or described.integer_range
        assert (limits[0].from_value, limits[0].to_value) == (info.low, info.high)
    assert graph.set_parameter('path_planner', 'feed', 1).successful
    refused = graph.set_parameter('path_planner', 'feed', 100.0)
    assert not refused.successful and 'feed' in refused.reason
    refused = graph.set_parameter('path_planner', 'feed', 'fast')
    assert not refused.successful and 'expected' in refused.reason
    assert "'feeed' is unknown here; did you mean 'feed'?" in node.last_lines(100)


WRONG_FILES = {
    'machine_file': '/no/such/machine.yaml',
    'effects': '/no/such/effects.yaml',
    'output_directory': '/dev/null/x',
    'history_directory': '/dev/null/x',
}


def test_file_that_is_refused_at_start_is_refused_while_running_with_the_same_words(
    run_here, graph, machine_file
):
    graph.start('calibrator', machine_file=machine_file, journal_directory='none')
    for name, value in WRONG_FILES.items():
        code, said = run_here('calibrator', **{'machine_file': machine_file, name: value})
        refused = graph.set_parameter('calibrator', name, value)
        reason = re.sub(r'\d{8}T\d{6}Z', '', f'error: {refused.reason}')
        assert code == 2 and not refused.successful
        assert reason in re.sub(r'\d{8}T\d{6}Z', '', said)
    folder = graph.set_parameter('calibrator', 'machine_file', str(graph.folder))
    assert 'it is a folder' in folder.reason and '--' not in folder.reason
    assert not graph.set_parameter('calibrator', 'machine_file', '').successful
    assert graph.set_parameter('calibrator', 'machine_file', str(machine_file)).successful


def config_file(name):
    return Path(params_file.__file__).resolve().parents[1] / 'config' / name


def test_parameter_file_is_up_to_date():
    made = '\n'.join(params_file.lines()) + '\n'
    assert config_file('params.yaml').read_text() == made, 'run python3 -m otf_bringup.params_file'


def test_parameter_file_holds_the_defaults_in_their_types():
    content = yaml.safe_load(config_file('params.yaml').read_text())
    for node in params_file.NODES:
        values = content[f'/**/{node}']['ros__parameters']
        for info in params_file.infos(node):
            assert (type(values[info.name]), values[info.name]) == (
                type(info.default),
                info.default,
            )


def test_nodes_read_the_parameter_file(graph, machine_file):
    changed = config_file('params.yaml').read_text().replace('passes: 2', 'passes: 3')
    changed = changed.replace('simulated.rate: 500.0', 'simulated.rate: 123.0')
    (graph.folder / 'params.yaml').write_text(changed)
    arguments = ['--params-file', str(graph.folder / 'params.yaml')]
    node = graph.start('path_planner', [*arguments, '-p', f'machine_file:={machine_file}'])
    graph.wait(lambda: 'planned for' in node.last_lines(), 'the plan')
    assert '295 points' in node.last_lines()
    graph.start('tracker_driver', [*arguments, '-p', f'machine_file:={machine_file}'])
    graph.wait(lambda: graph.status() and graph.status().rate == 123.0, 'the rate')
