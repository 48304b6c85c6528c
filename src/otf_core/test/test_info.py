# SPDX-License-Identifier: Apache-2.0
"""What is said of files: name, schema, headline, provenance."""

import json
from pathlib import Path

import pytest
from cli_cells import run

from otf_core.cli.info import KINDS
from otf_core.files.output_folder import MANIFEST, write_manifest
from otf_core.reports.calibration import write_calibration

ROOT = Path(__file__).resolve().parents[3]
ROOM = ROOT / 'bags/y-carries-the-table'
PLAN = {
    'schema': 'otf-plan/2',
    'length': 2.0,
    'duration': 90.0,
    'parts': [{'target': 'nest', 'positions': [[0.0], [1.0]]}],
    'forecast': {'errors': {'ECZ': {'identifiable': False}}},
}


def said(path, capsys):
    """Object of otf info; its words name the file and the kind in the first line."""
    assert run('info', path, '--json') == 0
    shown = capsys.readouterr()
    answer = json.loads(shown.out)
    assert shown.err.splitlines()[0] == f'{path}: {answer["kind"]}, {answer["schema"]}'
    assert answer['headline'] in shown.err
    return answer


def test_recordings_machines_and_lattices(tmp_path, capsys):
    found = said(ROOM / 'bag', capsys)
    assert (found['kind'], found['samples']) == ('recording', 38280)
    assert found['topics']['/planner/path'] == 'nav_msgs/msg/Path'
    assert found['duration_s'] == pytest.approx(255.2, abs=0.1)
    found = said(ROOM / 'machine.yaml', capsys)
    assert found['kind'] == 'machine description' and 'w-Y-b-X-Z-t' in found['headline']
    corners = [f'{x},{y},{z},1,0,0' for x in (0, 9) for y in (0, 9) for z in (0, 9)]
    head = ['# of a control', 'x_mm,y_mm,z_mm,dx_um,dy_um,dz_um']
    (tmp_path / 'l.csv').write_text('\n'.join([*head, *corners]) + '\n')
    found = said(tmp_path / 'l.csv', capsys)
    assert (found['kind'], found['headline']) == ('lattice', '8 points')


def test_tables_of_a_calibration_and_of_others_and_their_folder(calibrated, tmp_path, capsys):
    files = write_calibration(calibrated, tmp_path)
    write_manifest(tmp_path / MANIFEST, files, 'calibrate')
    found = said(tmp_path / 'error_tables.json', capsys)
    assert found['kind'] == 'error tables' and found['provenance']['verb'] == 'calibrate'
    assert calibrated.verdicts.measurement.sentence in found['headline']
    assert f'not seen: {", ".join(calibrated.not_identifiable)}' in found['headline']
    assert 'small-trunnion' in said(ROOT / 'bags/trunnion/truth.json', capsys)['headline']
    found = said(tmp_path, capsys)
    assert found['kind'] == 'folder of results' and found['changed'] == []
    (tmp_path / 'error_tables.csv').write_text('a note\n')
    assert said(tmp_path, capsys)['changed'] == ['error_tables.csv']


@pytest.mark.parametrize(
    ('data', 'kind', 'words'),
    [
        (PLAN, 'plan', '2.00 m, 90 s; parts nest (2 corner points); not shown: ECZ'),
        (
            {'schema': 'otf-gap/1', 'verdict': 'none', 'sentence': 'A.'},
            'diagnosis',
            'none: A.',
        ),
        ({'schema': 'otf-fleet/1', 'done': 3, 'failed': 1}, 'fleet', '3 runs done, 1 failed'),
        ({'schema': 'otf-new/1', 'a': 1}, 'result', 'holds schema, a'),
    ],
)
def test_results_have_a_headline(data, kind, words, tmp_path, capsys):
    (tmp_path / 'f.json').write_text(json.dumps(data))
    found = said(tmp_path / 'f.json', capsys)
    assert (found['kind'], found['headline']) == (kind, words)


@pytest.mark.parametrize(
    ('name', 'content', 'words'),
    [
        *(('a.json', json.dumps({'schema': s}), f"not a complete '{s}'") for s in KINDS),
        ('a.json', '{"schema": "other/1"}', 'not a file that otf writes or reads'),
        ('a.json', '{"schema', 'not valid JSON'),
        ('a.npz', 'PK\x03\x04nothing', 'is not a file that otf'),
        ('a.yaml', 'name: [', 'a.yaml'),
        ('a.txt', '', 'is not a file that otf'),
    ],
)
def test_a_file_that_cannot_be_explained_is_one_line_and_exit_code_3(
    tmp_path, capsys, name, content, words
):
    (tmp_path / name).write_text(content)
    assert run('info', tmp_path / name) == 3
    shown = capsys.readouterr()
    assert shown.out == '' and shown.err.count('\n') == 1 and words in shown.err
    assert run('info', tmp_path / 'nothing') == 2
