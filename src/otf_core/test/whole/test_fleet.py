# SPDX-License-Identifier: Apache-2.0
"""Many runs at once: order, restart, broken bags, killed workers, the same bits always."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_cells import CONTENT
from cli_cells import run

from otf_core.bags.bag import BagContent, write_bag
from otf_core.errors import ConfigError
from otf_core.fleet import fleet as fleet_module
from otf_core.fleet.document import fleet_document
from otf_core.fleet.fleet import listed_jobs, read_list
from otf_core.prediction.calibration_document import load_tables
from otf_core.reports.fleet_report import fleet_rows

STUB = """
import json, os, pathlib, sys
verb, bag, out = sys.argv[2], sys.argv[3], pathlib.Path(sys.argv[7])
with open(os.environ['CALLS'], 'a') as calls:
    calls.write(f'{out.name}\\n')
if 'broken' in pathlib.Path(bag).name:
    sys.exit('otf calibrate: broken: no bag')
out.mkdir(exist_ok=True)
name = pathlib.Path(bag).name
offset = [0.0, 0.0, -0.25 if 'longer' in name else -0.15]
sizes = {'mean': 1e-5, 'max': 2e-5}
data = {'headline': {'error': sizes, 'u_of_largest': 1e-6, 'k': 2.0,
                     'u': sizes, 'u_run': sizes},
        'verdicts': {'measurement': {'good': 'gate' not in name, 'sentence': 'NOT GOOD'},
                     'machine': {'state': 'fail' if 'limit' in name else 'not stated'}},
        'machine': {'name': 'm', 'target_offset': offset},
        'when': os.environ['SOURCE_DATE_EPOCH'], 'bag': bag, 'not_identifiable': [],
        'squareness': {k: {'value': 1e-6, 'u': 5e-8} for k in ('C0Y', 'B0Z', 'A0Z')},
        'target_offset_bound': {'offset': offset,
                                'contains': {'A0Z': ['EAZ']} if 'offset' in name else {}}}
