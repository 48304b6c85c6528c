# SPDX-License-Identifier: Apache-2.0
"""What compensation leaves on lines that were not fitted, on LinuxCNC, three ways, by machine.

Each round is `otf loop` as a user types it: drive, measure, calibrate, compensate, drive other
lines. Takes about two minutes a round; LinuxCNC has to be installed.

Usage: .venv/bin/python bench/closed_loop.py
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml
from markdown import heading, row, texts

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
WAYS = 'axes,volume,program'
SEED = 20_261_101
RANGES = {'X': (0.0, 0.3), 'Y': (0.0, 0.25), 'Z': (-0.2, 0.0)}


def machine(chain: str) -> dict[str, object]:
    """Content of a machine.yaml."""
    axes = {a: {'min': low, 'max': high, 'table_pitch': 0.03} for a, (low, high) in RANGES.items()}
    return {
        'name': f'small {chain}', 'chain': chain, 'axes': axes,
        'target_offset': [0.02, -0.03, -0.15], 'tracker': {'u_range': 5e-7, 'u_angle': 2e-6},
    }  # fmt: skip


def loop(folder: Path, chain: str, way: str, seed: int, size: float) -> dict[str, object]:
    """One round; its loop.json."""
    (folder / 'machine.yaml').write_text(yaml.safe_dump(machine(chain)))
    command = [
        sys.executable, '-m', 'otf_core.cli', 'loop', '--machine', folder / 'machine.yaml',
        '--out', folder / way, '--compensate', way, '--seed', seed, '--error-size', size,
        '--quiet',
    ]  # fmt: skip
    done = subprocess.run(list(map(str, command)), check=False)
    if done.returncode not in (0, 4):
        sys.exit(f'{chain}, {way}: exit code {done.returncode}')
    return dict(json.loads((folder / way / 'loop.json').read_text()))


def main() -> None:
    """Print a row a round."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--chains', default=','.join(CHAINS))
    options.add_argument('--ways', default=WAYS)
    options.add_argument('--seed', type=int, default=SEED, help='of the first machine')
    options.add_argument('--error-size', type=float, default=5e-5, help='m, of the machines')
    given = options.parse_args()
    titles = ('chain, way', 'before (um)', 'after (um)', 'less (%)', 'forecast (um)',
              'of the tables (um)', 'of the export (um)', 'of the control (um)',
              'offsets lack, mean (max) (um)')  # fmt: skip
    print(heading(titles), flush=True)
    for number, chain in enumerate(texts(given.chains)):
        for way in texts(given.ways):
            with tempfile.TemporaryDirectory() as name:
                found = loop(Path(name), chain, way, given.seed + number, given.error_size)
            lack = found['external_offsets']
            lag = '' if lack is None else (
                f'{lack["lacking_mean_um"]:.2f} ({lack["lacking_max_um"]:.1f})'
            )  # fmt: skip
            sizes = [found[k] for k in ('before_um', 'after_um', 'fall_percent', 'forecast_um')]
            sizes += [found['left_um'][f'of_{part}'] for part in ('tables', 'export', 'control')]
            cells = [f'{v:.{1 if k == 2 else 2}f}' for k, v in enumerate(sizes)]
            print(row((f'`{chain}`, {way}', *cells, lag)), flush=True)


if __name__ == '__main__':
    main()
