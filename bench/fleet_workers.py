# SPDX-License-Identifier: Apache-2.0
"""A fleet on 1, 2 and more workers: time, memory, the same bits, with one worker killed.

A few simulated bags are listed several times under other names, with broken ones among them; what
is measured is the command `otf fleet calibrate` from start to end.

Usage: .venv/bin/python bench/fleet_workers.py
"""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from markdown import heading, numbers, row

ROOT = Path(__file__).resolve().parents[1]
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
OTF = [sys.executable, '-m', 'otf_core.cli']
SEED = 20_260_501
SIMULATED = ('--levels', '2', '--passes', '1', '--rate', '100', '--corner-dwell', '0.05')


def make(folder: Path, runs: int, broken: int, bags: int) -> Path:
    """Simulated bags, and a list that names them again and again; its path."""
    lines = ['name,bag,machine']
    for k in range(bags):
        command = [*OTF, 'simulate', '--machine', MACHINE, '--out', folder / f'bag{k}', '--seed',
                   str(SEED + k), '--quiet', *SIMULATED]  # fmt: skip
        subprocess.run(list(map(str, command)), check=True)
    for k in range(runs - broken):
        lines.append(f'run{k:03d},bag{k % bags},{MACHINE}')
    for k in range(broken):
        (folder / f'broken{k}.mcap').write_bytes(os.urandom(1000))
        lines.insert(2 + k * (runs // broken), f'broken{k},broken{k}.mcap,{MACHINE}')
    (folder / 'runs.csv').write_text('\n'.join(lines) + '\n')
    return folder / 'runs.csv'


def kill_a_run(fleet: int) -> bool:
    """Kill the first process that the fleet has started; False if there is none."""
    children = Path(f'/proc/{fleet}/task').glob('*/children')
    for child in ' '.join(c.read_text() for c in children).split():
        os.kill(int(child), signal.SIGKILL)
        return True
    return False


def measured(runs: Path, workers: int, *, kill: bool) -> tuple[float, float, str]:
    """Seconds, peak memory of the largest process (MB), hash of fleet.json."""
    out = runs.parent / f'out-{workers}-{kill}'
    command = [*OTF, 'fleet', 'calibrate', '--list', str(runs), '--out', str(out), '--workers',
               str(workers), '--quiet']  # fmt: skip
    start = time.monotonic()
    process = subprocess.Popen(command)
    waiting = kill
    while waiting and process.poll() is None:
        time.sleep(3.0)
        waiting = not kill_a_run(process.pid)
    _, _, usage = os.wait4(process.pid, 0)
    digest = hashlib.sha256((out / 'fleet.json').read_bytes()).hexdigest()
    return time.monotonic() - start, usage.ru_maxrss / 1024, digest


def main() -> None:
    """Print a row a fleet."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--runs', type=int, default=200)
    options.add_argument('--broken', type=int, default=5)
    options.add_argument('--bags', type=int, default=10)
    options.add_argument('--workers', default='1,2,4')
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        runs = make(Path(name), given.runs, given.broken, given.bags)
        print(f'{given.runs} runs, {given.broken} of them broken, {os.cpu_count()} cores')
        titles = ('workers', 'wall (s)', 's per run', 'largest process (MB)', 'fleet.json')
        print(heading(titles), flush=True)
        asked = [(int(w), False) for w in numbers(given.workers)]
        for workers, kill in [*asked, (asked[-1][0], True)]:
            seconds, memory, digest = measured(runs, workers, kill=kill)
            words = f'{workers}{", a run killed" if kill else ""}'
            print(row((words, f'{seconds:.0f}', f'{seconds / given.runs:.2f}', f'{memory:.0f}',
                       f'`{digest[:12]}`')), flush=True)  # fmt: skip


if __name__ == '__main__':
    main()
