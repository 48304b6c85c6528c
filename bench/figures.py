# SPDX-License-Identifier: Apache-2.0
"""Every figure that pages print, with its command: one script makes them again.

Usage: python3 bench/figures.py              list them
       python3 bench/figures.py NAME ...     run those, one after the other
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FIGURES = {
    'paper': 'bench/paper_2_1.py',
    'smooth': 'bench/smooth_machines.py --seeds 3 --first-seed 72001 --colours 0.6 '
    '--forms waves,swell,bumps,kinked,polygon --chains w-Y-b-X-Z-t',
    'conditions': 'bench/smooth_machines.py --conditions --seeds 2 --first-seed 71001 '
    '--forms waves',
    'blind': 'bench/blind --trials 68 --rotary 40 --leave-out 14 --seed 836915 --out blind',
    'alternatives': 'bench/alternatives.py --repeats 5',
    'speed': 'bench/speed.py',
    'growth': 'bench/speed.py --growth',
    'packages': 'tools/house.py docs/images/house.svg',
    'tables': 'tools/page_tables.py',
}


def main(names: list[str]) -> int:
    """List the figures, or run some; the exit code of the first that fails."""
    for name in names or FIGURES:
        if name not in FIGURES:
            print(f'{name}: no figure; known: {", ".join(FIGURES)}', file=sys.stderr)
            return 2
        print(f'{name}: python3 {FIGURES[name]}', flush=True)
        if names:
            words = [sys.executable, *shlex.split(FIGURES[name])]
            own = {**os.environ, 'PYTHONPATH': str(ROOT / 'src/otf_core')}
            if code := subprocess.run(words, cwd=ROOT, env=own, check=False).returncode:
                return code
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
