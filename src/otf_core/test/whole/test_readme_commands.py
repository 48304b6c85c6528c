# SPDX-License-Identifier: Apache-2.0
"""The commands of the README, as printed and in their order, in an empty folder."""

import hashlib
import json
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

import otf_core
from otf_core import cli
from otf_core.model.tables import load_tables

README = Path(__file__).resolve().parents[4] / 'README.md'
MACHINES = ('machine.yaml', 'longer.yaml')


def blocks():
    """Code blocks of the section on offline commands."""
    section = README.read_text(encoding='utf-8').split('## Offline commands')[1].split('\n## ')[0]
    return re.findall(r'```\n(.*?)```', section, re.DOTALL)


def statements(block):
    """Commands of a block: lines, or lines up to the end of a here-document."""
    lines = iter(block.splitlines())
    for line in lines:
        if '<<' in line:
            end = line.rpartition('<<')[2].strip("'")
            inner = [line]
            while inner[-1] != end:
                inner.append(next(lines))
            yield '\n'.join(inner)
        elif line.strip():
            yield line


def run(statement):
    """Exit code; our own commands run in this process, which spares the start of Python."""
    if not statement.startswith('./otf '):
        return subprocess.run(['bash', '-c', statement], check=False).returncode
    return cli.main(shlex.split(statement, comments=True)[1:])


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """An empty folder after all commands of the first block, and their exit codes."""
    place = tmp_path_factory.mktemp('empty')
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        for statement in statements(blocks()[0]):
            assert run(statement) == 0, statement
    return place


def test_first_block_runs_as_printed(folder):
    written = {p.name for p in folder.iterdir()}
    assert {'plan', 'run1', 'run2', 'run3', 'noise', 'results', 'both', 'errors.csv'} <= written
    assert (folder / 'plan' / 'otf_path.ngc').exists()


def test_diagnosis_of_the_block_names_what_its_comment_says(folder):
    gap = json.loads((folder / 'diagnosis' / 'gap.json').read_text())
    assert [cause['effect'] for cause in gap['causes']] == ['thermal_axis_expansion']


@pytest.mark.parametrize('name', ['results/error_tables.json', 'diagnosis/gap.json'])
def test_fields_of_the_results_are_those_of_the_conventions(folder, name):
    page = (README.parent / 'docs' / 'conventions.md').read_text(encoding='utf-8')
    section = page.split(f'### {Path(name).name}\n')[1]
    said = json.loads(re.findall(r'```json\n(.*?)```', section, re.DOTALL)[0])
    written = json.loads((folder / name).read_text())
    assert set(said) == set(written)
    for key in ('fit', 'runs', 'gap', 'causes', 'provenance'):
        known, is_there = said.get(key), written.get(key)
        if known and isinstance(known, list):
            known, is_there = known[0], is_there[0]
        if known and isinstance(known, dict):
            assert set(known) == set(is_there), key


def test_runs_of_the_block_are_of_one_machine(folder):
    truths = [load_tables(folder / run / 'truth_tables.json').tables for run in ('run1', 'run3')]
    for name, table in truths[0].motions.items():
        np.testing.assert_array_equal(table.value, truths[1].motions[name].value)
    assert json.loads((folder / 'both' / 'error_tables.json').read_text())['warnings'][1:] == []


def test_tables_of_the_block_leave_little_of_the_truth(folder):
    sizes = json.loads((folder / 'comparison' / 'comparison.json').read_text())
    left = sizes['volume_with_squareness']
    assert left['mae_difference'] < 0.05 * left['mae_b']


def test_points_of_the_block_get_their_errors(folder):
    header, *rows = (folder / 'errors.csv').read_text().splitlines()
    assert header.startswith('x,y,z,dx,dy,dz')
    assert [row.split(',')[:3] for row in rows] == [['0.1', '0.1', '-0.1'], ['0.3', '0.2', '0.0']]


