# SPDX-License-Identifier: Apache-2.0
"""Tables files: layout of the contract, round trip, and one clear error for each wrong content."""

import json

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.errors import ConfigError
from otf_core.model.kinematics import displacement
from otf_core.model.tables import MOTIONS, load_tables, tables_from_dict, tables_to_dict
from otf_core.sim.cell import random_tables

Q = np.array([[0.1, 0.2, -0.1], [0.3, 0.0, -0.2]])


@pytest.fixture
def data():
    """Tables as plain data."""
    tables = random_tables(some_machine('w-Y-b-X-Z-t'), 2e-5, np.random.default_rng(0))
    return tables_to_dict(tables)


def test_names_are_those_of_iso_230():
    names = 'EXX EYX EZX EAX EBX ECX EXY EYY EZY EAY EBY ECY EXZ EYZ EZZ EAZ EBZ ECZ'
    assert ' '.join(MOTIONS) == names


def test_layout_is_that_of_the_contract(data):
    assert data['schema'] == 'otf-error-tables/1'
    assert set(data['motions']) == set(MOTIONS)
    for name, entry in data['motions'].items():
        assert {'axis', 'unit', 'position', 'value', 'u', 'identifiable'} <= set(entry)
        assert entry['axis'] == name[2]
        assert entry['unit'] == ('m' if name[1] in 'XYZ' else 'rad')
        assert len(entry['position']) == len(entry['value']) == len(entry['u'])
    assert set(data['squareness']) == {'C0Y', 'B0Z', 'A0Z'}


def test_json_keeps_every_bit(data, tmp_path):
    file = tmp_path / 'error_tables.json'
    file.write_text(json.dumps(data))
    content = load_tables(file)
    assert tables_to_dict(content.tables) == data
    tables = random_tables(some_machine('w-Y-b-X-Z-t'), 2e-5, np.random.default_rng(0))
    np.testing.assert_array_equal(displacement(content.tables, Q), displacement(tables, Q))


def test_tables_of_other_people_need_no_uncertainty_nor_squareness(data):
    for entry in data['motions'].values():
        del entry['u'], entry['identifiable'], entry['axis'], entry['unit']
    data['squareness'] = {'C0Y': {'value': 1e-5}, 'B0Z': {}}
    tables = tables_from_dict(data, 'file').tables
    assert tables.squareness['C0Y'].value == 1e-5
    assert tables.squareness['A0Z'].value == 0.0
    assert not tables.motions['EXX'].u.any()


def test_extra_keys_are_kept_for_whoever_knows_them(data):
    assert tables_from_dict(data | {'remark': 7}, 'file').extra == {'remark': 7}


def set_motion(**change):
    return lambda data: data['motions']['EBX'].update(change)


@pytest.mark.parametrize(
    ('change', 'names'),
    [
        (lambda d: d.update(schema='otf-error-tables/2'), ('schema',)),
        (lambda d: d.pop('schema'), ('schema',)),
        (lambda d: d.pop('motions'), ('motions',)),
        (lambda d: d.update(motions=[]), ('motions',)),
        (lambda d: d['motions'].pop('EBX'), ('EBX', 'missing')),
        (lambda d: d['motions'].update(EQQ={}), ('EQQ', 'unknown')),
        (lambda d: d['motions'].update(EBX=[]), ('EBX',)),
        (lambda d: d.pop('machine'), ('machine',)),
        (lambda d: d['machine'].update(chain='w-b-X'), ('machine', 'chain')),
        (lambda d: d['machine'].pop('axes'), ('machine', 'axes')),
        (set_motion(position=[0.0]), ('EBX', 'length')),
        (set_motion(value=[]), ('EBX', 'value')),
        (set_motion(value=1e-6), ('EBX', 'value')),
        (set_motion(value=[float('nan')] * 7), ('EBX', 'value', 'finite')),
        (set_motion(value=['a'] * 7), ('EBX', 'value')),
        (set_motion(value=[[0.0]] * 7), ('EBX', 'value')),
        (set_motion(value=[None] * 7), ('EBX', 'value')),
        (set_motion(position=[0.3, 0.25, 0.2, 0.15, 0.1, 0.05, 0]), ('EBX', 'position', 'ascend')),
        (set_motion(position=[0, 0.05, 0.1, 0.1, 0.2, 0.25, 0.3]), ('EBX', 'position', 'ascend')),
        (lambda d: d['squareness'].update(B0Z=1e-6), ('squareness', 'B0Z')),
        (lambda d: d['squareness'].update(B0Z={'value': 'x'}), ('squareness', 'B0Z')),
    ],
)
def test_wrong_content_names_file_and_place(data, change, names):
    change(data)
    with pytest.raises(ConfigError) as caught:
        tables_from_dict(data, 'file.json')
    message = str(caught.value)
    assert 'file.json' in message
    assert '\n' not in message
    for name in names:
        assert name in message


@pytest.mark.parametrize(
    'change',
    [
        lambda d: d.update(squareness=[1]),
        lambda d: d.update(squareness='none'),
        lambda d: d['squareness'].update(B0Z={'value': float('nan')}),
        lambda d: d['squareness'].update(D0Z={'value': 1e-6}),
        set_motion(unit='um'),
        set_motion(axis='Y'),
        set_motion(u=[-1e-6] * 7),
        set_motion(value=[10**400] * 7),
    ],
    ids=['list', 'text', 'nan', 'unknown', 'unit', 'axis', 'negative u', 'huge'],
)
def test_content_that_contradicts_the_contract_is_refused(data, change):
    change(data)
    with pytest.raises(ConfigError):
        tables_from_dict(data, 'file.json')


@pytest.mark.parametrize('text', ['', '{', '[]', 'null', '3', '\x00', '{"schema": 1}'])
def test_file_that_is_no_tables_is_named(tmp_path, text):
    file = tmp_path / 'other.json'
    file.write_text(text)
    with pytest.raises(ConfigError, match=r'other\.json'):
        load_tables(file)


def test_missing_and_binary_files_are_named(tmp_path):
    with pytest.raises(ConfigError, match=r'none\.json: cannot be read'):
        load_tables(tmp_path / 'none.json')
    (tmp_path / 'binary.json').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ConfigError, match=r'binary\.json'):
        load_tables(tmp_path / 'binary.json')
