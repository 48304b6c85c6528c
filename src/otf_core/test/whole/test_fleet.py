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

import pytest
from cli_cells import run

from otf_core.errors import ConfigError
from otf_core.fleet import fleet as fleet_module
from otf_core.fleet.document import fleet_document
from otf_core.fleet.fleet import read_list
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


def test_a_run_whose_quality_gate_failed_is_done_and_shows_in_the_exit_code(plant):
    (plant / 'gate.mcap').write_text('')
    (plant / 'runs.csv').write_text('name,bag,machine\ng,gate.mcap,machine.yaml\n')
    assert fleet('out') == 4
    assert told(plant / 'out')['done'] == 1
    assert told(plant / 'out')['runs']['g']['message'] == 'NOT GOOD'


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
