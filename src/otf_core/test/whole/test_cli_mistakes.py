# SPDX-License-Identifier: Apache-2.0
"""Mistakes in input files and arguments: one line that says what and where."""

import time
from itertools import pairwise
from pathlib import Path

import yaml
from cli_cells import message, run

from otf_core.files.strict_yaml import value_text


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
