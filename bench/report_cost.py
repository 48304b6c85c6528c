# SPDX-License-Identifier: Apache-2.0
"""What the report of a calibration costs: ``otf calibrate`` with and without it, in turn.

Usage: PYTHONPATH=src/otf_core python bench/report_cost.py [--repeats 5]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from calibrate_jobs import MACHINE
from child import circumstances, measured, spread
from markdown import heading, row

SEED = 20_260_012


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--repeats', type=int, default=5)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        words = ['simulate', '--machine', MACHINE, '--out', folder / 'bag', '--seed', str(SEED)]
        print(measured(['-m', 'otf_core.cli', *words]).text.strip())
        command = ['-m', 'otf_core.cli', 'calibrate', folder / 'bag', '--machine', MACHINE]
        kinds = {'with report.html': [], '`--no-report`': ['--no-report']}
        costs = {name: [] for name in kinds}
        for number in range(repeats):
            for name, more in kinds.items():
                out = folder / f'{len(more)}-{number}'
                costs[name].append(measured([*command, '--out', out, *more]))
        print(f'{repeats} times in turn, {circumstances()}\n')
        print(heading(('otf calibrate', 'processor s', 'peak MB')))
        for name, own in costs.items():
            peak = spread([c.peak / 1e6 for c in own], '.0f')
            print(row((name, spread([c.processor for c in own]), peak)))
        page = (folder / '0-0' / 'report.html').stat().st_size
        print(f'\nreport.html: {page / 1e3:.0f} kB')


if __name__ == '__main__':
    main()
