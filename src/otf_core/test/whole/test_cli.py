# SPDX-License-Identifier: Apache-2.0
"""Offline commands from end to end: simulate, calibrate, predict."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from cli_cells import read_csv, run, without_date, write_points
from core_cells import error_of, some_machine

import otf_core
from otf_core.model.evaluation import lattice
from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables

QUICK = ({'levels': 2, 'passes': 1, 'rate': 200, 'corner_dwell': 0.05, 'end_dwell': 3},)


@pytest.fixture(scope='module')
def done(tmp_path_factory):
    """Truth, bag, calibration and prediction of one chain of the contract."""
    folder = tmp_path_factory.mktemp('cell')
    machine = some_machine('w-Y-b-X-Z-t', pitch=0.05)
    truth = random_tables(machine, 5e-5, np.random.default_rng(11))
    (folder / 'machine.yaml').write_text(yaml.safe_dump(machine.to_dict()))
    (folder / 'truth.json').write_text(json.dumps(tables_to_dict(truth)))
    codes = [
        run('simulate', '--machine', folder / 'machine.yaml', '--tables', folder / 'truth.json',
            '--out', folder / 'bag', '--seed', 1, *QUICK),
        run('calibrate', folder / 'bag', '--machine', folder / 'machine.yaml', '--out',
            folder / 'out'),
    ]  # fmt: skip
    q = lattice(machine, 5)
    points = write_points(folder / 'points.csv', q)
    tables = folder / 'out' / 'error_tables.json'
    codes.append(run('predict', '--tables', tables, '--points', points, '--out',
                     folder / 'errors.csv'))  # fmt: skip
    return SimpleNamespace(
        folder=folder, machine=machine, truth=truth, codes=codes, q=q, tables=tables
    )


def test_prediction_agrees_with_the_sum_of_the_contract_over_the_written_tables(done):
    tables = load_tables(done.tables).tables
    _, rows = read_csv(done.folder / 'errors.csv')
    expected = error_of(tables, done.q)
    # the contract asks for 0.01 um; both are plain sums
    np.testing.assert_allclose(rows[:, 3:6], expected, atol=1e-15)


def test_simulation_repeats_bit_by_bit_and_differs_by_seed(done, tmp_path):
    common = ('simulate', '--machine', done.folder / 'machine.yaml', '--tables',
              done.folder / 'truth.json', *QUICK)  # fmt: skip
    content = {}
    for name, seed in (('same', 1), ('other', 2)):
        assert run(*common, '--out', tmp_path / name, '--seed', seed) == 0
        content[name] = next((tmp_path / name).glob('*.mcap')).read_bytes()
    assert content['same'] == next((done.folder / 'bag').glob('*.mcap')).read_bytes()
    assert content['other'] != content['same']


# ---------------------------------------------------------------- predict


@pytest.fixture
def one(done, tmp_path):
    """Copy of the tables of the first chain that a test may edit."""
    points = write_points(tmp_path / 'points.csv', [[0.1, 0.1, -0.1], [0.3, 0.25, -0.2]])
    data = json.loads(done.tables.read_text())

    def predict(content):
        (tmp_path / 'edited.json').write_text(json.dumps(content))
        code = run('predict', '--tables', tmp_path / 'edited.json', '--points', points,
                   '--out', tmp_path / 'errors.csv', '--overwrite')  # fmt: skip
        return code, read_csv(tmp_path / 'errors.csv')[1] if code == 0 else None

    return SimpleNamespace(data=data, predict=predict, folder=tmp_path, points=points)


def test_prediction_uses_the_covariance_of_the_file(one, capsys):
    code, with_covariance = one.predict(one.data)
    assert code == 0
    assert capsys.readouterr().err == ''
    del one.data['covariance']
    code, without = one.predict(one.data)
    assert code == 0
    assert 'independent' in capsys.readouterr().err
    np.testing.assert_array_equal(with_covariance[:, :6], without[:, :6])
    assert np.all(without[:, 6:] > 0)
    assert not np.allclose(with_covariance[:, 6:9], without[:, 6:9], rtol=0.05)


def test_tables_edited_by_hand_predict_what_they_say(one):
    _, before = one.predict(one.data)
    del one.data['covariance']
    value = one.data['motions']['EXX']['value']
    one.data['motions']['EXX']['value'] = [v + 1e-5 for v in value]
    one.data['motions']['EYY'] = {'position': [0.0, 0.25], 'value': [0.0, 0.0], 'u': [0.0, 0.0]}
    code, after = one.predict(one.data)
    assert code == 0
    np.testing.assert_allclose(after[:, 3] - before[:, 3], 1e-5, atol=1e-15)
    np.testing.assert_allclose(after[:, 5], before[:, 5], atol=1e-18)


def test_edited_nodes_beside_an_old_covariance_still_predict(one):
    one.data['motions']['EYY'] = {'position': [0.0, 0.25], 'value': [0.0, 1e-5], 'u': [0.0, 1e-6]}
    code, rows = one.predict(one.data)
    assert code == 0
    assert np.all(np.isfinite(rows))


# ---------------------------------------------------------------- the same bag otherwise


def test_tables_do_not_depend_on_the_number_of_threads(done, tmp_path):
    written = []
    for threads in ('1', '2'):
        out = tmp_path / threads
        subprocess.run(
            [sys.executable, '-m', 'otf_core.cli', 'calibrate', done.folder / 'bag', '--machine',
             done.folder / 'machine.yaml', '--out', out],
            env={**os.environ, 'OPENBLAS_NUM_THREADS': threads,
                 'PYTHONPATH': str(Path(next(iter(otf_core.__path__))).parent)},
            check=True, capture_output=True,
        )  # fmt: skip
        written.append(without_date(out / 'error_tables.json'))
    assert written[0] == written[1]
