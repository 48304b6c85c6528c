# SPDX-License-Identifier: Apache-2.0
"""Calibration with effects taken off, on a machine whose axis grows by a law of its own."""

import json

import pytest
import yaml
from cli_cells import run
from nature import Cell, Extra, judge

from otf_core.bags.bag import BagContent, write_bag
from otf_core.config import CalibrationConfig
from otf_core.diagnosis.diagnose import calibrate_with_effects
from otf_core.prediction.calibration_document import load_tables
from otf_core.prediction.predict import predict
from otf_core.reports.calibration_page import calibration_page

CELL = {
    'seed': 5,
    'size': (0.3, 0.25, 0.2),
    'pitch': 0.05,
    'path': 'short',
    'feed': 0.15,
    'dwell': 0.1,
}
GROWING = Cell(**CELL, extra=Extra(growth=(20e-6, 0, 0)))
STEADY = Cell(**CELL)
CONFIG = CalibrationConfig(piece_length=0.016)
TOO_SMALL = [
    {
        'effect': 'thermal_axis_expansion',
        'parameters': {'tau': 1e5, 'order': 3, 'S_X': 2e-5, 'S_X_2': 0.0, 'S_X_3': 0.0},
    }
]


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """What the command writes for a file that says a third of the true growth."""
    base = tmp_path_factory.mktemp('effects')
    recording = GROWING.recording(rate=40.0)
    write_bag(base / 'bag', BagContent(recording.samples, recording.path))
    (base / 'machine.yaml').write_text(yaml.safe_dump(GROWING.machine.to_dict()))
    (base / 'effects.yaml').write_text(yaml.safe_dump(TOO_SMALL))
    words = ['calibrate', base / 'bag', '--machine', base / 'machine.yaml', '--out', base / 'out']
    words += ['--effects', base / 'effects.yaml', {'piece_length': 0.016}]
    assert run(*words) == 0
    return base / 'out'


def judged(file, cell):
    known = load_tables(file)
    count = 3 + sum(len(m.position) for m in known.tables.motions.values())
    return judge(cell, known.tables, known.covariance_run.unpack(count))


def test_growth_taken_off_leaves_tables_as_of_the_start_of_the_run(folder):
    plain = judged(folder / 'plain' / 'error_tables.json', GROWING)
    better = judged(folder / 'error_tables.json', GROWING)
    assert plain.left_percent > 2.0
    assert better.left_percent < 0.25 * plain.left_percent
    assert better.within_2u_percent > 80


def test_file_and_summary_state_the_effect_with_its_uncertainty(folder):
    data = json.loads((folder / 'error_tables.json').read_text())
    (effect,) = data['effects']
    assert effect['effect'] == 'thermal_axis_expansion' and effect['how'] == 'file'
    grown = effect['parameters']['S_X'] + 2 * effect['parameters']['S_X_3']
    u = effect['u']['S_X'] + 2 * effect['u']['S_X_3']
    assert abs(grown - 20e-6 / 0.3) < 3 * u < 0.2 * grown
    assert 'tau' not in effect['u'] and effect['units']['S_X'] == 'm/m'
    plain = json.loads((folder / 'plain' / 'error_tables.json').read_text())
    assert plain['effects'] == [] and plain['run_id'] != data['run_id']
    assert 'effects' in data['budget']['dof'] and 'effects' not in plain['budget']['dof']
    page = (folder / 'report.html').read_text(encoding='utf-8')
    assert 'thermal axis expansion' in page and 'named in a file' in page


def test_what_was_taken_off_is_a_file_of_effects_again(folder):
    again = yaml.safe_load((folder / 'effects_taken_off.yaml').read_text())
    assert again[0]['effect'] == 'thermal_axis_expansion'
    assert again[0]['parameters']['S_X'] == pytest.approx(64e-6, rel=0.05)


def test_tables_with_an_effect_taken_off_predict(folder):
    points = GROWING.lattice(2)
    assert predict(folder / 'error_tables.json', points).error.shape == (8, 3)


def test_growth_is_found_and_taken_off():
    recording = GROWING.recording(rate=40.0)
    done = calibrate_with_effects([recording], 'auto', CONFIG)
    assert [e.effect for e in done.effects] == ['thermal_axis_expansion']
    assert done.effects[0].how == 'found' and 'Removed: ' in done.effects_sentence
    left = [judge(GROWING, r.tables, r.covariance_run).left_percent for r in (done.plain, done)]
    assert left[1] < 0.25 * left[0]


def test_nothing_is_taken_off_where_nothing_is_found():
    done = calibrate_with_effects([STEADY.recording(rate=40.0)], 'auto', CONFIG)
    assert done.effects == () and done.applied == ()
    assert 'No gap' in done.effects_sentence and 'No effect was removed' in done.effects_sentence
    assert 'No effect was removed' in calibration_page(done.to_dict())
    assert done.run_id == done.plain.run_id
