# SPDX-License-Identifier: Apache-2.0
"""Time of whole processes that do next to nothing: ./otf --help, of every verb, and predict.

Wall time, shortest of some repeats, and its ratio to ``python -c pass`` in the same run.

Usage: PYTHONPATH=src/otf_core python bench/start_up.py
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from otf_core.cli import _parser

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / 'bags/y-carries-the-table'
REPEATS = 9


def shortest(command: list[str | Path], repeats: int = REPEATS) -> float:
    """Shortest wall time of some runs of a command, s."""
    best = float('inf')
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        best = min(best, time.perf_counter() - start)
    return best


def predicting(folder: Path) -> list[str | Path]:
    """Calibrate a recorded bag, and return the command that predicts one point of it."""
    out, points = folder / 'results', folder / 'points.csv'
    inputs = [BAG / 'bag', '--machine', BAG / 'machine.yaml']
    subprocess.run([ROOT / 'otf', 'calibrate', *inputs, '--out', out], capture_output=True)
    points.write_text('x,y,z\n0.1,0.1,-0.1\n')
    words = ['--tables', out / 'error_tables.json', '--points', points]
    return [ROOT / 'otf', 'predict', *words, '--out', folder / 'errors.csv', '--overwrite']


def main() -> None:
    otf = ROOT / 'otf'
    with tempfile.TemporaryDirectory() as scratch:
        commands: dict[str, list[str | Path]] = {'python -c pass': [sys.executable, '-c', 'pass']}
        commands['otf --help'] = [otf, '--help']
        commands |= {f'otf {verb} --help': [otf, verb, '--help'] for verb in _parser().verbs}
        commands['otf predict, one point'] = predicting(Path(scratch))
        base = None
        for name, command in commands.items():
            seconds = shortest(command)
            base = base or seconds
            print(f'{name:24}{1e3 * seconds:8.0f} ms{seconds / base:8.1f}')


if __name__ == '__main__':
    main()