(out / 'error_tables.json').write_text(json.dumps(data))
sys.exit(4 if 'gate' in name else 5 if 'limit' in name else 0)
"""


@pytest.fixture
def plant(tmp_path, monkeypatch):
    """Six listed runs, two of them broken, done by a stand-in for the command."""
    (tmp_path / 'stub.py').write_text(STUB)
    monkeypatch.setattr(fleet_module, 'COMMAND', (sys.executable, str(tmp_path / 'stub.py')))
    monkeypatch.setenv('CALLS', str(tmp_path / 'calls'))
    monkeypatch.chdir(tmp_path)
    rows = ['name,bag,machine']
    for name in ('a', 'b', 'c', 'd', 'broken-1', 'broken-2'):
        (tmp_path / f'{name}.mcap').write_text(name)
        rows.append(f'{name},{name}.mcap,machine.yaml')
    (tmp_path / 'machine.yaml').write_text('name: m\n')
    (tmp_path / 'runs.csv').write_text('\n'.join(rows) + '\n')
    return tmp_path


def fleet(out, workers=2):
    return run('fleet', 'calibrate', '--list', 'runs.csv', '--out', out, '--workers', workers)


def told(folder):
    return json.loads((folder / 'fleet.json').read_text())


def test_broken_bags_end_nothing_but_themselves_and_workers_change_no_bit(plant, capsys):
    assert [fleet('one', 1), fleet('three', 3)] == [4, 4]
    assert (plant / 'one/fleet.json').read_bytes() == (plant / 'three/fleet.json').read_bytes()
    data = told(plant / 'one')
    assert (data['done'], data['failed']) == (4, 2)
    assert list(data['runs']) == ['a', 'b', 'c', 'd', 'broken-1', 'broken-2']
    result = (plant / 'three/c/error_tables.json').read_bytes()
    assert data['runs']['c']['sha256'] == hashlib.sha256(result).hexdigest()
    assert data['runs']['broken-1'] == {
        'exit': 1, 'message': 'otf calibrate: broken: no bag', 'sha256': None
    }  # fmt: skip
    page = (plant / 'one/fleet.html').read_text()
    assert 'broken-2' in page and '://' not in page
    assert '4 of 6 runs done, 2 failed' in capsys.readouterr().out


def test_a_fleet_goes_on_where_it_stopped_and_sees_changed_inputs(plant):
    fleet('out')
    before = (plant / 'calls').read_text().count('\n')
    (plant / 'b.mcap').write_text('another bag')
    (plant / 'out/c/error_tables.json').unlink()
    fleet('out')
    again = (plant / 'calls').read_text().splitlines()[before:]
    assert sorted(again) == ['b', 'broken-1', 'broken-2', 'c']
    assert told(plant / 'out')['done'] == 4


def test_the_run_of_a_killed_worker_is_done_again(plant, monkeypatch):
    fleet('whole')
    killed = []

    class Killing(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__(command, **options)
            if 'b.mcap' in command[4] and not killed:
                killed.append(self.pid)
                self.send_signal(signal.SIGKILL)

    monkeypatch.setattr(fleet_module.subprocess, 'Popen', Killing)
    fleet('out')
    assert killed
    assert told(plant / 'out') == told(plant / 'whole')


def test_a_run_that_is_killed_each_time_fails_alone(plant, monkeypatch):
    class Killing(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__(command, **options)
            if 'b.mcap' in command[4]:
                self.send_signal(signal.SIGKILL)

    monkeypatch.setattr(fleet_module.subprocess, 'Popen', Killing)
    fleet('out')
    data = told(plant / 'out')
    assert data['done'] == 3
    assert 'killed by signal 9 in 3 tries' in data['runs']['b']['message']


def test_a_run_whose_quality_gate_failed_is_done_and_shows_in_the_exit_code(plant):
    (plant / 'gate.mcap').write_text('')
    (plant / 'runs.csv').write_text('name,bag,machine\ng,gate.mcap,machine.yaml\n')
    assert fleet('out') == 4
    assert told(plant / 'out')['done'] == 1
    assert told(plant / 'out')['runs']['g']['message'] == 'NOT GOOD'


def test_every_run_gets_the_config_and_a_changed_one_is_another_input(plant, capsys):
    (plant / 'runs.csv').write_text('name,bag,machine\na,a.mcap,machine.yaml\n')
    given = ('fleet', 'calibrate', '--list', 'runs.csv', '--out', 'out', '--config', 'c.yaml')
    for text in ('piece_length: 0.016', 'piece_length: 0.016', 'piece_length: 0.02'):
        (plant / 'c.yaml').write_text(text)
        assert run(*given) == 0
    assert (plant / 'calls').read_text() == 'a\na\n'
    (plant / 'c.yaml').write_text('passes: 2')
    capsys.readouterr()
    assert run(*given) == 2
    assert 'passes: a key of otf plan, simulate only' in capsys.readouterr().err
    jobs = listed_jobs('calibrate', read_list('runs.csv'), plant / 'out', 'c.yaml')
    assert jobs[0].words[-3:] == ('--config', str(plant / 'c.yaml'), '--overwrite')


def test_a_machine_out_of_its_limits_is_no_measurement_that_failed(plant, capsys):
    rows = ['name,bag,machine', 'x,limit.mcap,machine.yaml']
    (plant / 'limit.mcap').write_text('')
    (plant / 'runs.csv').write_text('\n'.join(rows) + '\n')
    assert fleet('out') == 5
    said = capsys.readouterr().out
    assert 'limits of the machine not proven to be met: x' in said
    assert 'not good' not in said
    page = (plant / 'out/fleet.html').read_text(encoding='utf-8')
    assert '1 with limits of the machine not proven to be met' in page and '>broken<' in page
    (plant / 'gate.mcap').write_text('')
    (plant / 'runs.csv').write_text('\n'.join([*rows, 'g,gate.mcap,machine.yaml']) + '\n')
    assert fleet('out') == 4
    said = capsys.readouterr().out
    assert 'measurement not good: g' in said and 'not proven to be met: x' in said


def test_runs_with_other_target_offsets_are_not_compared_silently(plant, capsys):
    rows = ['name,bag,machine', 'a,offset.mcap,machine.yaml', 'b,offset_b.mcap,machine.yaml']
    for name in ('offset', 'offset_b', 'longer_offset'):
        (plant / f'{name}.mcap').write_text('')
    (plant / 'runs.csv').write_text('\n'.join(rows) + '\n')
    assert fleet('out') == 0
    said = capsys.readouterr().out
    assert '* holds at the target offset of its run only: A0Z contain' in said
    assert 'WARNING' not in said
    (plant / 'runs.csv').write_text('\n'.join([*rows, 'c,longer_offset.mcap,machine.yaml']) + '\n')
    assert fleet('out') == 0
    warning = (
        'WARNING target offsets differ ((0, 0, -150) mm: a, b; (0, 0, -250) mm: c): compare these '
        'values among runs of one offset only.'
    )
    assert warning in capsys.readouterr().out
    assert told(plant / 'out')['warnings'][1] == warning
    page = (plant / 'out/fleet.html').read_text(encoding='utf-8')
    assert '1.00 ± 0.10*' in page.replace('\u00a0', ' ') and 'target offsets differ' in page


def test_folders_of_others_and_fleets_of_other_verbs_are_left_alone(plant, capsys):
    (plant / 'mine').mkdir()
    (plant / 'mine/file').write_text('mine')
    assert fleet('mine') == 2
    fleet('out')
    assert run('fleet', 'diagnose', '--list', 'runs.csv', '--out', 'out') == 2
    assert 'holds a fleet of calibrate' in capsys.readouterr().err
    assert (plant / 'mine/file').read_text() == 'mine'


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('bag,machine\n', 'line 1: expected the header name,bag,machine'),
        ('name,bag,machine\n', 'lists no runs'),
        ('name,bag,machine\na,b\n', 'line 2: expected name,bag,machine'),
        ('name,bag,machine\n../a,b,m\n', 'not a folder name'),
        ('name,bag,machine\na,b,m\na,c,m\n', 'line 3: the name a appears twice'),
    ],
)
def test_a_wrong_list_is_refused_with_its_line(tmp_path, text, said):
    (tmp_path / 'runs.csv').write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_list(tmp_path / 'runs.csv')


KILLING = """
import os, pathlib, signal, sys
first = pathlib.Path(os.environ['CALLS'] + '.killed')
if 'b.mcap' in sys.argv[3] and not first.exists():
    first.write_text('')
    os.kill(os.getppid(), signal.SIGKILL)
