# SPDX-License-Identifier: Apache-2.0
"""Time and peak memory of the commands that plan, and of a large machine from plan to tables.

Planned, with forecast: the small machining centre of the demo, the machines of the recorded bags,
and a gantry of 12 m x 3.5 m x 1.5 m with nodes 0.1 m apart. The gantry's path, driven once, is
then simulated at 500 samples per second and calibrated. Every command is a process of its own,
start of Python included, run once: wall time, processor time, and the largest resident memory.

Usage: PYTHONPATH=src/otf_core python bench/planning_speed.py
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from child import Cost, measured

SEED = 20_260_012
ROOT = Path(__file__).parent.parent
MACHINES = (
    'src/otf_bringup/config/machine.yaml',
    'bags/all-axes-carry-the-target/machine.yaml',
    'bags/x-and-y-carry-the-table/machine.yaml',
    'bags/y-carries-the-table/machine.yaml',
)
GANTRY = """\
name: gantry
chain: w-b-X-Y-Z-t
axes:
  X: {min: 0.0, max: 12.0, table_pitch: 0.1}
  Y: {min: 0.0, max: 3.5, table_pitch: 0.1}
  Z: {min: -1.5, max: 0.0, table_pitch: 0.1}
target_offset: [0.0, 0.0, -0.2]
tracker: {u_range: 0.5e-6, u_angle: 2.0e-6}
"""


def command(*words: str | Path) -> Cost:
    """Run a command of the core in a process of its own; SystemExit if it fails."""
    return measured(['-m', 'otf_core.cli', *words])


def row(name: str, cost: Cost) -> str:
    """Line of the table."""
    return f'| {name} | {cost.wall:.1f} | {cost.processor:.1f} | {cost.peak / 1e6:.0f} |'


def main() -> None:
    """Print the table, row by row."""
    print(f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')
    print('| command | wall s | processor s | peak MB |\n|---|---:|---:|---:|', flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for number, machine in enumerate(MACHINES):
            cost = command('plan', '--machine', ROOT / machine, '--out', folder / f'plan{number}')
            name = 'demo cell' if number == 0 else Path(machine).parent.name
            print(row(f'plan, {name}', cost), flush=True)
        gantry, plan, bag = folder / 'gantry.yaml', folder / 'plan', folder / 'bag'
        gantry.write_text(GANTRY, encoding='utf-8')
        (folder / 'once.yaml').write_text('passes: 1\n', encoding='utf-8')
        once = ('--config', folder / 'once.yaml')
        print(row('plan, gantry', command('plan', '--machine', gantry, '--out', plan, *once)))
        run = ('--machine', gantry, '--path', plan / 'plan.json', '--seed', str(SEED))
        print(row('simulate, gantry', command('simulate', *run, '--out', bag)), flush=True)
        out = folder / 'tables'
        cost = command('calibrate', bag, '--machine', gantry, '--out', out)
        print(row('calibrate, gantry', cost))


if __name__ == '__main__':
    main()
