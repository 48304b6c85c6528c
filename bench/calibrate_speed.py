# SPDX-License-Identifier: Apache-2.0
"""From bag to error tables, beside rosbags that only reads the same bag; growth to a day of runs.

One simulated run at 500 samples per second; four laps are half a million samples. In turn, each
in a process of its own: a script that reads the bag with rosbags' AnyReader into arrays, ``otf
calibrate``, and a script that calls ``read_bag``, ``calibrate`` and ``write_calibration``. Of
the two scripts also the time without the start of Python. Smallest value and median; ratios are
of the smallest, whole processes and insides apart.

``--growth``: two laps over and over up to so many millions of samples. Time per million, and
peak memory over the 32 bytes of a sample (stamp and three coordinates), with and without what
Python with NumPy and SciPy takes on its own. Ten million samples are a bag of half a gigabyte.

``--rotary``: machines with three and with five axes, the tracker on the bed and on the table,
each a recording of about 300 000 samples (ten minutes at 500 Hz); in turn, processor time of
``otf calibrate`` and its ratio to that of three axes.

Usage: python bench/calibrate_speed.py [--laps N] [--repeats N]
       python bench/calibrate_speed.py --rotary [--repeats N]
       python bench/calibrate_speed.py --growth [1,2,5,10] [--folder SCRATCH]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from child import Cost, circumstances, measured, spread
from markdown import heading, numbers, row

JOBS = Path(__file__).with_name('calibrate_jobs.py')
ROOT = Path(__file__).resolve().parents[1]
MACHINE = ROOT / 'src/otf_bringup/config/machine.yaml'
TRUNNION = ROOT / 'examples/trunnion.yaml'
SAMPLES, SLOW = 300_000, 20
"""Samples of a recording of ``--rotary``, and rate, Hz, at which its duration is found out."""
SEED = 20_260_011
BYTES = 32
"""of a sample: int64 stamp, three float64"""


def command(bag: Path, out: Path, machine: Path = MACHINE) -> list[str | Path]:
    """Words of the command."""
    config = out.parent / 'no-report.yaml'
    config.write_text('report: false\n', encoding='utf-8')
    words = ['calibrate', bag, '--machine', machine, '--out', out, '--overwrite']
    return ['-m', 'otf_core.cli', *words, '--config', config]


def inside(costs: list[Cost], name: str) -> list[float]:
    """One of the times that a script printed."""
    return [json.loads(cost.text)[name] for cost in costs]


def beside_rosbags(folder: Path, laps: int, repeats: int) -> None:
    """Print the table of whole processes and the one of their insides."""
    bag = folder / 'bag'
    config = folder / 'laps.yaml'
    config.write_text(f'passes: {laps}\n', encoding='utf-8')
    words = ['simulate', '--machine', MACHINE, '--out', bag, '--config', config]
    measured(['-m', 'otf_core.cli', *words, '--seed', str(SEED)])
    lines = {
        'rosbags AnyReader, read only': [JOBS, 'rosbags', bag],
        '`otf calibrate`': command(bag, folder / 'command'),
        '`read_bag`, `calibrate`, `write_calibration`': [JOBS, 'calibrate', bag, folder / 'out'],
    }
    costs: dict[str, list[Cost]] = {name: [] for name in lines}
    for _ in range(repeats):
        for name, line in lines.items():
            costs[name].append(measured(line))
    rosbags, _, script = costs.values()
    found = (json.loads(script[0].text)[name] for name in ('pieces', 'unknowns'))
    samples, pieces, unknowns = json.loads(rosbags[0].text)['samples'], *found
    size = f'{samples} samples, {pieces} pieces, {unknowns} unknowns'
    print(f'{size}; {repeats} times in turn, {circumstances()}\n')
    print(heading(('whole process', 'wall s', 'ratio', 'processor s', 'ratio', 'peak MB')))
    first = [min(getattr(c, what) for c in rosbags) for what in ('wall', 'processor')]
    for name, own in costs.items():
        wall, processor = [c.wall for c in own], [c.processor for c in own]
        print(row((name, spread(wall), f'{min(wall) / first[0]:.2f}', spread(processor),
                   f'{min(processor) / first[1]:.2f}',
                   spread([c.peak / 1e6 for c in own], '.0f'))))  # fmt: skip
    print('\n' + heading(('without the start of Python', 'wall s', 'ratio')))
    reading = inside(rosbags, 'read')
    print(row(('rosbags AnyReader, read only', spread(reading), '1.00')))
    for name, words in (('all', 'bag to files'), ('read', '- reading'), ('solve', '- calibrating'),
                        ('write', '- writing')):  # fmt: skip
        own = inside(script, name)
        print(row((words, spread(own), f'{min(own) / min(reading):.2f}')))


def growth(folder: Path, millions: tuple[float, ...]) -> None:
    """Print time and memory of ``otf calibrate`` by the number of samples."""
    empty = measured(['-c', 'import numpy, scipy.sparse.linalg, scipy.ndimage, otf_core']).peak
    print(f'{circumstances()}; imports alone {empty / 1e6:.0f} MB\n')
    print(heading(('million samples', 'wall s', 'wall s per million', 'processor s per million',
                   'peak MB', 'peak / samples', 'without imports')))  # fmt: skip
    for million in millions:
        bag = folder / f'{million:g}.mcap'
        if not bag.exists():
            measured([JOBS, 'repeat', str(round(1e6 * million)), bag])
        cost, size = measured(command(bag, folder / 'out')), 1e6 * million * BYTES
        print(row((f'{million:g}', f'{cost.wall:.1f}', f'{cost.wall / million:.2f}',
                   f'{cost.processor / million:.2f}', f'{cost.peak / 1e6:.0f}',
                   f'{cost.peak / size:.1f}', f'{(cost.peak - empty) / size:.1f}')),
              flush=True)  # fmt: skip


def recorded(machine: Path, bag: Path, samples: int = SAMPLES) -> Path:
    """Simulate a run of about so many samples, and return its bag."""
    words = ['-m', 'otf_core.cli', 'simulate', '--machine', machine, '--seed', str(SEED), '--out']
    measured([*words, f'{bag}-slow', '--rate', str(SLOW)])
    slow = json.loads(Path(f'{bag}-slow/simulation.json').read_text(encoding='utf-8'))
    count = slow['provenance']['runs'][0]['samples']
    measured([*words, bag, '--rate', f'{SLOW * samples / count:.1f}'])
    return bag


def beside_three_axes(folder: Path, repeats: int) -> None:
    """Print the processor time of three and of five axes."""
    table = folder / 'table.yaml'
    table.write_text(TRUNNION.read_text(encoding='utf-8').replace('link: b}', 'link: w}'))
    machines = {'three axes': MACHINE, 'five axes, tracker on the bed': TRUNNION,
                'five axes, tracker on the table': table}  # fmt: skip
    bags = {name: recorded(one, folder / f'bag-{k}') for k, (name, one) in
            enumerate(machines.items())}  # fmt: skip
    costs: dict[str, list[Cost]] = {name: [] for name in machines}
    for _ in range(repeats):
        for name, one in machines.items():
            costs[name].append(measured(command(bags[name], folder / 'out', one)))
    print(f'{SAMPLES} samples each; {repeats} times in turn, {circumstances()}\n')
    print(heading(('machine', 'processor s', 'ratio', 'peak MB')))
    first = min(c.processor for c in costs['three axes'])
    for name, own in costs.items():
        processor = [c.processor for c in own]
        print(row((name, spread(processor), f'{min(processor) / first:.2f}',
                   spread([c.peak / 1e6 for c in own], '.0f'))))  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--laps', type=int, default=4)
    parser.add_argument('--repeats', type=int, default=10)
    parser.add_argument('--growth', type=numbers, nargs='?', const=(1, 2, 5, 10))
    parser.add_argument('--rotary', action='store_true')
    parser.add_argument('--folder', type=Path, help='keeps the bags of --growth for the next time')
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if chosen.growth:
            growth(folder, chosen.growth)
        elif chosen.rotary:
            beside_three_axes(Path(scratch), chosen.repeats)
        else:
            beside_rosbags(Path(scratch), chosen.laps, chosen.repeats)


if __name__ == '__main__':
    main()
