# SPDX-License-Identifier: Apache-2.0
"""Exit codes, messages and small outputs of the commands."""

import json
import os

import pytest
import yaml
from cli_cells import run
from core_cells import some_machine

from otf_core.files.writing import whole_file, write_text


@pytest.fixture
def machine_file(tmp_path):
    """A machine.yaml in an empty folder."""
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(some_machine().to_dict()))
    return file


def plan_of(positions, feed, dwell):
    """A plan.json of one part."""
    part = {'target': 'tool', 'positions': positions, 'feed': feed, 'dwell': dwell}
    assumed = {'tracker_link': 'w', 'tracker_place': [0, -1, 0]}
    content = {'schema': 'otf-plan/2', 'axes': list('XYZ'), 'parts': [part], 'assumed': assumed}
    return json.dumps(content)


@pytest.mark.parametrize(
    ('content', 'options', 'words'),
    [
        ('{"a": 1}', (), "plan: not a plan; expected the schema 'otf-plan/2'"),
        ('{"schema": "otf-plan/2"}', (), 'plan: axes: missing'),
        (plan_of([[0, 0, 0], [0.1, 0, 0]], [], [1, 1]), (), 'plan: parts: 1: feed: '),
        (plan_of([[0, 0, 0], [0.1, 0, 0]], [0], [1, 1]), (), 'feed: leg 0: must be above 0'),
        (plan_of([[0, 0, 0], [9, 0, 0]], [1], [1, 1]), (), 'leaves the range of axis X'),
        (plan_of([[0, 0, 0], [0.1, 0, 0]], [1], [1, 1]), ('--feed', '3000'), 'feed: '),
        ('{"schema', (), 'plan: not valid JSON'),
        ('G1 X0 Y0', (), 'plan: is an NC program that never states where Z stands'),
        ('a,b\n1,2', (), 'expected the header x,y,z'),
    ],
)  # fmt: skip
def test_file_that_is_no_plan_is_named(machine_file, capsys, content, options, words):
    (machine_file.parent / 'plan').write_text(content)
    arguments = ('--machine', machine_file, '--path', machine_file.parent / 'plan', *options)
    assert run('simulate', *arguments, '--out', machine_file.parent / 'bag') == 2
    message = capsys.readouterr().err
    assert message.count('\n') == 1
    assert words in message
    assert not (machine_file.parent / 'bag').exists()


def test_file_that_cannot_be_finished_leaves_the_old_one(tmp_path):
    file = tmp_path / 'result.json'
    write_text(file, 'old')
    with pytest.raises(RuntimeError, match='half way'), whole_file(file) as partial:
        partial.write_text('half of the n')
        raise RuntimeError('half way')
    assert file.read_text() == 'old'
    assert os.listdir(tmp_path) == ['result.json']
