# SPDX-License-Identifier: Apache-2.0
"""Exit codes, messages and small outputs of the commands."""

import json
import os

import numpy as np
import pytest
import yaml
from cli_cells import read_csv, run, words_of
from core_cells import some_machine

from otf_core.files.writing import whole_file, write_text


@pytest.fixture
def machine_file(tmp_path):
    """A machine.yaml in an empty folder."""
    file = tmp_path / 'machine.yaml'
    file.write_text(yaml.safe_dump(some_machine().to_dict()))
    return file


@pytest.mark.parametrize(
    ('arguments', 'word'),
    [
        ((), 'VERB'),
        (('calibrat',), 'calibrat'),
        (('calibrate',), '--machine'),
        (('calibrate', 'BAG', '--machine', 'M', '--out', 'OUT', '--method', 'guess'), '--method'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--feeed', '3'), '--feeed'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--feed', 'fast'), '--feed'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--feed', '0'), '--feed'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--feed', 'nan'), '--feed'),
        (('plan', '--machine', 'M', '--out', 'OUT', {'passes': 0}), '.yaml: passes: 0 is out of'),
        (('plan', '--machine', 'M', '--out', 'OUT', {'passes': 1.5}), 'passes: expected a whole'),
        (('plan', '--machine', 'M', '--out', 'OUT', {'margin': 0.1}), 'margin'),
        (('plan', '--machine', 'M', '--out', 'OUT', {'lap': 1}), 'lap: unknown key; known to otf'),
        (
            ('plan', '--machine', 'M', '--out', 'OUT', {'reversal': 'none'}),
            'a key of otf',
        ),
        (('plan', '--machine', 'M', '--out', 'OUT', '--config', 'no.yaml'), 'no.yaml'),
        (
            ('diagnose', 'B', '--machine', 'M', '--out', 'OUT', {'exclude': 'x'}),
            'a list of',
        ),
        (
            ('diagnose', 'B', '--machine', 'M', '--out', 'OUT', {'exclude': ['x']}),
            'exclude: x',
        ),
        (('calibrate', 'B', '--machine', 'M', '--out', 'OUT', {'report': 'no'}), 'true or false'),
        (('plan', '--machine', 'nowhere.yaml', '--out', 'OUT'), 'nowhere.yaml'),
        (('plan', '--machine', 'M', '--out', 'M'), 'machine.yaml'),
        (('plan', '--machine', 'M', '--out', 'M/x'), 'machine.yaml'),
        (('simulate', '--machine', 'M', '--out', 'OUT', '--seed', '-1'), '--seed'),
        (('simulate', '--machine', 'M', '--out', 'OUT', '--tables', 'no.json'), 'no.json'),
        (('simulate', '--machine', 'M', '--out', 'OUT', '--path', 'no.csv'), 'no.csv'),
        (('calibrate', 'nobag', '--machine', 'M', '--out', 'OUT'), 'nobag'),
        (('calibrate', 'M', '--machine', 'M', '--out', 'OUT'), 'machine.yaml'),
        (('predict', '--tables', 'M', '--points', 'M', '--out', 'OUT'), 'machine.yaml'),
    ],
)
def test_wrong_usage_is_one_line_exit_code_2_and_no_output(
    machine_file, monkeypatch, capsys, arguments, word
):
    monkeypatch.chdir(machine_file.parent)
    named = [a.replace('OUT', 'out') for a in words_of(*arguments)]
    named = [a.replace('M', 'machine.yaml') if a in ('M', 'M/x') else a for a in named]
    assert run(*named) == 2
    shown = capsys.readouterr()
    assert shown.out == ''
    assert shown.err.startswith('otf')
    assert shown.err.count('\n') == 1
    assert word in shown.err
    assert os.listdir(machine_file.parent) == ['machine.yaml']


@pytest.mark.parametrize(
    ('content', 'word'), [(b'', 'mcap'), (b'\x89MCAP0\r\n', 'mcap'), (b'x' * 5000, 'mcap')]
)
def test_garbage_bag_is_exit_code_3_and_leaves_nothing(machine_file, capsys, content, word):
    bag = machine_file.parent / 'broken.mcap'
    bag.write_bytes(content)
    out = machine_file.parent / 'out'
    assert run('calibrate', bag, '--machine', machine_file, '--out', out) == 3
    message = capsys.readouterr().err
    assert message.count('\n') == 1
    assert 'broken.mcap' in message
    assert word in message
    assert not out.exists()


def test_half_a_path_is_calibrated_with_exit_code_4(machine_file, capsys):
    from core_cells import record, small_plan

    from otf_core.bags.bag import BagContent, write_bag

    machine = some_machine()
    plan = small_plan(machine)
    part = record(machine, plan).between(0.0, 45.0)
    write_bag(machine_file.parent / 'bag', BagContent(part.measured(), plan.path))
    out = machine_file.parent / 'out'
    arguments = (machine_file.parent / 'bag', '--machine', machine_file, '--out', out)
    assert run('calibrate', *arguments) == 4
    said = capsys.readouterr()
    assert (said.out + said.err).count('measurement: NOT GOOD, coverage: 50 % of the path') == 1
    assert json.loads((out / 'error_tables.json').read_text())['failed_gates']


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
        ('{"schema": "otf-plan/2"}', (), 'plan: axes, parts: expected lists'),
        (plan_of([[0, 0, 0], [0.1, 0, 0]], [], [1, 1]), (), 'plan: parts: 1: feed: expected 1'),
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


def test_plan_writes_the_path_it_tells_of(machine_file, capsys):
    out = machine_file.parent / 'plan'
    assert run('plan', '--machine', machine_file, '--out', out, {'passes': 1}) == 0
    header, points = read_csv(out / 'path.csv')
    assert header == 'x,y,z'
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert f'{len(points)} points, {length:.2f} m' in capsys.readouterr().out


def test_feed_is_in_millimetres_per_minute(machine_file, capsys):
    def seconds(feed):
        out = machine_file.parent / 'plan'
        run('plan', '--machine', machine_file, '--out', out, '--feed', feed,
            {'corner_dwell': 0, 'end_dwell': 0, 'passes': 1})  # fmt: skip
        words = capsys.readouterr().out.replace(':', ' ').replace(';', ' ').split()
        return float(words[words.index('s') - 1]), float(words[words.index('m,') - 1])

    # 600 mm/min is 0.01 m/s: slow enough that only the length counts
    time, length = seconds(600)
    assert time == pytest.approx(length / 0.01, rel=0.02)


def test_help_is_there_for_every_verb(capsys):
    for verb in ('calibrate', 'predict', 'plan', 'simulate'):
        assert run(verb, '--help') == 0
        assert '--out' in capsys.readouterr().out
