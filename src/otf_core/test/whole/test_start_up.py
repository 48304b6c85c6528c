# SPDX-License-Identifier: Apache-2.0
"""What a command loads: what costs a tenth of a second and more only where it is used."""

import subprocess
import sys
from pathlib import Path

import pytest
from cli_cells import write_points

from otf_core.cli import _parser
from otf_core.prediction.calibration_document import load_tables

BAG = Path(__file__).resolve().parents[4] / 'bags/y-carries-the-table'
NUMBERS = {'numpy', 'scipy', 'yaml'}
CONTAINERS = {'mcap', 'rosbags', 'zstandard', 'lz4'}
SELDOM = {
    'scipy.stats',
    'scipy.interpolate',
    'scipy.optimize',
    'scipy.signal',
    'mcap.writer',
}
"""What a calibration needs in special cases only, or never."""


def loaded(*words):
    """Names of all modules that a command line has loaded at its end."""
    code = (
        'import atexit, sys; atexit.register(lambda: print("", *sys.modules, sep="\\n")); '
        'from otf_core.cli import main; sys.exit(main())'
    )
    command = [sys.executable, '-c', code, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    names = set(done.stdout.split())
    assert 'otf_core.cli' in names
    return names


@pytest.mark.parametrize('verb', [[], *([v] for v in _parser().verbs)], ids=' '.join)
def test_help_loads_no_numbers_and_no_bags(verb):
    assert not loaded(*verb, '--help') & (NUMBERS | CONTAINERS)


def test_calibration_and_prediction_load_no_wide_module_they_can_do_without(tmp_path):
    machine, out, errors = BAG / 'machine.yaml', tmp_path / 'out', tmp_path / 'errors.csv'
    names = loaded('calibrate', BAG / 'bag', '--machine', machine, '--out', out)
    assert {'numpy', 'scipy', 'mcap'} <= names and not names & SELDOM
    tables = out / 'error_tables.json'
    assert load_tables(tables).driven
    points = write_points(tmp_path / 'points.csv', [[0.1, 0.1, -0.1]])
    names = loaded('predict', '--tables', tables, '--points', points, '--out', errors)
    assert errors.exists() and 'numpy' in names
    assert not names & (CONTAINERS | {'scipy', 'yaml', 'threadpoolctl'})
