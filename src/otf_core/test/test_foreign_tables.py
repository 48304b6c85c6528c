# SPDX-License-Identifier: Apache-2.0
"""Tables of other systems: typed by hand, written by us, damaged; imported and compared."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from cli_cells import run
from core_cells import some_machine

from otf_core.errors import ConfigError
from otf_core.exports import export_format
from otf_core.exports.foreign_tables import holds_foreign_tables, read_foreign_tables
from otf_core.exports.format import Request
from otf_core.prediction.calibration_document import CalibrationDocument, tables_to_dict
from otf_core.sim.cell import random_tables

BY_HAND = Path(__file__).parent / 'data' / 'by_hand.etalon.txt'
MACHINE = some_machine(ranges=((-0.4, 0.4),) * 3)


@pytest.fixture(scope='module')
def tables():
    return random_tables(some_machine(pitch=0.04), 5e-5, np.random.default_rng(11))


@pytest.mark.parametrize(('sign', 'factor'), [(None, 1.0), ('error', 1.0), ('correction', -1.0)])
def test_a_file_typed_by_hand(sign, factor) -> None:
    read = read_foreign_tables(BY_HAND, MACHINE, sign)
    table = read.tables.motions['EXX']
    assert table.position.tolist() == [0.0, 0.15, 0.3]
    np.testing.assert_allclose(table.value, factor * np.array([0.0, 1.5e-6, -2.25e-6]))
    assert read.tables.squareness['C0Y'].value == pytest.approx(factor * -21.5e-6)
    np.testing.assert_allclose(read.tables.motions['ECZ'].value, factor * np.array([1e-5, 0.0]))
    assert not read.tables.motions['EZZ'].identifiable
    assert any('--sign' in remark for remark in read.remarks) == (sign is None)


@pytest.mark.parametrize(
    ('name', 'sign'),
    [('isg', 'error'), ('isg', 'correction'), ('etalon', 'error'), ('lattice-csv', 'error')],
)
def test_what_is_exported_is_read_again(tmp_path, tables, name, sign) -> None:
    asked = sign if name == 'isg' else None
    request = Request(CalibrationDocument.of_tables(tables), 'cell.txt', asked)
    (content,) = export_format(name).export(request).files.values()
    path = tmp_path / 'cell.txt'
    path.write_bytes(content)
    assert holds_foreign_tables(path)
    # its own comments state the sign
    read = read_foreign_tables(path, tables.machine, None if name == 'isg' else sign)
    if name == 'lattice-csv':
        assert read.left_rms < 1e-9
        return
    for motion, table in tables.motions.items():
        np.testing.assert_allclose(read.tables.motions[motion].at(table.position), table.value,
                                   atol=1e-9)  # fmt: skip


@pytest.mark.parametrize(
    ('text', 'wrong'),
    [
        ('[EXX]\nGridpoints = {\n0 0\n10 0.001\n', 'no end'),
        ('[EXX]\nGridpoints = {\n0 0\n0 0.001\n}\n', 'twice'),
        ('[EXX]\nGridpoints = {\n0 zero\n}\n', 'line 3'),
        ('[EXX]\nVALUES = 3\n', 'line 2'),
        ('[X0C]\nVALUE = 3\n', 'X0C'),
        ('[EXX]\nGridpoints = {\n0 0\n3000 0.001\n}\n', 'EXX'),
        ('Z X EXX\n0 0 0.1\n', 'Z, X'),
        ('X EXX EYX\n0 0.1\n', 'line 2'),
        ('Y EXX\n0 1\n500 2\n', 'own axis'),
        ('[EXX]\nVALUE = 0.5\n', 'EXX'),
        ('[C0Y]\nGridpoints = {\n0 0\n1 1\n}\n', 'C0Y'),
        ('[PXC]\nGridpoints = {\n0 0\n1 1\n}\n', 'PXC'),
        ('[C0Y]\nVALUE = 1 2\n', 'line 2'),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path, text, wrong) -> None:
    path = tmp_path / 'tables.txt'
    path.write_text(text)
    with pytest.raises(ConfigError, match=wrong):
        read_foreign_tables(path, MACHINE)


def test_import_and_compare_by_their_commands(tmp_path) -> None:
    machine = tmp_path / 'machine.yaml'
    machine.write_text(yaml.safe_dump(MACHINE.to_dict()))
    command = ('import', BY_HAND, '--machine', machine, '--out', tmp_path / 'in')
    assert run(*command) == 0
    imported = json.loads((tmp_path / 'in' / 'error_tables.json').read_text())
    assert imported['squareness']['B0Z']['value'] == pytest.approx(12.5e-6)
    ours = tmp_path / 'error_tables.json'
    tables = read_foreign_tables(BY_HAND, MACHINE).tables.scaled(2.0)
    ours.write_text(json.dumps(tables_to_dict(tables)))
    assert run('compare', ours, BY_HAND, '--out', tmp_path / 'c') == 0
    found = json.loads((tmp_path / 'c' / 'comparison.json').read_text())
    assert found['volume']['mae_difference'] > 1e-6
    same = ('compare', ours, BY_HAND, '--sign', 'correction', '--out', tmp_path / 'd')
    assert run(*same) == 0
    other = json.loads((tmp_path / 'd' / 'comparison.json').read_text())
    ratio = other['volume']['mae_difference'] / found['volume']['mae_difference']
    assert ratio == pytest.approx(3.0, rel=0.01)
