# SPDX-License-Identifier: Apache-2.0
"""Exports, read back by independent readers of the formats."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_cells import run
from core_cells import error_of, some_machine
from export_readers import READERS, etalon_blocks

from otf_core.errors import ConfigError
from otf_core.exports import export_format
from otf_core.exports.format import Request, remaining_error
from otf_core.exports.lattice import sampled_lattice, tables_from_lattice
from otf_core.model.evaluation import mean_length, without_rigid_motion
from otf_core.model.tables import MotionTable
from otf_core.prediction.calibration_document import (
    CalibrationDocument,
    ReversalBlock,
)
from otf_core.prediction.predict import predict
from otf_core.prediction.volumetric import VolumetricError
from otf_core.sim.cell import random_tables

FULL = ('isg', 'etalon', 'lattice-csv')
ASKED = ('sinumerik-cec', 'isg')
NAMES = tuple(READERS)
DATA = Path(__file__).parent / 'data'


@pytest.fixture(scope='module')
def tables():
    return random_tables(some_machine(pitch=0.04), 5e-5, np.random.default_rng(11))


@pytest.fixture(scope='module')
def places(tables):
    """Positions in the volume, no nodes among them."""
    machine = tables.machine
    return np.random.default_rng(2).uniform(machine.lower, machine.upper, (200, 3))


def exported(name, tables, sign='error', points=None):
    sign = sign if name in ASKED else None
    return export_format(name).export(
        Request(CalibrationDocument.of_tables(tables), 'cell.txt', sign, points)
    )


every_format = pytest.mark.parametrize('name', NAMES)


@every_format
def test_an_independent_reader_of_the_format_takes_error_off(name, tables, places):
    before = mean_length(without_rigid_motion(error_of(tables, places), places))
    change = READERS[name](exported(name, tables).files, places, 'error')
    after = mean_length(without_rigid_motion(error_of(tables, places) + change, places))
    wrong = mean_length(without_rigid_motion(error_of(tables, places) - change, places))
    assert after < (1e-3 if name in FULL else 0.95) * before < wrong


@every_format
def test_the_forecast_is_of_what_the_reader_takes_off(name, tables, places):
    made = exported(name, tables)
    change = READERS[name](made.files, places, 'error')
    np.testing.assert_allclose(made.held(places), -change, atol=5e-9)  # m; six decimals of a mm
    left = remaining_error(tables, made.held)
    assert left.after_mean < left.before_mean
    volume = VolumetricError(tables, np.zeros((1, 1)))  # as a calibration states
    stated = volume.sizes() | {'points': len(volume.grid)}
    assert (left.points, left.before_mean, left.before_max) == pytest.approx(
        (stated['points'], stated['mean'], stated['max']), rel=1e-12
    )


@every_format
def test_the_file_says_what_its_values_are_and_info_what_it_is(name, tables, tmp_path, capsys):
    sign = 'error' if name in ASKED else None
    request = Request(CalibrationDocument.of_tables(tables, run_id='abc123'), 'cell.txt', sign)
    made = export_format(name).export(request)
    words = export_format(name).value_words
    for file, content in made.files.items():
        (tmp_path / file).write_bytes(content)
        assert words.encode() in content, file
        assert run('info', tmp_path / file, '--json') == 0
        found = json.loads(capsys.readouterr().out)
        assert (found['kind'], found['schema']) in (('export', name), ('lattice', name)), file
        assert 'abc123' in found['headline'] or found['kind'] == 'lattice'
        assert b'target offset (' in content, file


@pytest.mark.parametrize('name', ASKED)
def test_the_sign_that_the_user_names_turns_the_values(name, tables, places):
    files = exported(name, tables, sign='correction').files
    as_error = READERS[name](exported(name, tables).files, places, 'error')
    np.testing.assert_allclose(READERS[name](files, places, 'correction'), as_error, atol=1e-12)
    with pytest.raises(ConfigError, match=r'--sign: .* needs it'):
        export_format(name).export(Request(CalibrationDocument.of_tables(tables), 'a.txt'))


@pytest.mark.parametrize(
    ('chain', 'count'), [('w-b-X-Y-Z-t', 31), ('w-Y-b-X-Z-t', 31), ('w-Z-Y-X-b-t', 41)]
)
def test_no_functions_of_one_axis_each_fit_the_volume_better(chain, count):
    tables = random_tables(some_machine(chain), 5e-5, np.random.default_rng(12))
    machine = tables.machine
    ends = zip(machine.lower, machine.upper, strict=True)
    q = np.stack(np.meshgrid(*(np.linspace(a, b, count) for a, b in ends), indexing='ij'), axis=-1)
    error = error_of(tables, q.reshape(-1, 3)).reshape(q.shape)
    made = [exported(n, tables, points=count).held for n in ('sinumerik-enc', 'sinumerik-cec')]
    held = sum(h(q.reshape(-1, 3)) for h in made).reshape(q.shape)
    weight = np.full(count, 1.0 / (count - 1))  # trapezoids
    weight[[0, -1]] *= 0.5

    def mean(field, *axes):
        for axis in axes:
            field = np.moveaxis(np.tensordot(field, weight, (axis, 0))[None], 0, axis)
        return field

    # analysis of variance: the fit is the sum of the means over the other axes
    fit = mean(error, 1, 2) + mean(error, 0, 2) + mean(error, 0, 1) - 2 * mean(error, 0, 1, 2)
    constant = mean(held - fit, 0, 1, 2)  # a shift of the frame
    np.testing.assert_allclose(held - constant, fit, atol=5e-9)


@pytest.mark.parametrize('points', [None, 5])
@pytest.mark.parametrize('name', ['linuxcnc', 'sinumerik-enc', 'sinumerik-cec', 'lattice-csv'])
def test_an_axis_that_did_not_move_gets_no_table_without_a_range(name, points, tables):
    single = MotionTable(np.array([-0.1]), np.zeros(1), np.zeros(1), False)
    motions = {m: single if m[2] == 'Z' else t for m, t in tables.motions.items()}
    made = exported(name, replace(tables, motions=motions), points=points)
    text = b'\n'.join(made.files.values()).decode()
    assert not re.search(r'STEP\[.*\]=0\.0+$', text, re.M)
    assert any('Z: did not move' in r for r in made.remarks) == name.startswith('sinumerik')
    q = np.random.default_rng(3).uniform(tables.machine.lower, tables.machine.upper, (20, 3))
    assert np.all(np.isfinite(made.held(q)))
    if name == 'linuxcnc':
        rows = [line for line in made.files['cell_z.comp'].decode().splitlines() if line[0] != '#']
        assert rows == ['-100.000000 -100.000000 -100.000000']
    if name == 'lattice-csv':
        rows = [line.split(',')[:3] for line in text.splitlines() if line[0] not in '#x']
        assert len(rows) == len(set(map(tuple, rows)))


@pytest.mark.parametrize('name', ['linuxcnc', 'sinumerik-enc', 'sinumerik-cec'])
def test_a_table_is_zero_at_the_reference_though_no_point_stands_there(name):
    ranges = ((-0.13, 0.3), (-0.11, 0.25), (-0.2, 0.07))
    tables = random_tables(some_machine(ranges=ranges), 5e-5, np.random.default_rng(5))
    held = exported(name, tables, points=6).held
    np.testing.assert_allclose(held(np.zeros((1, 3))), 0.0, atol=2e-9)


@pytest.mark.parametrize('name', ['isg', 'etalon'])
def test_what_the_calibration_did_not_see_is_said_to_be_zero_for_that(name, tables):
    assert not any('zero because' in r for r in exported(name, tables).remarks)
    hidden = {m: replace(tables.motions[m], identifiable=False) for m in ('EAZ', 'ECZ')}
    blind = replace(tables, motions={**tables.motions, **hidden})
    sign = 'error' if name in ASKED else None
    content = CalibrationDocument.of_tables(blind, not_identifiable=('B0Z', 'EAZ', 'ECZ'))
    made = export_format(name).export(Request(content, 'cell.txt', sign))
    said = 'zero because the calibration does not determine them: B0Z, EAZ, ECZ;'
    assert said in made.remarks[-2]
    assert made.remarks[-1].startswith('measured with one target offset, ')
    assert said.encode() in made.files['cell.txt']


@every_format
def test_no_name_leaves_its_comment(name, tables, places):
    named = replace(tables, machine=replace(tables.machine, name='a---b\nG0 X100\ufffe--'))
    content = CalibrationDocument.of_tables(named, run_id='1\nG0 X1')
    sign = 'error' if name in ASKED else None
    files = export_format(name).export(Request(content, 'cell.txt', sign)).files
    assert not any(re.search(rb'^G0', file, re.M) for file in files.values())
    plain = READERS[name](exported(name, tables).files, places, 'error')
    np.testing.assert_array_equal(READERS[name](files, places, 'error'), plain)


def test_backlash_stands_in_the_columns_of_the_directions(tables):
    entry = {'position': [0.0, 0.25], 'value': [4e-6, 6e-6]}
    reversal = ReversalBlock.from_dict({'motions': {'EYY': entry}})
    request = Request(CalibrationDocument.of_tables(tables, reversal=reversal), 'a.ini')
    exported_files = export_format('linuxcnc').export(request)
    files, said = exported_files.files, ' '.join(exported_files.remarks)
    assert re.search(r'on average X 0\.00 um, Y [45]\.\d\d um, Z 0\.00 um', said), said
    for name, wanted in (('a_x.comp', (0.0, 0.0)), ('a_y.comp', (4e-3, 6e-3))):
        lines = files[name].decode().splitlines()
        rows = np.array([line.split() for line in lines if line[0] != '#'], float)
        # error in forward travel less that in backward travel, mm
        np.testing.assert_allclose((rows[:, 1] - rows[:, 2])[[0, -1]], wanted, atol=2e-6)


def test_a_file_typed_by_hand_and_the_one_that_is_written_read_alike(tables):
    values, columns = etalon_blocks((DATA / 'by_hand.etalon.txt').read_text())
    assert values == {'C0Y': -21.5e-6, 'B0Z': 12.5e-6, 'A0Z': 0.0}
    np.testing.assert_array_equal(columns['EXX'], [[0, 150, 300], [0, 1.5e-3, -2.25e-3]])
    motions = {name: replace(t, value=0.0 * t.value) for name, t in tables.motions.items()}
    for name, (argument, value) in columns.items():
        scale = 1e-3 if name[1] in 'XYZ' else 1.0
        motions[name] = MotionTable(1e-3 * argument, scale * value, 0.0 * value)
    square = {name: replace(tables.squareness[name], value=v) for name, v in values.items()}
    made = exported('etalon', replace(tables, motions=motions, squareness=square))
    again = etalon_blocks(made.files['cell.txt'].decode())
    assert again[0] == values
    for name, table in columns.items():
        np.testing.assert_allclose(again[1][name], table, atol=1e-9)
    assert not any(again[1][name][1].any() for name in set(again[1]) - set(columns))


@every_format
def test_points_are_taken_or_refused_and_fewer_are_said(name, tables):
    if name in ('isg', 'etalon'):
        with pytest.raises(ConfigError, match=rf'--points: {name} holds the nodes'):
            exported(name, tables, points=20)
        return
    with pytest.raises(ConfigError, match='--points: 1'):
        exported(name, tables, points=1)
    made = exported(name, tables, points=20)
    assert not any('instead of' in remark for remark in made.remarks)
    if name == 'linuxcnc':
        made = exported(name, tables, points=400)
        assert sum('256 lines' in r for r in made.remarks) == 3
    if name == 'sinumerik-cec':
        dense = random_tables(some_machine(pitch=0.001), 5e-5, np.random.default_rng(11))
        assert '200 points' in exported(name, dense).remarks[-1]


@pytest.mark.parametrize('chain', ['w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-Z-b-t'])
def test_an_imported_lattice_knows_what_it_does_not_show(chain):
    machine = some_machine(chain)
    tables = random_tables(machine, 5e-5, np.random.default_rng(4))
    lattice = sampled_lattice(tables, None)[0]
    found = tables_from_lattice(lattice, machine)
    assert found.left_rms < 1e-7
    lost = [m for m, t in found.tables.motions.items() if not t.identifiable]
    assert len(lost) == 4 and not any(found.tables.motions[m].value.any() for m in lost)
    q = np.array([[0.2, 0.1, -0.1]])
    content = CalibrationDocument.of_tables(found.tables)
    np.testing.assert_allclose(predict(content, q).error, error_of(tables, q), atol=2e-7)
    assert not any('were not seen' in n for n in predict(content, q).notes)
    other = machine.target_offset + np.array([0.1, 0.05, -0.2])
    assert any(f'{lost[0]}, ' in n for n in predict(content, q, other).notes)


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('x,y,z\n0,0,0\n', 'expected the header'),
        ('x,y,z,dx,dy,dz\n0,0,0,a,0,0\n', 'line 2'),
        ('x,y,z,dx,dy,dz\n0,0,-.1,0,0,0\n0.1,0.1,-.2,0,0,0\n', 'no point at'),
        ('# ' + '\nx,y,z,dx,dy,dz\n', 'holds no points'),
    ],
)
def test_a_lattice_that_is_none_is_refused_with_its_place(text, said, place, capsys):
    (place / 'l.csv').write_text(text)
    assert run('import', 'l.csv', '--machine', 'machine.yaml', '--out', 'back') == 2
    assert said in capsys.readouterr().err
    assert not (place / 'back').exists()
