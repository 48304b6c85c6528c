# SPDX-License-Identifier: Apache-2.0
"""A fleet on 1, 2 and more workers: time, memory, the same bits, with one worker killed.

Simulated bags of a small machine, listed several times under other names, with broken ones among
them; what is measured is the command `otf fleet calibrate` from start to end. Bags and results
stay in a folder, so that more fleets of the same list can be run beside or after.

Usage: .venv/bin/python bench/fleet_workers.py FOLDER [--workers 1,2,4] [--kill 2]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import yaml
from child import circumstances
from markdown import heading, numbers, row

MACHINE = {
    'name': 'small',
    'chain': 'w-Y-b-X-Z-t',
    'axes': {
        'X': {'min': 0.0, 'max': 0.3, 'table_pitch': 0.1},
        'Y': {'min': 0.0, 'max': 0.2, 'table_pitch': 0.1},
        'Z': {'min': -0.2, 'max': 0.0, 'table_pitch': 0.1},
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 5e-7, 'u_angle': 2e-6},
}
OTF = [sys.executable, '-m', 'otf_core.cli']
SEED = 20_261_122
SIMULATED = {'levels': 2, 'passes': 1, 'rate': 50, 'corner_dwell': 0.02, 'feed': 1.0}


def make(folder: Path, runs: int, broken: int, bags: int) -> Path:
    """Simulated bags, and a list that names them again and again; its path."""
    listed = folder / 'runs.csv'
    if listed.exists():
        return listed
    folder.mkdir(parents=True, exist_ok=True)
    machine = folder / 'machine.yaml'
    machine.write_text(yaml.safe_dump(MACHINE))
    config = folder / 'config.yaml'
    config.write_text(yaml.safe_dump(SIMULATED))
    lines = ['name,bag,machine']
    for k in range(bags):
        command = [*OTF, 'simulate', '--machine', machine, '--out', folder / f'bag{k}', '--seed',
                   SEED + k, '--config', config]  # fmt: skip
        subprocess.run(list(map(str, command)), check=True)
    for k in range(runs - broken):
        lines.append(f'run{k:03d},bag{k % bags},machine.yaml')
    for k in range(broken):
        (folder / f'broken{k}.mcap').write_bytes(os.urandom(1000))
        lines.insert(2 + k * (runs // broken), f'broken{k},broken{k}.mcap,machine.yaml')
    listed.write_text('\n'.join(lines) + '\n')
    return listed


def kill_a_run(fleet: int) -> bool:
    """Kill the first process that the fleet has started; False if there is none."""
    children = Path(f'/proc/{fleet}/task').glob('*/children')
    for child in ' '.join(c.read_text() for c in children).split():
        os.kill(int(child), signal.SIGKILL)
        return True
    return False


def measured(runs: Path, workers: int, *, kill: bool) -> tuple[float, float, float, Path]:
    """Seconds, processor seconds, peak memory of the largest process (MB), fleet.json."""
    out = runs.parent / f'out-{workers}'
    command = [*OTF, 'fleet', 'calibrate', '--list', str(runs), '--out', str(out), '--workers',
               str(workers)]  # fmt: skip
    start = time.monotonic()
    with open(runs.parent / f'said-{workers}.txt', 'w') as said:
        process = subprocess.Popen(command, stderr=said)
    waiting = kill
    while waiting and process.poll() is None:
        time.sleep(3.0)
        waiting = not kill_a_run(process.pid)
    _, _, used = os.wait4(process.pid, 0)
    seconds = time.monotonic() - start
    return seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, out / 'fleet.json'


def main() -> None:
    """Print a row a fleet."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('folder', type=Path)
    options.add_argument('--runs', type=int, default=200)
    options.add_argument('--broken', type=int, default=5)
    options.add_argument('--bags', type=int, default=10)
    options.add_argument('--workers', default='1,2,4')
    options.add_argument('--first', type=int, help='only so many lines of the list')
    options.add_argument('--kill', type=int, default=2, help='fleet whose run is killed once')
    given = options.parse_args()
    runs = make(given.folder.absolute(), given.runs, given.broken, given.bags)
    if given.first:
        lines = runs.read_text().splitlines()[: 1 + given.first]
        runs = runs.with_name(f'runs-{given.first}.csv')
        runs.write_text('\n'.join(lines) + '\n')
    broken = f'{given.broken} of {given.runs} broken'
    print(f'{given.first or given.runs} runs, {broken}; {circumstances()}\n')
    titles = ('workers', 'done', 'failed', 'processor time per run (s)', 'wall (s)',
              'largest process (MB)', 'fleet.json')  # fmt: skip
    print(heading(titles), flush=True)
    for workers in map(int, numbers(given.workers)):
        kill = workers == given.kill
        seconds, used, memory, file = measured(runs, workers, kill=kill)
        data, digest = json.loads(file.read_text()), hashlib.sha256(file.read_bytes()).hexdigest()
        print(row((f'{workers}{", a run killed" if kill else ""}', data['done'], data['failed'],
                   f'{used / (given.first or given.runs):.2f}', f'{seconds:.0f}', f'{memory:.0f}',
                   f'`{digest[:12]}`')), flush=True)  # fmt: skip
    for name, run in data['runs'].items():
        if run['exit']:
            print(f'\n{name}: exit {run["exit"]}: {run["message"]}')


if __name__ == '__main__':
    main()
