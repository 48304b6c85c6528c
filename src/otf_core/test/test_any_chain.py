# SPDX-License-Identifier: Apache-2.0
"""Machines of one, two and three axes: what they are, what is not there, what is refused."""

import csv
import json

import numpy as np
import pytest
from test_chain import constant, machine_of

import otf_core
from otf_core import cli
from otf_core.errors import ShapeError
from otf_core.exports import HOMES, export_format
from otf_core.exports.format import ANY_AXES, LINES, THREE_AXES
from otf_core.model.chain import displacement, exact_position, nominal_position
from otf_core.model.tables import ErrorTables
from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables

GANTRY, PLOTTER, TABLE = 'w-b-X-Y-t', 'w-Y-b-X-t', 'w-C-b-t'


@pytest.mark.parametrize(
    ('chain', 'squareness', 'location'),
    [
        (GANTRY, ('C0Y',), ()),
        (PLOTTER, ('C0Y',), ()),
        ('w-b-Z-t', (), ()),
        ('w-b-Z-Y-t', ('A0Z',), ()),
        ('w-Z-b-X-t', ('B0Z',), ()),
        (TABLE, (), ('X0C', 'Y0C', 'A0C', 'B0C')),
        ('w-C-b-X-t', (), ('X0C', 'Y0C', 'A0C', 'B0C')),
        ('w-b-X-Y-Z-t', ('C0Y', 'B0Z', 'A0Z'), ()),
    ],
)
def test_a_machine_has_the_errors_of_its_axes_alone(chain, squareness, location):
    machine = machine_of(chain)
    letters = [a for a in 'XYZABC' if a in chain]
    assert machine.axis_names == tuple(letters)
    assert list(machine.motions) == [f'E{d}{a}' for a in letters for d in 'XYZABC']
    assert (machine.squareness, machine.location) == (squareness, location)


@pytest.mark.parametrize('chain', [GANTRY, PLOTTER, TABLE, 'w-b-Y-t'])
def test_tables_of_any_chain_are_read_as_they_were_written(chain, tmp_path):
    machine = machine_of(chain)
    tables = constant(machine, 3e-6, machine.motions[3])
    (tmp_path / 't.json').write_text(json.dumps(tables_to_dict(tables)))
    file = load_tables(tmp_path / 't.json')
    known = {m: t.with_defaults() for m, t in tables.motions.items()}
    again = ErrorTables(tables.machine, known, file.squareness, file.location)
    assert tables_to_dict(file.tables) == tables_to_dict(again)
    assert (file.remarks, file.without_u) == ((), ())


def test_position_of_the_target_is_that_of_the_axes_and_zero_along_what_is_none():
    q = np.array([[0.1, 0.2], [-0.3, 0.05]])
    for chain in (GANTRY, PLOTTER):
        points = nominal_position(machine_of(chain), q)
        np.testing.assert_array_equal(points, [[0.1, 0.2, 0.0], [-0.3, 0.05, 0.0]])


@pytest.mark.parametrize(
    ('chain', 'motion', 'error'),
    [
        # T = (0.02, -0.03, -0.15), q = (0.1, 0.2): X carries Y, L = (0.02, 0.17, -0.15)
        (GANTRY, 'EAX', (0, 0.15, 0.17)),
        (GANTRY, 'EXY', (1, 0, 0)),
        (GANTRY, 'C0Y', (-0.2, 0, 0)),
        # Y carries the table: its own travel counts, L = (0.12, 0.17, -0.15)
        (PLOTTER, 'ECY', (-0.17, 0.12, 0)),
        (PLOTTER, 'C0Y', (-0.2, 0, 0)),
    ],
)
def test_errors_of_two_axes_act_as_with_three(chain, motion, error):
    tables, q = constant(machine_of(chain), 1e-6, motion), np.array([[0.1, 0.2]])
    np.testing.assert_allclose(displacement(tables, q)[0], 1e-6 * np.array(error), atol=1e-18)
    exact = exact_position(tables, q) - nominal_position(tables.machine, q)
    np.testing.assert_allclose(exact[0], 1e-6 * np.array(error), atol=1e-12)


