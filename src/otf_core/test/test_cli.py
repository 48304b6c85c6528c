# SPDX-License-Identifier: Apache-2.0
"""Offline commands from end to end: simulate, calibrate, predict; exit codes and messages."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from core_cells import CONTRACT_CHAINS, error_by_hand, some_machine

import otf_core
from otf_core import cli
from otf_core.files.writing import whole_file, write_text
from otf_core.model.evaluation import lattice, mean_length, without_rigid_motion
from otf_core.model.tables import MOTIONS, load_tables, tables_to_dict
from otf_core.sim.cell import random_tables

QUICK = ('--levels', '2', '--passes', '1', '--rate', '200', '--corner-dwell', '0.05',
         '--end-dwell', '3')  # fmt: skip


one_chain = pytest.mark.parametrize('done', CONTRACT_CHAINS[:1], indirect=True)


def run(*arguments):
    """Exit code of one command, in this process."""
    try:
        return cli.main([str(a) for a in arguments])
    except SystemExit as leaving:
        return leaving.code


def without_date(file):
    """Bytes of a result but for the moment of writing."""
    content = file.read_bytes()
    return re.sub(rb'"written": "[^"]*"', b'', content)


def read_csv(file):
    header, *rows = Path(file).read_text().splitlines()
    return header, np.array([[float(v) for v in row.split(',')] for row in rows])


def write_points(file, points):
    rows = [','.join(map(repr, row)) for row in np.asarray(points, float).tolist()]
    Path(file).write_text('\n'.join(['x,y,z', *rows]) + '\n')
    return file


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
    assert header == 'x,y,z,dx,dy,dz,u_dx,u_dy,u_dz,inside'
    np.testing.assert_array_equal(rows[:, :3], done.q)
    truth = np.array([error_by_hand(done.truth, point) for point in done.q])
    left = without_rigid_motion(rows[:, 3:6] - truth, done.q)
    # INTERFACES demands at most 2 % left
    assert mean_length(left) < 0.02 * mean_length(without_rigid_motion(truth, done.q))


def test_prediction_agrees_with_the_sum_of_the_contract_over_the_written_tables(done):
    tables = load_tables(done.tables).tables
    _, rows = read_csv(done.folder / 'errors.csv')
    expected = [error_by_hand(tables, point) for point in done.q]
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
    assert data['schema'] == 'otf-error-tables/1'
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


# ---------------------------------------------------------------- several runs

OFFSETS = ([0.0, 0.0, -0.15], [0.08, 0.0, -0.15], [0.0, 0.08, -0.15])
FEEDS = ('15000', '9000', '12000')


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    """Three bags of one machine: other target offsets, stations and feeds, stops at corners."""
    folder = tmp_path_factory.mktemp('runs')
    machine = some_machine(pitch=0.1)
    truth = tables_to_dict(random_tables(machine, 5e-5, np.random.default_rng(6)))
    (folder / 'truth.json').write_text(json.dumps(truth))
    for k, offset in enumerate(OFFSETS):
        data = machine.to_dict() | {'target_offset': offset}
        (folder / f'machine{k}.yaml').write_text(yaml.safe_dump(data))
        code = run('simulate', '--machine', folder / f'machine{k}.yaml', '--out',
                   folder / f'bag{k}', '--tables', folder / 'truth.json', '--seed', 20 + k,
                   '--feed', FEEDS[k], '--levels', '3', '--passes', '1', '--rate', '100',
                   '--corner-dwell', '0.3', '--end-dwell', '1')  # fmt: skip
        assert code == 0
    return folder


def solve_runs(folder, out, numbers, *options):
    """Calibrate some of the bags as one; content of the tables file."""
    bags = [folder / f'bag{k}' for k in numbers]
    machines = [word for k in numbers for word in ('--machine', folder / f'machine{k}.yaml')]
    options = ('--piece-length', '0.016', *options)
    assert run('calibrate', *bags, *machines, '--out', out, *options) == 0
    return json.loads((out / 'error_tables.json').read_text())


@pytest.fixture(scope='module')
def three(runs):
    """Folder of the calibration of all three bags as one."""
    solve_runs(runs, runs / 'three', (0, 1, 2))
    return runs / 'three'


@pytest.mark.parametrize(
    ('numbers', 'unseen'),
    [((0,), ['ECY', 'EAZ', 'EBZ', 'ECZ']), ((0, 1), ['EAZ'])],
)
def test_fewer_than_three_target_offsets_leave_motions_unseen(runs, tmp_path, numbers, unseen):
    data = solve_runs(runs, tmp_path, numbers)
    assert data['not_identifiable'] == unseen
    assert data['fit']['path_mae_after'] < 0.05 * data['fit']['path_mae_before']


def test_three_target_offsets_show_all_motions_as_they_are(runs, three):
    assert json.loads((three / 'error_tables.json').read_text())['not_identifiable'] == []
    tables = load_tables(three / 'error_tables.json').tables
    truth = load_tables(runs / 'truth.json').tables
    for name in ('ECY', 'EAZ', 'EBZ', 'ECZ'):
        table, node = tables.motions[name], truth.motions[name]
        true = node.value - np.interp(0.0, node.position, node.value)
        assert np.all(np.abs(table.value - true) <= 4 * table.u + 1e-12), name


def test_tables_file_and_summary_tell_of_every_run(three):
    data = json.loads((three / 'error_tables.json').read_text())
    assert [r['target_offset'] for r in data['runs']] == list(OFFSETS)
    assert [r['name'] for r in data['runs']] == ['bag0', 'bag1', 'bag2']
    assert data['alignment'] == data['runs'][0]['alignment']
    assert data['machine']['target_offset'] == OFFSETS[0]
    places = np.array([r['alignment']['translation'] for r in data['runs']])
    assert np.all(np.linalg.norm(np.diff(places, axis=0), axis=1) > 0.05)
    assert sum(r['samples'] for r in data['runs']) == data['fit']['samples']
    for entry in data['runs']:
        assert entry['coverage'] > 0.98
        assert entry['noise']['u_angle'] == pytest.approx([2e-6] * 2, rel=0.7)
    summary = (three / 'summary.txt').read_text()
    assert [line.split(':')[0] for line in summary.splitlines() if line.startswith('run ')] == [
        'run 1 (bag0)', 'run 2 (bag1)', 'run 3 (bag2)',
    ]  # fmt: skip


def test_stops_of_several_runs_are_solved_as_one(runs, tmp_path):
    data = solve_runs(runs, tmp_path, (0, 1, 2), '--method', 'standstill')
    assert data['not_identifiable'] == []
    assert len(data['runs']) == 3
    assert data['fit']['path_mae_after'] < 0.05 * data['fit']['path_mae_before']


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'chain': 'w-Y-b-X-Z-t'}, 'chain: w-Y-b-X-Z-t, but w-b-X-Y-Z-t'),
        ({'axes': {'Y': {'max': 0.26}}}, 'axes: Y: max: 0.26, but 0.25'),
        ({'axes': {'Z': {'table_pitch': 0.05}}}, 'axes: Z: table_pitch: 0.05, but 0.1'),
    ],
)
def test_bags_of_different_machines_are_refused_naming_bag_and_key(
    runs, tmp_path, capsys, change, words
):
    data = yaml.safe_load((runs / 'machine1.yaml').read_text())
    for axis, part in change.get('axes', {}).items():
        data['axes'][axis] |= part
    data['chain'] = change.get('chain', data['chain'])
    (tmp_path / 'other.yaml').write_text(yaml.safe_dump(data))
    bags, out = (runs / 'bag0', runs / 'bag1'), tmp_path / 'out'
    arguments = ('--machine', runs / 'machine0.yaml', '--machine', tmp_path / 'other.yaml')
    assert run('calibrate', *bags, *arguments, '--out', out) == 2
    message = capsys.readouterr().err
    assert message.count('\n') == 1
    assert message.startswith(f'otf calibrate: {runs / "bag1"}: {words}')
    assert not out.exists()


def test_bag_that_does_not_fit_its_machine_is_named_among_several(runs, tmp_path, capsys):
    data = yaml.safe_load((runs / 'machine0.yaml').read_text())
    data['axes']['X']['max'] = 0.2
    (tmp_path / 'small.yaml').write_text(yaml.safe_dump(data))
    arguments = ('--machine', tmp_path / 'small.yaml', '--out', tmp_path / 'out')
    assert run('calibrate', runs / 'bag1', runs / 'bag2', *arguments) == 3
    message = capsys.readouterr().err
    assert message.count('\n') == 1
    assert str(runs / 'bag1') in message
    assert str(runs / 'bag2') not in message


# ---------------------------------------------------------------- simulate a written plan


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    """Folder with machine.yaml and the plan of a time budget."""
    folder = tmp_path_factory.mktemp('planned')
    (folder / 'machine.yaml').write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    code = run('plan', '--machine', folder / 'machine.yaml', '--out', folder / 'plan', '--passes',
               '1', '--levels', '2', '--corner-dwell', '0.3', '--rate', '100')  # fmt: skip
    assert code == 0
    return folder


def test_simulated_plan_drives_its_path_feeds_and_dwells_before_its_tracker(planned, tmp_path):
    from otf_core.bags.bag import read_bag

    plan = json.loads((planned / 'plan' / 'plan.json').read_text())
    code = run('simulate', '--machine', planned / 'machine.yaml', '--path',
               planned / 'plan' / 'plan.json', '--out', tmp_path / 'bag', '--rate', '100',
               '--error-size', '0')  # fmt: skip
    assert code == 0
    bag = read_bag(tmp_path / 'bag')
    np.testing.assert_array_equal(bag.path.points, plan['path'])
    assert bag.samples.time[-1] == pytest.approx(plan['duration'], abs=0.02)
    distance = np.linalg.norm(bag.samples.xyz[0])
    start = np.array(plan['path'][0]) - plan['assumed']['tracker_place']
    assert distance == pytest.approx(np.linalg.norm(start), abs=1e-4)


def test_dwells_of_a_plan_may_be_made_longer_for_the_standstill_method(planned, tmp_path):
    common = ('--machine', planned / 'machine.yaml', '--out')
    code = run('simulate', *common, tmp_path / 'bag', '--path', planned / 'plan' / 'plan.json',
               '--rate', '100', '--corner-dwell', '0.5')  # fmt: skip
    assert code == 0
    assert run('calibrate', tmp_path / 'bag', *common, tmp_path / 'out', '--method',
               'standstill') == 0  # fmt: skip


@pytest.mark.parametrize(
    ('content', 'options', 'words'),
    [
        ('{"a": 1}', (), "plan: no plan; expected the schema 'otf-plan/1'"),
        ('{"schema": "otf-plan/1"}', (), 'plan: path: expected n x 3 numbers'),
        ('{"schema": "otf-plan/1", "path": [[0,0,0],[0.1,0,0]]}', (), 'plan: feed: expected 1'),
        ('{"schema": "otf-plan/1", "path": [[0,0,0],[0.1,0,0]], "feed": [0], "dwell": [1, 1]}',
         (), 'plan: feed: leg 0: must be above 0'),
        ('{"schema": "otf-plan/1", "path": [[0,0,0],[9,0,0]], "feed": [1], "dwell": [1, 1]}',
         (), 'plan: path: point 1 leaves the range of axis X'),
        ('{"schema": "otf-plan/1", "path": [[0,0,0],[0.1,0,0]], "feed": [1], "dwell": [1, 1]}',
         ('--feed', '3000'), '--feed: '),
        ('{"schema', (), 'plan: not valid JSON'),
        ('G1 X0 Y0', (), 'plan: line 1: expected the header x,y,z'),
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
    ['', 'x,y\n1,2\n', 'x,y,z\n', 'x,y,z\n1,2\n', 'x,y,z\n1,2,a\n', 'x,y,z\n1,2,nan\n',
     'x;y;z\n1;2;3\n'],
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


# ---------------------------------------------------------------- exit codes and messages


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
        (('plan', '--machine', 'M', '--out', 'OUT', '--passes', '0'), '--passes'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--passes', '1.5'), '--passes'),
        (('plan', '--machine', 'M', '--out', 'OUT', '--margin', '0.1'), 'margin'),
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
    named = [str(a).replace('OUT', 'out') for a in arguments]
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
    assert 'quality gate failed: coverage' in capsys.readouterr().err
    assert json.loads((out / 'error_tables.json').read_text())['failed_gates']


@one_chain
def test_bag_is_not_written_over(done, capsys):
    arguments = ('--machine', done.folder / 'machine.yaml', '--out', done.folder / 'bag')
    before = next((done.folder / 'bag').glob('*.mcap')).read_bytes()
    assert run('simulate', *arguments) == 2
    assert 'exists already' in capsys.readouterr().err
    assert next((done.folder / 'bag').glob('*.mcap')).read_bytes() == before


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
    assert run('plan', '--machine', machine_file, '--out', out, '--passes', '1') == 0
    header, points = read_csv(out / 'path.csv')
    assert header == 'x,y,z'
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert f'{len(points)} points, {length:.2f} m' in capsys.readouterr().out


def test_feed_is_in_millimetres_per_minute(machine_file, capsys):
    def seconds(feed):
        out = machine_file.parent / 'plan'
        run('plan', '--machine', machine_file, '--out', out, '--feed', feed,
            '--corner-dwell', '0', '--end-dwell', '0', '--passes', '1')  # fmt: skip
        words = capsys.readouterr().out.replace(':', ' ').split()
        return float(words[words.index('s') - 1]), float(words[words.index('m,') - 1])

    # 600 mm/min is 0.01 m/s: slow enough that only the length counts
    time, length = seconds(600)
    assert time == pytest.approx(length / 0.01, rel=0.02)


def test_help_is_there_for_every_verb(capsys):
    for verb in ('calibrate', 'predict', 'plan', 'simulate'):
        assert run(verb, '--help') == 0
        assert '--out' in capsys.readouterr().out


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
