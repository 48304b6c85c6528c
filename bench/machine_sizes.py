# SPDX-License-Identifier: Apache-2.0
"""Time and memory by size: large machines, long recordings, five axes, many machines.

Two or three sizes each, so that a row shows whether its costs grow in proportion. Every command is
a process of its own, start of Python included:

- ``nodes``: a gantry of 3 m and of 6 m in X, 2 m x 1 m, nodes 50 mm apart; its path, driven once,
  is simulated at 500 samples per second and calibrated (number of samples);
- ``samples``: 5 and 10 million samples of the demo machine, see ``calibrate_speed.py --growth``;
- ``axes``: a trunnion with 150 000 and 300 000 samples;
- ``machines``: ``otf history`` with the page of a store of 10, 100 and 200 machines, calibrated
  four times each.

Usage: python bench/machine_sizes.py [--only nodes,samples,axes,machines] [--folder SCRATCH]
"""

from __future__ import annotations

import argparse
import copy
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from calibrate_speed import JOBS, MACHINE, SEED, TRUNNION, command, recorded
from child import Cost, circumstances, measured
from markdown import heading, row, texts

CLI = ['-m', 'otf_core.cli']
GANTRY = """\
name: gantry
chain: w-b-X-Y-Z-t
axes:
  X: {{min: 0.0, max: {length}, table_pitch: 0.05}}
  Y: {{min: 0.0, max: 2.0, table_pitch: 0.05}}
  Z: {{min: -1.0, max: 0.0, table_pitch: 0.05}}
target_offset: [0.0, 0.0, -0.2]
tracker: {{u_range: 0.5e-6, u_angle: 2.0e-6}}
"""
CALIBRATIONS = 4
"""Of every machine of a store."""
Line = tuple[str, int, Cost]


def gantries(folder: Path) -> Iterator[Line]:
    """Calibrations of a gantry of two lengths, m."""
    for length in (3.0, 6.0):
        machine, plan, bag = (folder / f'{length:g}m-{part}' for part in ('y', 'plan', 'bag'))
        machine.write_text(GANTRY.format(length=length), encoding='utf-8')
        once = folder / 'once.yaml'
        once.write_text('passes: 1\n', encoding='utf-8')
        measured([*CLI, 'plan', '--machine', machine, '--out', plan, '--config', once])
        run = ['--machine', machine, '--path', plan / 'plan.json', '--seed', str(SEED)]
        measured([*CLI, 'simulate', *run, '--out', bag])
        facts = json.loads((bag / 'simulation.json').read_text(encoding='utf-8'))
        samples = facts['provenance']['runs'][0]['samples']
        yield f'gantry of {length:g} m', samples, measured(command(bag, folder / 'out', machine))


def long_bags(folder: Path) -> Iterator[Line]:
    """Calibrations of long recordings."""
    for million in (5, 10):
        bag, samples = folder / f'{million}.mcap', 1_000_000 * million
        if not bag.exists():
            measured([JOBS, 'repeat', str(samples), bag])
        yield f'{million} million samples', samples, measured(command(bag, folder / 'out'))


def five_axes(folder: Path) -> Iterator[Line]:
    """Calibrations of a machine with two rotary axes."""
    for samples in (150_000, 300_000):
        bag = recorded(TRUNNION, folder / f'trunnion-{samples}', samples)
        yield 'five axes', samples, measured(command(bag, folder / 'out', TRUNNION))


def stores(folder: Path) -> Iterator[Line]:
    """Pages of the histories of many machines."""
    bag = folder / 'demo'
    measured([*CLI, 'simulate', '--machine', MACHINE, '--out', bag, '--rate', '50', '--seed', '1'])
    measured(command(bag, folder / 'tables'))
    found = json.loads((folder / 'tables/error_tables.json').read_text(encoding='utf-8'))
    for machines in (10, 100, 200):
        store = folder / f'store-{machines}'
        measured([__file__, '--fill', store, '--from', write(found, folder), str(machines)])
        out = ['--out', folder / f'page-{machines}']
        yield 'page of a history', machines, measured([*CLI, 'history', store, *out])


def write(data: dict, folder: Path) -> Path:
    """Write tables into a file of a folder, and return it."""
    path = folder / 'one.json'
    path.write_text(json.dumps(data), encoding='utf-8')
    return path


def fill(store: Path, tables: Path, machines: int) -> None:
    """Make a store of so many machines, calibrated monthly; each time EXX has grown a little."""
    from otf_core.history.store import add_run

    found = json.loads(tables.read_text(encoding='utf-8'))
    for number in range(machines):
        for month in range(CALIBRATIONS):
            data = copy.deepcopy(found)
            data['machine']['name'] = f'machine {number}'
            table = data['motions']['EXX']
            share = 1e-6 * month * (1 + number % 3)
            grown = zip(table['value'], table['position'], strict=True)
            table['value'] = [value + share * at for value, at in grown]
            add_run(store, write(data, tables.parent), f'2026-{month + 1:02d}-01')


CASES = {'nodes': gantries, 'samples': long_bags, 'axes': five_axes, 'machines': stores}


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--only', type=texts, default=tuple(CASES))
    parser.add_argument('--folder', type=Path, help='keeps bags and stores for the next time')
    parser.add_argument('--fill', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('--from', type=Path, dest='tables', help=argparse.SUPPRESS)
    parser.add_argument('machines', type=int, nargs='?', help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.fill:
        fill(given.fill, given.tables, given.machines)
        return
    print(circumstances() + '\n')
    print(heading(('what', 'size', 'wall s', 'processor s', 'per 1000', 'peak MB')), flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in given.only:
            for what, size, cost in CASES[name](folder):
                print(row((what, size, f'{cost.wall:.1f}', f'{cost.processor:.1f}',
                           f'{1e3 * cost.processor / size:.3g}', f'{cost.peak / 1e6:.0f}')),
                      flush=True)  # fmt: skip


if __name__ == '__main__':
    main()