def test_all_other_commands_of_the_section_are_parsed_and_know_their_files(folder):
    known = {p.name for p in folder.iterdir()}
    for statement in (s for block in blocks()[1:] for s in statements(block)):
        words = shlex.split(statement, comments=True)
        arguments = cli._parser().parse_args(words[1:])
        machine = getattr(arguments, 'machine', None) or []
        for name in [machine] if isinstance(machine, str) else machine:
            assert name in known or (README.parent / name).exists(), statement


def test_block_of_the_library_runs_as_printed_after_it(folder, monkeypatch, capsys):
    section = README.read_text(encoding='utf-8').split('## As a library')[1]
    code = re.search(r'```python\n(.*?)```', section, re.DOTALL)[1]
    monkeypatch.chdir(folder)
    left = {}
    exec(code, left)
    tables = json.loads((folder / 'results' / 'error_tables.json').read_text())
    assert left['result'].run_id == tables['run_id']  # what ./otf calibrate run1 found
    assert 'is explained by backlash of X, ' in capsys.readouterr().out
    assert (folder / 'program' / 'plan.json').exists()


JSON = {
    'plan/plan.json': 'plan',
    'run2/truth_tables.json': 'simulate',
    'run2/simulation.json': 'simulate',
    'noise/noise.json': 'noise',
    'both/error_tables.json': 'calibrate',
    'comparison/comparison.json': 'compare',
    'diagnosis/gap.json': 'diagnose',
    'diagnosis/calibration_with_effects/error_tables.json': 'diagnose',
}


@pytest.mark.parametrize('name', JSON)
def test_every_json_of_the_block_says_where_it_comes_from(folder, name):
    block = json.loads((folder / name).read_text())['provenance']
    assert block['verb'] == JSON[name]
    assert block['software']['version'] == otf_core.__version__
    assert block['written'].startswith('20')
    assert 'actual minus nominal' in block['convention']
    assert all(len(run['sha256']) == 64 for run in block.get('runs', ()))
    files = {hashlib.sha256((folder / m).read_bytes()).hexdigest() for m in MACHINES}
    assert {m['sha256'] for m in block.get('machines', ())} <= files


def test_runs_and_machines_of_the_block_are_told_apart(folder):
    block = json.loads((folder / 'both' / 'error_tables.json').read_text())['provenance']
    assert len(block['machines']) == len({run['sha256'] for run in block['runs']}) == 2
    assert [run['name'] for run in block['runs']] == ['run1', 'run3']
    noise = json.loads((folder / 'noise' / 'noise.json').read_text())['provenance']
    assert noise['measured'] == block['runs'][0]['measured']
    files = json.loads((folder / 'comparison' / 'comparison.json').read_text())['provenance']
    tables = (folder / 'results' / 'error_tables.json').read_bytes()
    assert files['files']['a']['sha256'] == hashlib.sha256(tables).hexdigest()


def test_positions_in_the_files_of_the_plan_are_tidy(folder):
    for file, longest in (('path.csv', 12), ('otf_path.ngc', 3)):
        numbers = re.findall(r'-?\d+\.\d+', (folder / 'plan' / file).read_text())
        assert len(numbers) > 50
        assert max(len(n.partition('.')[2]) for n in numbers) <= longest
        assert not [n for n in numbers if n.startswith('-') and float(n) == 0]


def test_results_of_another_verb_are_replaced_whole_and_only_if_asked(folder, monkeypatch):
    monkeypatch.chdir(folder)
    again = ['calibrate', 'run1', '--machine', 'machine.yaml', '--out', 'diagnosis']
    before = (folder / 'diagnosis' / 'gap.json').read_bytes()
    assert cli.main(again) == 2
    assert (folder / 'diagnosis' / 'gap.json').read_bytes() == before
    assert cli.main([*again, '--overwrite']) == 0
    names = {p.name for p in (folder / 'diagnosis').iterdir()}
    assert names == {p.name for p in (folder / 'results').iterdir()}
