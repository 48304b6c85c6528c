# SPDX-License-Identifier: Apache-2.0
"""Mistakes in input files and arguments: one line that says what and where."""

import os
import time
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from cli_cells import message, run

from otf_core.files.strict_yaml import value_text

HUGE = '1' + '0' * 400
ENDLESS = '1' + '0' * 5000
EFFECT = '- effect: backlash\n  parameters: {B_X: NUMBER}\n'
PLAN = (
    '{"schema": "otf-plan/2", "axes": ["X", "Y", "Z"], '
    '"parts": [{"target": "tool", "positions": [[0, 0, NUMBER], [1, 1, 1]]}]}'
)


@pytest.mark.parametrize(
    ('key', 'value', 'words'),
    [
        (('axes', 'X', 'max'), 300.0, 'is it in mm? Write 0.3 m'),
        (('axes', 'X', 'table_pitch'), 50.0, 'is it in mm?'),
        (('target_offset',), [0, 0, -150.0], 'not mm'),
        (('tracker', 'u_range'), 0.5, 'is it in um? Write 5e-07 m'),
        (('tracker', 'u_angle'), 2.0, 'is it in urad? Write 2e-06 rad'),
        (('axes', 'X', 'max'), 10**400, 'the number is too large'),
        (('name',), [[[1] * 9] * 9] * 9, 'expected text'),
        (('target_offset',), [['x' * 10**5] * 9] * 9, 'expected a list of 3 numbers'),
        (('axes', 'X', 'min'), {'a': 'x' * 10**5}, 'expected a plain number'),
    ],
)
def test_wrong_units_and_monsters_in_a_machine_description(place, capsys, key, value, words):
    data = yaml.safe_load(Path('machine.yaml').read_text())
    inner = data
    for part in key[:-1]:
        inner = inner[part]
    inner[key[-1]] = value
    Path('wrong.yaml').write_text(yaml.safe_dump(data))
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    said = message(capsys)
    assert words in said
    assert said.startswith(f'otf plan: wrong.yaml: {": ".join(key)}: ')
    assert len(said) < 400


def test_aliases_that_grow_without_end_are_shown_in_a_line(place, capsys):
    levels = [f'- &{b} [{", ".join([f"*{a}"] * 9)}]' for a, b in pairwise('abcdefghi')]
    bomb = '\n'.join(['- &a [1, 1, 1, 1, 1, 1, 1, 1, 1]', *levels])
    Path('bomb.yaml').write_text(bomb)
    start = time.process_time()
    value = yaml.safe_load(bomb)
    assert len(value_text(value)) < 400
    text = Path('machine.yaml').read_text().replace('name: small', f'name:\n{bomb}')
    Path('wrong.yaml').write_text(text)
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    assert len(message(capsys)) < 400
    assert time.process_time() - start < 2.0


def test_message_of_any_length_is_cut(place, capsys):
    Path('wrong.yaml').write_text(Path('machine.yaml').read_text() + f'? {"x" * 10**5}\n: 1\n')
    assert run('plan', '--machine', 'wrong.yaml', '--out', 'out') == 2
    said = message(capsys)
    assert 'unknown key' in said
    assert len(said) < 1100


@pytest.mark.parametrize(
    ('option', 'content', 'words'),
    [
        ('--effects', EFFECT.replace('NUMBER', HUGE), 'B_X: the number is too large'),
        ('--effects', EFFECT.replace('NUMBER', ENDLESS), 'thousands of digits'),
        (
            '--effects',
            EFFECT.replace('NUMBER', '.inf'),
            'a plain number in SI units, got inf',
        ),
        ('--effects', '[' * 5000, 'nested too deeply'),
        ('--path', PLAN.replace('NUMBER', HUGE), 'positions: expected n x 3 finite numbers'),
        ('--path', PLAN.replace('NUMBER', ENDLESS), 'thousands of digits'),
        ('--path', '{"a":' * 100_000, 'nested too deeply'),
        ('--tables', '[' * 100_000, 'nested too deeply'),
        ('--tables', '{"schema": NUMBER}'.replace('NUMBER', ENDLESS), 'thousands of digits'),
        ('--tables', '\x00\xff', 'not'),
    ],
)
def test_monsters_in_other_files(place, capsys, option, content, words):
    Path('wrong').write_text(content, encoding='latin-1')
    assert run('simulate', '--machine', 'machine.yaml', option, 'wrong', '--out', 'out') == 2
    said = message(capsys)
    assert words in said
    assert said.startswith('otf simulate: wrong: ')
    assert os.listdir() != ['out']
    assert not Path('out').exists()


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (f'passes: {HUGE}', 'passes: the number is too large'),
        (f'margin: {HUGE}', 'margin: the number is too large'),
        (f'levels: 0x{"f" * 9000}', 'levels: the number is too large'),
        ('passes: 1\npasses: 2', "key 'passes' appears twice"),
        ('- passes', 'expected a mapping'),
    ],
)
def test_monsters_in_a_config(place, capsys, content, words):
    Path('c.yaml').write_text(content)
    assert run('plan', '--machine', 'machine.yaml', '--config', 'c.yaml', '--out', 'out') == 2
    said = message(capsys)
    assert words in said and said.startswith('otf plan: c.yaml: ')


@pytest.mark.parametrize('content', ['{"u_range": NUMBER}'.replace('NUMBER', HUGE), '[' * 100_000])
def test_monsters_in_a_noise_file(place, capsys, content):
    Path('noise.json').write_text(content)
    arguments = ('plan', '--machine', 'machine.yaml', '--noise', 'noise.json', '--out', 'out')
    assert run(*arguments) == 2
    assert message(capsys).startswith('otf plan: noise.json: not ')


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (
            ('calibrat', 'bag'),
            "otf: unknown command 'calibrat'; did you mean calibrate? commands: ",
        ),
        (('xyz',), "otf: unknown command 'xyz'; commands: check, info, "),
        (
            ('calibrate', 'bag', '--machine', 'm', '--out', 'o', '--methd', '1'),
            'otf calibrate: unknown option --methd; did you mean --method? '
            '(see otf calibrate --help)',
        ),
        (
            ('noise', 'bag', 'more', '--out', 'o'),
            'otf noise: unknown argument more (see otf noise --help)',
        ),
        (
            ('plan', '--machine', 'm', '--out', 'o', '--feed', '0.25'),
            'otf plan: --feed: 0.25 is out of range, 6 to 300000 mm/min are possible',
        ),
    ],
)
def test_typing_mistakes_point_to_what_was_meant(capsys, arguments, words):
    assert run(*arguments) == 2
    assert message(capsys).startswith(words)


def test_help_lists_choices_and_overwriting(capsys):
    assert run('calibrate', '--help') == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert '--method {otf,standstill}' in said and 'piece_length' in said
    assert '--overwrite' in said