"""


@pytest.fixture
def dask(plant, monkeypatch):
    """Address of a Dask scheduler with two workers; who first does run b is killed by it."""
    pytest.importorskip('distributed', reason='optional: only --scheduler needs Dask')
    (plant / 'killing.py').write_text(KILLING + STUB)
    stub = (sys.executable, str(plant / 'killing.py'))
    (plant / 'as_stub.py').write_text(
        f'from otf_core.fleet import fleet\n\nfleet.COMMAND = {stub!r}\n'
    )
    places = (str(Path(fleet_module.__file__).parents[2]), os.environ.get('PYTHONPATH', ''))
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(places))
    common = ['--scheduler-file', 'dask.json', '--no-dashboard']
    words = [[sys.executable, '-m', 'distributed.cli.dask_scheduler', '--port', '0', *common]]
    one = [sys.executable, '-m', 'distributed.cli.dask_worker', '--no-nanny', '--nthreads', '1']
    words += [[*one, '--preload', 'as_stub.py', '--death-timeout', '60', *common]] * 2
    with open(plant / 'dask.log', 'w') as log:
        started = [subprocess.Popen(w, stdout=log, stderr=log) for w in words]
        try:
            end = time.monotonic() + 60
            there = plant / 'dask.json'
            # it is there before it is written
            while not (there.exists() and there.read_text()) and time.monotonic() < end:
                time.sleep(0.05)
            yield json.loads(there.read_text())['address'], started[1:]
        finally:
            for process in started:
                process.kill()
                process.wait()


def test_dask_workers_give_the_bits_of_processes_though_one_is_killed(plant, dask):
    address, workers = dask
    fleet('here')
    words = ('--list', 'runs.csv', '--out', 'there', '--scheduler', address)
    assert run('fleet', 'calibrate', *words) == 4
    assert (plant / 'there/fleet.json').read_bytes() == (plant / 'here/fleet.json').read_bytes()
    result = [(plant / n / 'b/error_tables.json').read_bytes() for n in ('here', 'there')]
    assert result[0] == result[1]
    assert sorted(worker.poll() is None for worker in workers) == [False, True]


def test_a_scheduler_needs_dask(plant, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    arguments = ('--list', 'runs.csv', '--out', 'out', '--scheduler', 'tcp://localhost:1')
    assert run('fleet', 'calibrate', *arguments) == 2
    assert 'pip install distributed' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('words', 'said'),
    [(('calibrate',), '--list'), (('blind', '--list', 'a.csv'), 'blind')],
)
def test_a_fleet_needs_a_list_and_a_verb_for_it(tmp_path, capsys, words, said):
    assert run('fleet', *words, '--out', tmp_path / 'out') == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_a_squareness_that_was_not_seen_is_no_zero_in_the_table(tmp_path):
    sizes = {'mean': 1e-5, 'max': 2e-5}
    data = {
        'headline': {'error': sizes, 'u_of_largest': 1e-6, 'k': 2.0,
                     'u': sizes, 'u_run': sizes},
        'verdicts': {'measurement': {'good': True}, 'machine': {'state': 'not stated'}},
        'machine': {'name': 'm', 'target_offset': [0.0, 0.0, 0.0]},
        'not_identifiable': ['B0Z', 'EAZ'],
        'target_offset_bound': {'offset': [0.0, 0.0, 0.0], 'contains': {}},
        'squareness': {'C0Y': {'value': 1e-6, 'u': 5e-8}, 'B0Z': {'value': 0.0, 'u': 0.0},
                       'A0Z': {'value': 0.0, 'u': 5e-8}},
    }  # fmt: skip
    (tmp_path / 'flat').mkdir()
    (tmp_path / 'flat/error_tables.json').write_text(json.dumps(data))
    done = {'flat': fleet_module.JobResult(0, '', 'digest')}
    columns, (row,), _ = fleet_rows(fleet_document('calibrate', tmp_path, done).to_dict())
    shown = dict(zip(columns, row, strict=True))
    assert [shown[f'{k} (urad)'] for k in ('C0Y', 'B0Z', 'A0Z')] == [
        '1.00 +/- 0.10', 'not known', '0.00 +/- 0.10',
    ]  # fmt: skip


def test_real_bags_give_what_calibrating_gives(cell, calibrated, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump(cell.machine.to_dict()))
    write_bag(tmp_path / 'good', BagContent(cell.recording.measured(cell.truth), cell.path))
    write_bag(tmp_path / 'short', CONTENT)
    rows = ['name,bag,machine', 'g,good,machine.yaml', 's,short,machine.yaml']
    (tmp_path / 'runs.csv').write_text('\n'.join(rows) + '\n')
    assert fleet('out') == 4
    data = told(tmp_path / 'out')
    assert data['runs']['g']['exit'] == 0
    assert data['runs']['s']['exit'] == 3
    tables = load_tables(tmp_path / 'out/g/error_tables.json').tables
    for name, table in calibrated.tables.motions.items():
        np.testing.assert_array_equal(tables.motions[name].value, table.value)
