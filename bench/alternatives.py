# SPDX-License-Identifier: Apache-2.0
"""What one would take instead, on the same bag: time, memory, and the error that is left.

Side by side, in turn, each in a process of its own: the dense pseudo-inverse of the paper (Eq. 7),
SciPy's sparse least squares on the same rows, the general solvers of SciPy and Ceres with pose
and tables together, and ``otf_core``. All but the last read with rosbags and reduce samples as
``simple_pieces`` does; none of those states what its tables are worth.

Seconds run from bag to tables in memory, without imports of NumPy, SciPy and rosbags; peak memory
is that of the process until then; the error left is the mean length on a grid, rigid motion
removed, against the truth of the simulation. Cases: 'simulate' (the project's, machine.yaml of
otf_bringup: true tables have the nodes that are solved for), and forms of the independent
simulator src/otf_core/test/nature.py, which shares no formula with any of them.

Ceres takes part if ``pip install pyceres`` was done; it is no dependency of the project.

Usage: python bench/alternatives.py [--cases simulate,waves] [--seed S] [--repeats N]
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from importlib.util import find_spec
from pathlib import Path

from child import circumstances, measured, spread
from markdown import heading, row, texts

JOBS = Path(__file__).with_name('alternatives_jobs.py')
SEED = 20_260_031
WAYS = {
    'pinv': 'rosbags, dense pseudo-inverse (Eq. 7)',
    'lsqr': 'rosbags, `scipy.sparse.linalg.lsqr`',
    'least_squares': 'rosbags, `scipy.optimize.least_squares`',
    'ceres': 'rosbags, Ceres (pyceres)',
    'otf': '`otf_core.calibrate`',
}


def compare(folder: Path, ways: list[str], repeats: int) -> dict[str, list[dict]]:
    """Print-outs of every way on a case, one after the other, ``repeats`` times."""
    found: dict[str, list[dict]] = {way: [] for way in ways}
    for _ in range(repeats):
        for way in ways:
            text = measured([JOBS, way, folder]).text
            found[way].append(json.loads(text.splitlines()[-1]))
    return found


def show(found: dict[str, list[dict]]) -> None:
    """Print the table of a case; ratios are of the smallest times, to those of otf_core."""
    own = min(one['wall'] for one in found['otf'])
    print(heading(('way', 'rows', 'unknowns', 'wall s', 'ratio', 'processor s', 'peak MB',
                   'error left um', 'part')))  # fmt: skip
    for way, runs in found.items():
        wall, first = [one['wall'] for one in runs], runs[0]
        print(row((WAYS[way], first['rows'], first['unknowns'], spread(wall),
                   f'{min(wall) / own:.2f}', spread([one['processor'] for one in runs]),
                   f'{statistics.median(one["peak"] for one in runs) / 1e6:.0f}',
                   f'{first["left"]:.3f}',
                   f'{100 * first["left"] / first["before"]:.2f} %')))  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--cases', type=texts, default=('simulate', 'waves'))
    parser.add_argument('--seed', type=int, default=SEED)
    parser.add_argument('--repeats', type=int, default=5)
    chosen = parser.parse_args()
    ways = [way for way in WAYS if way != 'ceres' or find_spec('pyceres')]
    if 'ceres' not in ways:
        print('without Ceres: pip install pyceres')
    with tempfile.TemporaryDirectory() as scratch:
        for case in chosen.cases:
            folder = Path(scratch) / case
            made = json.loads(measured([JOBS, 'make', folder, case, str(chosen.seed)]).text)
            found = compare(folder, ways, chosen.repeats)
            print(f'\n{case}, seed {chosen.seed}: {made["samples"]} samples, mean error '
                  f'{found["otf"][0]["before"]:.1f} um; {circumstances()}\n')  # fmt: skip
            show(found)


if __name__ == '__main__':
    main()
