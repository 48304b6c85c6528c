# SPDX-License-Identifier: Apache-2.0
"""Commands as whole processes: wall time, processor time, peak memory.

Every bag is simulated from a seed just before. Disturbances only add time, so the smallest value
of the repetitions counts. ``--growth``: one path, driven 4, 10 and 20 times.

Usage: python bench/speed.py [--repeats N] [--growth]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from common import ROOT, heading, measured, row

CELL = ROOT / 'src/otf_bringup/config/machine.yaml'
FIVE = ROOT / 'bags/trunnion/machine.yaml'
EFFECTS = """- {effect: backlash, parameters: {B_X: 5.0e-6}}
- {effect: thermal_axis_expansion, parameters: {S_Y: 3.0e-5, tau: 100.0, order: 1}}
"""


def commands(folder: Path) -> dict[str, list[str]]:
    """Words of every command that is measured, on what ``simulate`` has written."""
    out, quiet = ['--out', folder / 'out', '--overwrite'], ['--config', folder / 'quiet.yaml']
    tables = ['--tables', folder / 'laps/truth_tables.json']
    listed = {
        '`--help` of a verb': ['calibrate', '--help'],
        '`predict` of two points': ['predict', *tables, '--points', folder / 'points.csv',
                                    '--out', folder / 'errors.csv', '--overwrite'],
        '`plan` with forecast': ['plan', '--machine', CELL, *out],
        '`calibrate`, two laps': ['calibrate', folder / 'laps', '--machine', CELL, *out, *quiet],
        '`calibrate`, five axes': ['calibrate', folder / 'five', '--machine', FIVE, *out, *quiet],
        '`diagnose`, two effects': ['diagnose', folder / 'effects', '--machine', CELL, *out],
    }  # fmt: skip
    return {name: list(map(str, words)) for name, words in listed.items()}


def simulate(folder: Path, name: str, machine: Path, *words: object) -> int:
    """Write a bag; its number of samples."""
    own = ['simulate', '--machine', machine, '--out', folder / name, '--json', *words]
    text = measured(['-m', 'otf_core.cli', *map(str, own)]).text
    (count,) = [line for line in text.splitlines() if '"samples":' in line][:1] or ['0']
    return int(''.join(filter(str.isdigit, count)))


def show(listed: dict[str, list[str]], repeats: int) -> None:
    """Print a table of commands."""
    print(f'{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n')
    print(heading(('command', 'wall s', 'processor s', 'peak MB')))
    for name, words in listed.items():
        costs = [measured(['-m', 'otf_core.cli', *words]) for _ in range(repeats)]
        print(row((name, f'{min(c.wall for c in costs):.2f}',
                   f'{min(c.processor for c in costs):.2f}',
                   f'{min(c.peak for c in costs):.0f}')), flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--growth', action='store_true')
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'quiet.yaml').write_text('report: false\n')
        if chosen.growth:
            listed = {}
            for laps in (4, 10, 20):
                (folder / 'laps.yaml').write_text(f'passes: {laps}\n')
                count = simulate(folder, f'laps-{laps}', CELL, '--config', folder / 'laps.yaml')
                words = commands(folder)['`calibrate`, two laps']
                words[1] = str(folder / f'laps-{laps}')
                listed[f'{count} samples'] = words
        else:
            (folder / 'points.csv').write_text('x,y,z\n0.1,0.1,-0.1\n0.3,0.2,0.0\n')
            (folder / 'effects.yaml').write_text(EFFECTS)
            simulate(folder, 'laps', CELL, '--seed', 11)
            simulate(folder, 'five', FIVE, '--seed', 11, '--rate', 250)
            simulate(folder, 'effects', CELL, '--seed', 11, '--effects', folder / 'effects.yaml')
            listed = commands(folder)
        show(listed, chosen.repeats)


if __name__ == '__main__':
    main()
