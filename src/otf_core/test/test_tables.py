# SPDX-License-Identifier: Apache-2.0
"""Tables files: layout of the contract, round trip, and one clear error for each wrong content."""

import json

import numpy as np
import pytest
from core_cells import some_machine
from scipy.spatial.transform import Rotation

from otf_core.errors import ConfigError
from otf_core.model.chain import displacement
from otf_core.prediction.calibration_document import load_tables, tables_from_dict, tables_to_dict
from otf_core.sim.cell import random_tables

Q = np.array([[0.1, 0.2, -0.1], [0.3, 0.0, -0.2]])


@pytest.fixture
def data():
    """Tables as plain data."""
    tables = random_tables(some_machine('w-Y-b-X-Z-t'), 2e-5, np.random.default_rng(0))
    return tables_to_dict(tables)


def test_tables_stay_with_their_chain():
    tables = random_tables(some_machine(), 2e-5, np.random.default_rng(0))
    longer = some_machine(offset=(0.0, 0.0, -0.25))
    assert tables.on(longer).machine is longer
    with pytest.raises(ConfigError, match='chain w-b-X-Y-Z-t, small has w-Y-b-X-Z-t'):
        tables.on(some_machine('w-Y-b-X-Z-t'))


def without_u_run(data):
    for entry in (*data['motions'].values(), *data['squareness'].values()):
        assert entry.pop('u_run') == entry['u']
    return data


def test_json_keeps_every_bit(data, tmp_path):
    file = tmp_path / 'error_tables.json'
    file.write_text(json.dumps(data))
    content = load_tables(file)
    assert without_u_run(content.to_dict()) == data
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


def everything():
    """Tables with every field of the contract, each with a value that nothing else has."""
    tables = random_tables(some_machine('w-Y-b-X-Z-t'), 2e-5, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    data = tables_to_dict(tables)
    for name, entry in data['motions'].items():
        size = len(entry['position'])
        entry['u'] = rng.uniform(1e-7, 1e-6, size).tolist()
        entry['identifiable'] = name not in ('EAY', 'ECZ')
        entry['node_identifiable'] = (rng.uniform(size=size) > 0.5).tolist()
    for entry in data['squareness'].values():
        entry['u'] = rng.uniform(1e-7, 1e-6)
    turn = Rotation.from_rotvec([0.1, -0.2, 0.7]).as_matrix()
    data['alignment'] = {'rotation': turn.tolist(), 'translation': [0.1, -0.4, 0.2]}
    data['fit'] = {'samples': 900, 'used': 800, 'unknowns': 300, 'rank': 250}
    data['fit'] |= {'path_mae_before': 1e-5, 'path_mae_after': 1e-6, 'residual_rms': 2e-6}
    return data


def test_every_field_of_the_contract_makes_the_round_trip():
    data = json.loads(json.dumps(everything()))
    content = tables_from_dict(data, 'file')
    again = without_u_run(content.to_dict())
    again['fit'] = {key: again['fit'][key] for key in data['fit']}
    assert again == data
    assert not content.tables.motions['EAY'].identifiable
    assert content.tables.motions['EXX'].node_identifiable.dtype == bool


def test_the_document_of_a_calibration_makes_the_round_trip(calibrated):
    data = json.loads(json.dumps(calibrated.to_dict(), allow_nan=False))
    again = tables_from_dict(data, 'file')
    assert json.loads(json.dumps(again.to_dict())) == data
    assert again.exit_code == calibrated.verdicts.exit_code and again.remarks == ()


WRONG_TYPES = [
    ('identifiable', 0, 'EBX: identifiable: expected true or false'),
    ('node_identifiable', ['false'] * 7, 'EBX: node_identifiable: entry 0: expected true'),
    ('node_identifiable', [True] * 6, 'EBX: node_identifiable: has length 6, expected 7'),
    ('value', ['1e-6'] * 7, "EBX: value: entry 0: expected a finite number, got '1e-6'"),
    ('value', '1234567', 'EBX: value: expected a list'),
    ('u', [1e-6, 1e-6, None, 0, 0, 0, 0], 'EBX: u: entry 2: expected a finite number, got None'),
    ('u', [1e-6, -1e-6, 0, 0, 0, 0, 0], 'EBX: u: entry 1: must be at least 0'),
    ('position', {'0': 1}, 'EBX: position: expected a list'),
]


@pytest.mark.parametrize(('key', 'value', 'words'), WRONG_TYPES)
def test_wrong_types_are_refused_and_never_read_as_something_else(data, key, value, words):
    data['motions']['EBX'][key] = value
    with pytest.raises(ConfigError, match=f'^file: motions: {words}'):
        tables_from_dict(data, 'file')


def set_motion(**change):
    return lambda data: data['motions']['EBX'].update(change)


@pytest.mark.parametrize(
    ('change', 'names'),
    [
        (lambda d: d.update(schema='otf-error-tables/3'), ('schema',)),
        (lambda d: d.update(schema='otf-error-tables/1', motions={'EXC': {}}), ('EXC',)),
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


@pytest.mark.parametrize('text', ['', '{', '[]', 'null', '3', '\x00', '{"schema": 1}'])
def test_file_that_is_no_tables_is_named(tmp_path, text):
    file = tmp_path / 'other.json'
    file.write_text(text)
    with pytest.raises(ConfigError, match=r'other\.json'):
        load_tables(file)