def test_a_rotary_table_alone_turns_the_target_about_its_line():
    machine = machine_of(TABLE)
    x, y, z = machine.target_offset
    at_quarter = nominal_position(machine, np.array([[np.pi / 2]]))
    np.testing.assert_allclose(at_quarter, [[-y, x, z]], atol=1e-16)
    # the line of C 1 um further along X: the target at C = 180 degrees by 2 um
    moved = displacement(constant(machine, 1e-6, 'X0C'), np.array([[0.0], [np.pi]]))
    np.testing.assert_allclose(moved, [[0, 0, 0], [2e-6, 0, 0]], atol=1e-18)


@pytest.mark.parametrize(
    ('chain', 'head', 'rows', 'within', 'beside'),
    [
        (GANTRY, 'x,y,z', [[0.1, 0.2, 0], [0.1, 0.2, 0.1], [0.4, 0.2, 0]], [1, 0, 0], True),
        (TABLE, 'x,y,z,c', [[0, 0, 0, 1], [0, 0.1, 0, 1], [0, 0, 0, -2.5]], [1, 0, 0], True),
        ('w-C-b-X-t', 'x,y,z,c', [[0.1, 0, 0, 1], [0.1, 0, 0, 1.9]], [1, 1], False),
    ],
)
def test_points_always_have_x_y_z(
    chain, head, rows, within, beside, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    machine = machine_of(chain)
    data = tables_to_dict(constant(machine))
    for name, own in data['motions'].items():
        axis = machine.axes[own['axis']]
        size = 1e-6 if name == f'EX{machine.axis_names[0]}' else 0.0
        own |= {'position': [axis.min, axis.max], 'value': [size] * 2, 'u': [1e-7] * 2}
    (tmp_path / 't.json').write_text(json.dumps(data))
    lines = [head, *(','.join(map(str, row)) for row in rows)]
    (tmp_path / 'p.csv').write_text('\n'.join(lines) + '\n')
    assert cli.main(['predict', '--tables', 't.json', '--points', 'p.csv', '--out', 'e.csv']) == 0
    found = list(csv.DictReader((tmp_path / 'e.csv').read_text().splitlines()))
    assert [int(row['inside']) for row in found] == within
    assert [int(bool(row['u_dx'])) for row in found] == within
    for row, point in zip(found, rows, strict=True):
        assert [float(row[a]) for a in head.split(',')] == point
    assert float(found[0]['dx']) != 0.0
    assert ('outside' in capsys.readouterr().err) == beside
    assert otf_core.predict('t.json', rows).inside.tolist() == [bool(w) for w in within]
    with pytest.raises(ShapeError, match='X, Y, Z'):
        otf_core.predict('t.json', [[*row, 0.0] for row in rows])


# Results of machines of fewer axes side by side, and in the formats of controls.


def some_tables(chain, seed=3):
    return random_tables(machine_of(chain), 3e-5, np.random.default_rng(seed))


@pytest.mark.parametrize('chain', [GANTRY, PLOTTER, TABLE, 'w-C-b-X-t', 'w-b-Z-t'])
def test_results_of_any_chain_are_compared_kept_and_exported(chain, tmp_path, capsys):
    tables, store = some_tables(chain), tmp_path / 'store'
    file, other = tmp_path / 'a.json', tmp_path / 'b.json'
    for path, own in ((file, tables), (other, tables.scaled(1.1))):
        path.write_text(json.dumps(tables_to_dict(own)))
        assert cli.main(['history', str(store), '--add', str(path), '--at', '2026-01-01']) == 0
    assert cli.main(['compare', str(file), str(other), '--out', str(tmp_path / 'out')]) == 0
    found = json.loads((tmp_path / 'out' / 'comparison.json').read_text())
    machine = tables.machine
    assert set(found['motions']) == set(machine.motions)
    assert {*found['squareness'], *found['location']} <= set(machine.scalars)
    sizes = found['volume']
    assert sizes['mae_difference'] == pytest.approx(0.1 * sizes['mae_a'], rel=1e-6)
    for name in HOMES:
        out = tmp_path / f'{name}.ini'
        sign = ['--sign', 'error'] if export_format(name).sign_is_asked else []
        words = ['export', str(file), '--format', name, '--out', str(out), *sign]
        holds = {THREE_AXES: False, LINES: bool(machine.rotary_names), ANY_AXES: True}
        crossed = name != 'sinumerik-cec' or len({*'XYZ'} & {*chain}) > 1
        expected = 0 if holds[export_format(name).holds] and crossed else 2
        assert cli.main(words) == expected, name
        assert out.exists() == (expected == 0)
        if out.exists() and not {'Y', 'Z'} & set(chain):
            assert 'A0Z' not in out.read_text()
