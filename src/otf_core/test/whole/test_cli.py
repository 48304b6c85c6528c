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
from core_cells import CONTRACT_CHAINS, error_of, some_machine

import otf_core
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.motions import MOTIONS
from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables

QUICK = ({'levels': 2, 'passes': 1, 'rate': 200, 'corner_dwell': 0.05, 'end_dwell': 3},)


one_chain = pytest.mark.parametrize('done', CONTRACT_CHAINS[:1], indirect=True)


@pytest.fixture(scope='module', params=CONTRACT_CHAINS)
def done(request, tmp_path_factory):
    """Truth, bag, calibration and prediction of one chain of the contract."""
    folder = tmp_path_factory.mktemp('cell')
    machine = some_machine(request.param, pitch=0.05)
    truth = random_tables(machine, 5e-5, np.random.default_rng(len(request.param)))
    (folder / 'machine.yaml').write_text(yaml.safe_dump(machine.to_dict()))
    (folder / 'truth.json').write_text(json.dumps(tables_to_dict(truth)))
    seed = 1 + CONTRACT_CHAINS.index(request.param)
    codes = [
        run('simulate', '--machine', folder / 'machine.yaml', '--tables', folder / 'truth.json',
            '--out', folder / 'bag', '--seed', seed, *QUICK),
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


def test_commands_end_well(done):
    assert done.codes == [0, 0, 0]


def test_prediction_leaves_less_than_two_per_cent_of_the_truth(done):
    header, rows = read_csv(done.folder / 'errors.csv')
    assert header == 'x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,u_run_dx,u_run_dy,u_run_dz,inside'
    np.testing.assert_array_equal(rows[:, :3], done.q)
    truth = error_of(done.truth, done.q)
    left = without_rigid_motion(rows[:, 3:6] - truth, done.q)
    # the contract demands at most 2 % left
    assert mean_length(left) < 0.02 * mean_length(without_rigid_motion(truth, done.q))


def test_prediction_agrees_with_the_sum_of_the_contract_over_the_written_tables(done):
    tables = load_tables(done.tables).tables
    _, rows = read_csv(done.folder / 'errors.csv')
    expected = error_of(tables, done.q)
    # the contract asks for 0.01 um; both are plain sums
    np.testing.assert_allclose(rows[:, 3:6], expected, atol=1e-15)


def test_uncertainty_of_predictions_is_positive_and_of_the_size_of_the_errors_left(done):
    _, rows = read_csv(done.folder / 'errors.csv')
    u = rows[:, 6:9]
    # zero only where the gauge fixes everything: at the zero point of all axes
    assert np.sum(u == 0) <= 3
    assert np.all(u < 2e-5)
    assert np.median(u) > 1e-8


def test_tables_file_has_all_the_contract_asks_for(done):
    data = json.loads(done.tables.read_text())
    assert {'schema', 'machine', 'motions', 'squareness', 'alignment', 'fit'} <= set(data)
    assert data['schema'] == 'otf-error-tables/2'
    assert data['machine'] == done.machine.to_dict()
    assert {
        'samples', 'used', 'unknowns', 'rank', 'path_mae_before', 'path_mae_after', 'residual_rms',
    } <= set(data['fit'])  # fmt: skip
    rotation = np.array(data['alignment']['rotation'])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert len(data['alignment']['translation']) == 3
    for name in MOTIONS:
        entry = data['motions'][name]
        assert entry['identifiable'] == (name not in data['not_identifiable'])
        if not entry['identifiable']:
            assert not any(entry['value'])
    fit = data['fit']
    assert fit['path_mae_after'] < 0.05 * fit['path_mae_before']
    assert fit['used'] < fit['samples']


def test_repetition_gives_the_same_bits(done, tmp_path):
    arguments = (done.folder / 'bag', '--machine', done.folder / 'machine.yaml')
    assert run('calibrate', *arguments, '--out', tmp_path / 'again') == 0
    files = sorted(f.name for f in done.tables.parent.iterdir())
    assert files == sorted(f.name for f in (tmp_path / 'again').iterdir())
    files.remove('manifest.json')  # holds the hash of a file with a date in it
    for name in files:
        again, first = (folder / name for folder in (tmp_path / 'again', done.tables.parent))
        assert without_date(again) == without_date(first), name


@one_chain
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


@one_chain
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


@one_chain
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


@one_chain
def test_edited_nodes_beside_an_old_covariance_still_predict(one):
    one.data['motions']['EYY'] = {'position': [0.0, 0.25], 'value': [0.0, 1e-5], 'u': [0.0, 1e-6]}
    code, rows = one.predict(one.data)
    assert code == 0
    assert np.all(np.isfinite(rows))


@pytest.mark.parametrize(
    'points',
    ['', 'x,y\n1,2\n', 'x,y,z\n', 'x,y,z\n1,2\n', 'x,y,z\n1,2,a\n', 'x,y,z\n1,2,nan\n'],
)  # fmt: skip
@one_chain
def test_wrong_points_are_named(one, capsys, points):
    one.points.write_text(points)
    assert one.predict(one.data)[0] == 2
    message = capsys.readouterr().err
    assert message.startswith('otf predict: ')
    assert 'points.csv' in message
    assert message.count('\n') == 1
    assert not (one.folder / 'errors.csv').exists()


# ---------------------------------------------------------------- the same bag otherwise


@one_chain
def test_bag_of_another_machine_is_exit_code_3_and_leaves_nothing(done, tmp_path, capsys):
    data = done.machine.to_dict()
    data['axes']['X']['max'] = 0.2
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump(data))
    out = tmp_path / 'out'
    arguments = (done.folder / 'bag', '--machine', tmp_path / 'machine.yaml', '--out', out)
    assert run('calibrate', *arguments) == 3
    message = capsys.readouterr().err
    assert 'axis X' in message
    assert message.count('\n') == 1
    assert not out.exists()


@one_chain
def test_bag_is_not_written_over(done, capsys):
    arguments = ('--machine', done.folder / 'machine.yaml', '--out', done.folder / 'bag')
    before = next((done.folder / 'bag').glob('*.mcap')).read_bytes()
    assert run('simulate', *arguments) == 2
    assert 'exists already' in capsys.readouterr().err
    assert next((done.folder / 'bag').glob('*.mcap')).read_bytes() == before


@one_chain
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
