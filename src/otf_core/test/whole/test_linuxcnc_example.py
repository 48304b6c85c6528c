# SPDX-License-Identifier: Apache-2.0
"""The example that closes the loop, with a stand-in for LinuxCNC; .ci/linuxcnc takes it."""

import re
import runpy
import shutil
import sys
from configparser import ConfigParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import otf_core

SCRIPT = Path(__file__).resolve().parents[4] / 'examples/linuxcnc/close_the_loop.py'
RATE = 100.0
"""Hz; of the stand-in and of the tracker."""


@pytest.fixture
def script(monkeypatch):
    """The script; ``run`` calls it with a command line."""
    names = runpy.run_path(str(SCRIPT), run_name='example')
    own = names['main'].__globals__

    def run(*words):
        monkeypatch.setattr(sys, 'argv', [str(SCRIPT), *map(str, words)])
        return own['main']()

    return SimpleNamespace(run=run, names=own)


def believed_positions(program):
    """Positions of a program from its pause on, shape (n, 3), m."""
    before, _, after = program.partition('M0')
    at = np.array([float(v) for v in re.findall(r'[XYZ](-?[\d.]+)', before.split('LOCK')[0])[-3:]])
    parts = []
    for line in after.splitlines():
        if line.startswith('G4'):
            parts.append(np.repeat(at[None], int(RATE * float(line[4:])), axis=0))
        elif 'G53' in line:
            *to, feed = (float(v) for v in re.findall(r'[XYZF](-?[\d.]+)', line))
            periods = max(2, int(RATE * np.linalg.norm(np.subtract(to, at)) / (feed / 60.0)))
            parts.append(at + np.linspace(0.0, 1.0, periods)[:, None] * np.subtract(to, at))
            at = np.array(to)
    return 1e-3 * np.concatenate(parts)


def motor_positions(believed, files):
    """Positions with what the .comp files of type 0 add: nominal minus actual."""
    ini = ConfigParser()
    ini.read_string(files['otf.ini'])  # refuses a section that comes twice
    motor = believed.copy()
    for joint in range(3):
        name = ini.get(f'JOINT_{joint}', 'COMP_FILE', fallback=None)
        if name:
            assert ini.get(f'JOINT_{joint}', 'COMP_FILE_TYPE') == '0'
            rows = [line.split() for line in files[name].splitlines() if line[0] != '#']
            nominal, actual, _ = 1e-3 * np.array(rows, float).T
            motor[:, joint] += np.interp(believed[:, joint], nominal, nominal - actual)
    return motor


def test_the_loop_leaves_what_the_export_forecast(script, tmp_path, monkeypatch, capsys):
    def stand_in(files, seconds):
        driven = {}
        for name in ('measured', 'other'):
            believed = believed_positions(files[f'{name}.ngc'])
            driven[name] = script.names['Drive'](motor_positions(believed, files), believed)
        return driven

    values = {'find_control': str, 'drive': stand_in, 'RATE': RATE, 'SERVO_PERIOD': 1 / RATE}
    for name, value in values.items():
        monkeypatch.setitem(script.names, name, value)
    assert script.run('--out', tmp_path / 'out') == 0
    said = capsys.readouterr().out
    rows = [re.findall(r'([\d.]+) um', line) for line in said.splitlines()]
    (found_before, found_after), (before, after), (forecast,) = (
        [float(v) for v in row] for row in rows if row
    )
    assert found_after == pytest.approx(forecast, rel=0.1) and found_after < 0.25 * found_before
    assert after < 0.25 * before
    assert (tmp_path / 'out/after/tables/error_tables.json').exists()


def test_the_example_fails_where_more_than_the_share_is_left(script, tmp_path, monkeypatch):
    monkeypatch.setitem(script.names, 'find_control', lambda: 'linuxcnc')
    monkeypatch.setitem(script.names, 'close_the_loop', lambda *given: (10e-6, 3e-6))
    assert script.run('--out', tmp_path / 'a', '--most-left', '0.31') == 0
    assert script.run('--out', tmp_path / 'b', '--most-left', '0.29') == 1


def test_the_example_uses_public_names_only():
    text = SCRIPT.read_text()
    used = set(re.findall(r'otf_core\.(\w+)', text)) - {'cli'}  # otf export
    assert used <= set(otf_core.__all__) and 'from otf_core' not in text


def test_without_linuxcnc_the_example_says_how_to_get_it(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, 'which', lambda name: None)
    assert script.run('--out', tmp_path / 'out') == 2
    assert 'apt-get install -y --no-install-recommends linuxcnc-uspace' in capsys.readouterr().err
