# SPDX-License-Identifier: Apache-2.0
"""Every verb: examples that parse, help of one screen, one JSON object on stdout."""

import shlex
import shutil
import subprocess

import pytest
from cli_cells import run

from otf_core.cli import _parser
from otf_core.cli.parser import SHELLS
from otf_core.cli.verbs import EXAMPLES, VERBS

VERB_NAMES = tuple(_parser().verbs)


def test_what_the_launcher_lists_are_the_verbs():
    assert set(VERBS) == set(EXAMPLES) == set(VERB_NAMES)


@pytest.mark.parametrize('verb', VERB_NAMES)
def test_examples_of_the_help_are_command_lines(verb):
    parser = _parser()
    assert all(line in parser.verbs[verb].format_help() for line in EXAMPLES[verb])
    for line in EXAMPLES[verb]:
        program, *words = shlex.split(line.partition(' > ')[0])
        assert program == 'otf' and parser.parse_args(words).verb == verb


@pytest.mark.parametrize('verb', VERB_NAMES)
def test_help_fits_a_screen(verb, monkeypatch):
    monkeypatch.setenv('COLUMNS', '80')
    assert _parser().verbs[verb].format_help().count('\n') <= 40


@pytest.mark.parametrize('shell', SHELLS)
def test_a_script_completes_verbs_options_and_choices(shell, capsys):
    assert run('completion', shell) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in (*VERB_NAMES, 'standstill'))
    assert '--config' in script or shell == 'tcsh'
    if shell == 'bash' and shutil.which('bash'):
        subprocess.run(['bash', '-n'], input=script, text=True, check=True)
