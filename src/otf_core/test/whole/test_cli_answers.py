# SPDX-License-Identifier: Apache-2.0
"""Every verb: examples that parse, help of one screen, one JSON object on stdout."""

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from cli_cells import run, write_points

from otf_core.cli import _parser
from otf_core.cli.parser import SHELLS
from otf_core.cli.verbs import EXAMPLES, VERBS

ROOM = Path(__file__).resolve().parents[4] / 'bags/y-carries-the-table'
MACHINE = ('--machine', ROOM / 'machine.yaml')
STOPS = ROOM.parent / 'x-and-y-carry-the-table/bag'
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


@pytest.fixture
def asked(tmp_path, capsys):
    """Exit code, object and messages of a verb with --json, and its --out."""

    def of(verb, *words, out='out'):
        code = run(verb, *words, '--out', tmp_path / out, '--json')
        shown = capsys.readouterr()
        return code, json.loads(shown.out), shown.err

    return of


def test_the_object_of_a_calibration_is_its_file_and_comes_as_checked(asked, tmp_path, capsys):
    assert run('check', ROOM / 'bag', *MACHINE, '--json') == 0
    expected = json.loads(capsys.readouterr().out)
    code, answer, words = asked('calibrate', ROOM / 'bag', *MACHINE)
    assert code == 0 and words.endswith(f'open {tmp_path / "out/report.html"}\n')
    for key in ('u', 'u_run'):
        forecast, stated = (found[key] for found in (expected['forecast'], answer['headline']))
        assert 0.5 < forecast['mean'] / stated['mean'] < 2.0
    assert expected['coverage'] == pytest.approx(answer['fit']['coverage'], abs=0.01)
    written = json.loads((tmp_path / 'out/error_tables.json').read_text())
    assert answer['motions'] == written['motions'] and answer['verb'] == 'calibrate'
    assert sorted(answer['files']) == sorted(
        p.name for p in (tmp_path / 'out').iterdir() if p.name != 'manifest.json'
    )
    points = write_points(tmp_path / 'points.csv', [[0.1, 0.1, -0.1], [0.2, 0.0, -0.2]])
    tables = ('--tables', tmp_path / 'out/error_tables.json', '--points', points)
    code, answer, _ = asked('predict', *tables, out='errors.csv')
    rows = np.genfromtxt(tmp_path / 'errors.csv', delimiter=',', names=True)
    assert [p['dx'] for p in answer['points']] == rows['dx'].tolist()
    assert [str(p['inside']) for p in answer['points']] == ['1', '0']


def test_objects_of_the_other_quick_verbs(asked, tmp_path):
    machine = ROOM / 'machine.yaml'
    code, answer, _ = asked('noise', STOPS, out='noise')
    assert code == 0 and answer == {
        'verb': 'noise',
        **json.loads((tmp_path / 'noise/noise.json').read_text()),
        'out': str(tmp_path / 'noise'),
        'files': answer['files'],
    }
    path = write_points(tmp_path / 'path.csv', [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, -0.1]])
    code, answer, words = asked('simulate', '--machine', machine, '--path', path, '--rate', '50')
    assert code == 0 and f'{answer["samples"]} samples' in words
    code, answer, words = asked('plan', '--machine', machine, '--path', path, out='plan')
    assert code == 0 and answer['schema'] == 'otf-plan/2' and 'no NC program' in words
