# SPDX-License-Identifier: Apache-2.0
"""Pairs of nominal and measured positions, from machines written down in closed form."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import otf_core
from otf_core import cli
from otf_core.errors import InputError
from otf_core.model.machine import Machine

NOISE = 2e-6


def plotter(**more: object) -> Machine:
    axis = {'min': -0.3, 'max': 0.3, 'table_pitch': 0.05}
    return Machine.from_dict({
        'name': 'plotter', 'chain': 'w-b-X-Y-t', 'axes': {'X': axis, 'Y': axis},
        'target_offset': [0.0, 0.0, 0.0], 'tracker': {'u_range': 5e-6, 'u_angle': 1e-6}, **more,
    })  # fmt: skip


def positioning(x):
    return 12e-6 * np.sin(9.0 * x) + 30e-6 * x**2


def yaw(x):
    return 25e-6 * np.tanh(4.0 * x)


def straightness(y):
    return 8e-6 * np.cos(7.0 * y)


def where_it_went(x, y, seed):
    """Turned and shifted points of the machine, with noise: X carries Y, so that its yaw acts."""
    turn = yaw(x)
    actual = np.stack([
        x + positioning(x) + straightness(y) - np.sin(turn) * y,
        y + np.cos(turn) * 0.0 + 5e-6 * np.sin(5.0 * y),
    ])  # fmt: skip
    c, s = np.cos(0.4), np.sin(0.4)
    measured = np.array([[c, -s], [s, c]]) @ actual + np.array([[0.7], [-0.2]])
    return measured + np.random.default_rng(seed).normal(0.0, NOISE, measured.shape)


def write(path: Path, head: str, *columns) -> Path:
    rows = [
        ','.join('' if v != v else f'{v:.9f}' for v in row) for row in zip(*columns, strict=True)
    ]
    path.write_text('\n'.join([head, *rows]) + '\n')
    return path


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    x, y = np.random.default_rng(5).uniform(-0.29, 0.29, (2, 500))
    u, v = where_it_went(x, y, 6)
    rng = np.random.default_rng(7)
    u[rng.integers(0, 500, 25)] = np.nan  # single components that were not measured
    path = tmp_path_factory.mktemp('pairs') / 'pairs.csv'
    write(
        path, 'X_measured [mm],Y [mm],X [mm],Y_measured [mm]', 1e3 * u, 1e3 * y, 1e3 * x, 1e3 * v
    )
    return otf_core.calibrate(otf_core.read_point_pairs(path, plotter()), method='points')


def test_tables_are_those_of_the_machine(measured) -> None:
    table = measured.tables.motions['ECX']
    x = table.position
    off = table.value - yaw(x)
    off -= off.mean()  # a constant yaw is the pose and the squareness
    assert np.sqrt(np.mean(off**2)) < 3e-6


def test_prediction_and_its_u(measured) -> None:
    x, y = np.random.default_rng(8).uniform(-0.28, 0.28, (2, 400))
    nominal = np.stack([x, y, np.zeros_like(x)], axis=1)
    predicted = otf_core.predict(measured, nominal)
    actual = np.stack([positioning(x) + straightness(y) - yaw(x) * y, 5e-6 * np.sin(5.0 * y)])
    off = actual.T - predicted.error[:, :2]
    one, none = np.ones_like(x), np.zeros_like(x)
    plane = np.stack([np.stack([one, none, -y], axis=1), np.stack([none, one, x], axis=1)])
    fitted = np.linalg.lstsq(plane.reshape(-1, 3), off.T.ravel(), rcond=None)[0]
    off -= (plane @ fitted).T
    assert np.sqrt(np.mean(off**2)) < 1e-6
    assert np.mean(np.abs(off) < 2.0 * predicted.u_run[:, :2]) > 0.85


def test_hidden_motions_are_named_and_noise_is_found(measured) -> None:
    assert {'EZX', 'EZY', 'EAX', 'EBX', 'EAY', 'EBY', 'ECY'} <= set(measured.not_identifiable)
    assert {'EXX', 'EYX', 'ECX', 'EXY', 'EYY'}.isdisjoint(measured.not_identifiable)
    run = measured.runs[0]
    level = np.hypot(run.noise.range.level, run.misfit.independent)
    assert level == pytest.approx(NOISE, rel=0.1)
    assert measured.fit.samples == 500 and measured.method == 'points'


def test_repeated_points_state_the_noise_before_anything_is_fitted(tmp_path) -> None:
    x, y = np.repeat(np.random.default_rng(1).uniform(-0.29, 0.29, (2, 30)), 3, axis=1)
    u, v = where_it_went(x, y, 2)
    path = write(tmp_path / 'p.csv', 'Nom X,Nom Y,Meas X,Meas Y', x, y, u, v)
    run = otf_core.read_point_pairs(path, plotter())[0]
    from otf_core.pieces.point_pairs import reduce_pairs

    assert reduce_pairs(run).noise.range.level == pytest.approx(NOISE, rel=0.25)


def test_runs_have_a_pose_each(tmp_path) -> None:
    x, y = np.random.default_rng(3).uniform(-0.29, 0.29, (2, 300))
    u, v = where_it_went(x, y, 4)
    second = np.arange(300) >= 150
    u[second] += 0.4
    rows = [
        f'{a},{b},{c},{d},{"late" if k else "early"}'
        for a, b, c, d, k in zip(x, y, u, v, second, strict=True)
    ]
    path = tmp_path / 'p.csv'
    path.write_text('\n'.join(['x,y,x_measured,y_measured,run', *rows]))
    runs = otf_core.read_point_pairs(path, plotter())
    assert [len(run.q) for run in runs] == [150, 150]
    result = otf_core.calibrate(runs, method='points')
    assert result.fit.residual_rms < 1.2 * np.sqrt(2) * NOISE


@pytest.mark.parametrize(
    ('head', 'wrong'),
    [
        ('x,y,a,b', 'x_measured'),
        ('x,z,x_measured,y_measured', 'nominal Y'),
        ('x,y,x_nom,y_nom,x_measured,y_measured,x_measured,y_measured', 'x_measured'),
        ('x_ft,y_ft,x_measured_ft,y_measured_ft', 'ft'),
    ],
)
def test_other_tables_are_refused(tmp_path, head: str, wrong: str) -> None:
    columns = np.random.default_rng(1).uniform(-0.2, 0.2, (head.count(',') + 1, 50))
    with pytest.raises(InputError, match=wrong):
        otf_core.read_point_pairs(write(tmp_path / 'p.csv', head, *columns), plotter())


def test_lengths_without_a_unit_are_in_mm_by_their_size(tmp_path) -> None:
    x, y = np.random.default_rng(5).uniform(-0.29, 0.29, (2, 50))
    u, v = where_it_went(x, y, 6)
    path = tmp_path / 'p.txt'
    rows = [f'{1e3 * a:9.3f} {1e3 * b:9.3f} {1e3 * c:9.3f} {1e3 * d:9.3f}'
            for a, b, c, d in zip(u, v, x, y, strict=True)]  # fmt: skip
    path.write_text('\n'.join(['Plate 7', '', '  Meas X    Meas Y     Nom X     Nom Y', *rows]))
    run = otf_core.read_point_pairs(path, plotter())[0]
    assert np.allclose(run.q, np.stack([x, y], axis=1), atol=1e-6)
    assert any('mm' in remark for remark in run.remarks)


def test_from_a_table_to_a_report_by_the_command(tmp_path) -> None:
    x, y = np.random.default_rng(5).uniform(-0.29, 0.29, (2, 300))
    u, v = where_it_went(x, y, 6)
    path = write(tmp_path / 'p.csv', 'x,y,x_measured,y_measured', x, y, u, v)
    machine = tmp_path / 'machine.yaml'
    machine.write_text(yaml.safe_dump(plotter().to_dict()))
    command = ['calibrate', str(path), '--method', 'points', '--machine', str(machine)]
    assert cli.main([*command, '--out', str(tmp_path / 'out')]) == 0
    found = json.loads((tmp_path / 'out' / 'error_tables.json').read_text())
    assert found['provenance']['method'] == 'points'
    assert not found['motions']['EZX']['identifiable'] and found['motions']['ECX']['identifiable']
    assert (tmp_path / 'out' / 'report.html').exists()
    assert cli.main([*command, '--path', str(path), '--out', str(tmp_path / 'no')]) == 2
    assert cli.main([*command, '--effects', 'auto', '--out', str(tmp_path / 'no')]) == 2


@pytest.mark.parametrize('size', [2e-4, 5e-3, 0.05])
def test_one_gross_error_costs_one_pair(size) -> None:
    x, y = np.random.default_rng(5).uniform(-0.29, 0.29, (2, 210))
    u, v = where_it_went(x, y, 6)
    u[17] += size
    measured = np.stack([u, v, np.full(210, np.nan)], axis=1)
    pairs = otf_core.PointPairs(plotter(), np.stack([x, y], axis=1), measured, ('tool',) * 210)
    result = otf_core.calibrate([pairs], method='points')
    assert 1 <= result.fit.outliers <= 3
    assert result.fit.residual_rms < 2.0 * np.sqrt(2) * NOISE


def test_words_in_place_of_a_measured_number_are_counted(tmp_path) -> None:
    x, y = np.random.default_rng(5).uniform(-0.29, 0.29, (2, 60))
    u, v = where_it_went(x, y, 6)
    path = write(tmp_path / 'p.csv', 'x,y,x_measured,y_measured', x, y, u, v)
    lines = path.read_text().splitlines()
    lines[7] = lines[7].rpartition(',')[0] + ',oops'
    path.write_text('\n'.join(lines))
    (run,) = otf_core.read_point_pairs(path, plotter())
    assert len(run.q) == 59 and run.left_out[0].first_line == 8
    path.write_text('\n'.join([lines[0], *(t.rpartition(',')[0] + ',oops' for t in lines[1:])]))
    with pytest.raises(InputError):
        otf_core.read_point_pairs(path, plotter())


HEADS = (
    'X,Y,X_measured,Y_measured\nmm,mm,mm,mm',
    'X [mm],Y,X_measured [mm],Y_measured',
    'AXES = CARTESIAN: X, Y, Z (mm)\nX,Y,X_measured,Y_measured',
)


@pytest.mark.parametrize('head', HEADS)
def test_units_stand_where_those_of_samples_may_stand(tmp_path, head) -> None:
    x, y = np.random.default_rng(5).uniform(-0.02, 0.02, (2, 50))  # below 60 mm: no guess
    path = write(tmp_path / 'p.csv', head, *(1e3 * np.stack([x, y, x, y])))
    (run,) = otf_core.read_point_pairs(path, plotter())
    assert np.allclose(run.q, np.stack([x, y], axis=1), atol=1e-9)
    assert not run.remarks
