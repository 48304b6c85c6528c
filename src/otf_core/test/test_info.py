# SPDX-License-Identifier: Apache-2.0
"""What is said of files: of every kind that is written, against what was written."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_cells import run, write_points
from core_cells import some_machine

from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.files.output_folder import MANIFEST, write_manifest
from otf_core.info.explain import KINDS, explain
from otf_core.reports.calibration import write_calibration

ROOT = Path(__file__).resolve().parents[3]
ROOM = ROOT / 'bags/y-carries-the-table'


@pytest.fixture(scope='module')
def results(calibrated, tmp_path_factory):
    folder = tmp_path_factory.mktemp('results')
    files = write_calibration(calibrated, folder)
    write_manifest(folder / MANIFEST, files, 'calibrate')
    return folder


def said(path, capsys):
    """Object of otf info; its words name the file and the kind in the first line."""
    assert run('info', path, '--json') == 0
    shown = capsys.readouterr()
    answer = json.loads(shown.out)
    assert shown.err.splitlines()[0] == f'{path}: {answer["kind"]}'
    return answer['kind'], answer['facts']


def test_recordings_and_machines(capsys):
    kind, facts = said(ROOM / 'bag', capsys)
    assert (kind, facts['samples']) == ('recording', 38280)
    assert facts['path_length'] == pytest.approx(41.005, abs=1e-3)
    kind, facts = said(ROOM / 'machine.yaml', capsys)
    assert (kind, facts['chain']) == ('machine description', 'w-Y-b-X-Z-t')


def test_tables_of_a_calibration_and_of_others(results, calibrated, capsys):
    kind, facts = said(results / 'error_tables.json', capsys)
    assert kind == 'error tables' and facts['not_seen'] == list(calibrated.not_identifiable)
    kind, facts = said(ROOM / 'truth.json', capsys)
    assert kind == 'error tables' and facts['fit'] == {}
    kind, facts = said(ROOT / 'bags/trunnion/truth.json', capsys)
    assert 'rotary axes' in kind and 'X0C' in facts['location']


def test_residuals(results, calibrated, capsys):
    kind, facts = said(results / 'residuals.npz', capsys)
    assert kind == 'residuals' and facts['pieces'] == calibrated.fit.pieces
    assert facts['mean_residual'] == pytest.approx(calibrated.fit.path_mae_after, rel=1e-9)


def test_a_folder_and_what_was_changed_in_it(results, capsys):
    kind, facts = said(results, capsys)
    assert kind == 'folder of results' and facts['by'] == 'calibrate' and not facts['changed']
    text = (results / 'summary.txt').read_text()
    (results / 'summary.txt').write_text(text + 'a note\n')
    assert said(results, capsys)[1]['changed'] == ['summary.txt']
    (results / 'summary.txt').write_text(text)


def test_effects_points_and_direct_measurements(tmp_path, capsys):
    write_effects(
        tmp_path / 'e.yaml', [AppliedEffect(REGISTRY['backlash'], {'B_X': 5e-6})], some_machine()
    )
    kind, facts = said(tmp_path / 'e.yaml', capsys)
    assert kind == 'effects' and facts['effects'][0]['effect'] == 'backlash'
    write_points(tmp_path / 'p.csv', [[0, 0, 0], [0.1, 0.2, -0.3]])
    assert said(tmp_path / 'p.csv', capsys) == (
        'points', {'points': 2, 'lower': [0, 0, -0.3], 'upper': [0.1, 0.2, 0]},
    )  # fmt: skip
    (tmp_path / 'd.csv').write_text(
        '# point Y: 0.3,,-0.2\naxis,run,direction,position_m,EX_m\n'
        'X,1,forward,0,0\nX,1,backward,0,0\nY,1,forward,0,0\n'
    )
    kind, facts = said(tmp_path / 'd.csv', capsys)
    assert kind == 'direct measurement' and facts['readings'] == {'X': 2, 'Y': 1}


def test_every_schema_that_is_written_is_known(tmp_path, capsys):
    written = set()
    for file in (ROOT / 'src/otf_core/otf_core').rglob('*.py'):
        for line in file.read_text(encoding='utf-8').splitlines():
            if 'SCHEMA = ' in line and "'otf-" in line:
                written.add(line.split("'")[1])
    assert len(written) > 8
    for schema in written:
        (tmp_path / 'f.json').write_text(json.dumps({'schema': schema}))
        assert any(kind.is_one(tmp_path / 'f.json') for kind in KINDS), schema
    (tmp_path / 'f.json').write_text('{"schema": "otf-new/1", "a": 1}')
    assert said(tmp_path / 'f.json', capsys) == (
        'other result', {'schema': 'otf-new/1', 'keys': ['schema', 'a']},
    )  # fmt: skip


@pytest.mark.parametrize(
    ('name', 'content', 'words'),
    [
        ('a.json', '{"schema": "otf-gap/1"}', "is not a complete 'otf-gap/1'"),
        ('a.json', '{"schema": "other/1"}', 'is not a file that otf writes or reads'),
        ('a.json', '{"schema', 'not valid JSON'),
        ('a.npz', 'PK\x03\x04nothing', 'is not a residuals.npz'),
        ('a.yaml', 'name: [', 'a.yaml'),
        ('a.txt', '', 'is not a file that otf'),
    ],
)
def test_a_file_that_cannot_be_explained_is_one_line_and_exit_code_2(
    tmp_path, capsys, name, content, words
):
    (tmp_path / name).write_text(content)
    assert run('info', tmp_path / name) == 2
    shown = capsys.readouterr()
    assert shown.out == '' and shown.err.count('\n') == 1 and words in shown.err
    assert run('info', tmp_path / 'nothing') == 2
    assert np.all([p.name != 'nothing' for p in tmp_path.iterdir()])


def test_kinds_are_asked_without_an_error_for_any_file(tmp_path):
    (tmp_path / 'binary.csv').write_bytes(bytes(range(256)))
    assert not any(kind.is_one(tmp_path / 'binary.csv') for kind in KINDS)
    assert explain(ROOM / 'machine.yaml')[0].name == 'machine description'


def test_a_plan_of_rotary_axes_and_its_files_are_no_recordings(tmp_path, capsys):
    plan = {
        'schema': 'otf-rotary-plan/1',
        'axes': ['X', 'Y', 'Z', 'C'],
        'parts': [{'target': 'nest', 'duration': 90.0, 'positions': [[0, 0, 0, 0], [0, 0, 0, 1]]}],
        'forecast': {'grid_u': 7e-7, 'hidden': {'ECZ': 'why'}},
    }
    (tmp_path / 'plan.json').write_text(json.dumps(plan))
    (tmp_path / 'path.csv').write_text('target,x,y,z,c\nnest,0,0,0,0\nnest,0,0,0,1\n')
    (tmp_path / 'point.csv').write_text('x,y,z,c\n0,0,0,1\n')
    kind, facts = said(tmp_path / 'plan.json', capsys)
    assert kind == 'plan of a machine with rotary axes' and facts['parts'] == ['nest']
    assert said(tmp_path / 'path.csv', capsys) == ('axis positions', {'parts': ['nest']})
    assert said(tmp_path / 'point.csv', capsys)[0] == 'axis positions'
    (tmp_path / 'path.mcap').touch()
    write_manifest(tmp_path / MANIFEST, [tmp_path / 'plan.json'], 'plan')
    assert said(tmp_path, capsys)[0] == 'folder of results'
