# SPDX-License-Identifier: Apache-2.0
"""The scripts in examples/: short, of public names only, and what they print is right."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import otf_core

ROOT = Path(__file__).resolve().parents[4]
SCRIPTS = sorted((ROOT / 'examples').glob('*.py'))
every_script = pytest.mark.parametrize('script', SCRIPTS, ids=lambda s: s.stem)


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a script in an empty folder; returns what it printed."""

    def run(name, *arguments):
        script = ROOT / 'examples' / f'{name}.py'
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, 'argv', [str(script), *map(str, arguments)])
        runpy.run_path(str(script), run_name='__main__')
        return capsys.readouterr().out

    return run


def numbers(text, words):
    """Numbers in the line that has these words."""
    line = next(line for line in text.splitlines() if words in line)
    return [float(n) for n in re.findall(r'[-+]?\d+(?:\.\d+)?', line)]


def test_there_are_five_and_this_file_runs_them_all():
    text = Path(__file__).read_text()
    assert len(SCRIPTS) == 5
    assert all(f"run('{script.stem}'" in text for script in SCRIPTS)


@every_script
def test_script_is_short_and_says_how_to_run_it(script):
    text = script.read_text()
    assert len(text.splitlines()) < 60
    assert f'python examples/{script.name}' in ast.get_docstring(ast.parse(text))


@every_script
def test_script_uses_public_names_only(script):
    imported, used = set(), set()
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module)
        elif isinstance(node, ast.Attribute) and getattr(node.value, 'id', '') == 'otf_core':
            used.add(node.attr)
    assert imported <= {'otf_core', 'numpy', 'pathlib', 'sys'}
    assert used <= set(otf_core.__all__)


def test_calibrate_a_bag(run, tmp_path):
    said = run('calibrate_a_bag')
    before, after = numbers(said, 'mean distance')
    assert after < 0.02 * before and 'do not use' not in said
    file = tmp_path / 'results/error_tables.json'
    value, u = numbers(said, 'squareness C0Y')[-2:]
    told = json.loads(file.read_text())['squareness']['C0Y']
    assert (value, u) == pytest.approx((1e6 * told['value'], 1e6 * told['u']), abs=0.006)
    truth = ROOT / 'bags/y-carries-the-table/truth.json'
    q = np.random.default_rng(8).uniform([-0.15, -0.1, -0.25], [0.15, 0.15, 0.0], (200, 3))
    true_error, found = (otf_core.predict(tables, q).error for tables in (truth, file))
    left = otf_core.without_rigid_motion(found - true_error, q)
    assert np.linalg.norm(left, axis=1).mean() < 0.02 * np.linalg.norm(true_error, axis=1).mean()


def test_diagnose_a_run(run):
    said = run('diagnose_a_run')
    assert said.startswith('explained')
    value, u = numbers(said, 'B_X =')
    assert abs(value - 4.0) < 3 * u


def test_predict_at_points(run):
    said = run('predict_at_points')
    file = ROOT / 'bags/y-carries-the-table/truth.json'
    tables = otf_core.load_tables(file).tables
    corner = otf_core.predict(file, [tables.machine.lower]).error[0]
    rows = [line for line in said.splitlines() if '|' in line][1:]
    printed = [float(n) for n in rows[0].partition('|')[2].split()]
    np.testing.assert_allclose(printed, 1e6 * corner, atol=0.006)
    assert numbers(said, 'compensated once')[0] < 0.1
    assert len(rows) == 6


def test_plan_and_program(run, tmp_path):
    said = run('plan_and_program')
    points, length, seconds = numbers(said, 'points, ')
    plan = json.loads((tmp_path / 'plan/plan.json').read_text())
    (part,) = plan['parts']
    assert points == len(part['positions']) and seconds == pytest.approx(plan['duration'], abs=1)
    driven = np.linalg.norm(np.diff(part['positions'], axis=0), axis=1).sum()
    assert length == pytest.approx(driven, abs=0.06)
    assert (tmp_path / 'plan/otf_path_1.ngc').read_text().startswith('(')


def test_check_the_uncertainty(run):
    said = run('check_the_uncertainty')
    before, left = (numbers(said, words)[0] for words in ('mean error', 'left after'))
    assert 40 < before < 60 and left < 0.01 * before
    assert numbers(said, 'components within 2 u')[-1] >= 75
