# SPDX-License-Identifier: Apache-2.0
"""Smooth machines of an independent nature: what ``calibrate`` leaves, and whether u holds.

Cells of ``src/otf_core/test/nature.py`` (exact 4x4 kinematics, own drive and tracker, error
motions that know nothing of tables): 0.6 x 0.5 x 0.4 m, nodes every 30 mm, the default path both
ways at two feeds, 60 um and 90 urad, noise 0.5 um and 1.5 urad of which a share of the variance is
correlated over 0.3 s. Beside it ordinary least squares on the same pieces (the paper's Eq. 7).

Grid error on 216 points that are neither nodes nor on the path, rigid motion removed of both
sides: left is the mean length after over before. Within 2 u: share of the components; |error|/u:
their median. ``--conditions``: at 200 Hz, each row departs from the above in one condition.

Usage: PYTHONPATH=src/otf_core python bench/smooth_machines.py [--seeds N] [--first-seed S]
           [--forms A,B] [--rates 20,200,1000] [--colours 0,0.6] [--chains C,D] [--quick]
           [--conditions] [--workers N]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import multiprocessing
import sys
from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'src/otf_core/test'))

import numpy as np
from common import heading, numbers, row, texts
from nature import SQUARE, Cell, Extra, hat, influences, judge, judge_field
from nature_forms import FORMS, nodes_of
from nature_tracker import Noise

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.errors import OtfError

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
RATES, COLOURS = (20.0, 200.0, 1000.0), (0.0, 0.6)
SIZE = (0.6, 0.5, 0.4)
RCOND = 1e-9


def table_columns(cell, q):
    """Displacement (n, 3, m) at q per squareness error and value at a node of a table."""
    influence = influences(cell.chain, cell.offset, q)
    columns = [influence[name][:, :, None] for name in SQUARE]
    for name in sorted(influence.keys() - set(SQUARE)):
        axis = cell.machine.axes[name[2]]
        weights = hat(nodes_of(axis.min, axis.max, axis.table_pitch), q[:, 'XYZ'.index(name[2])])
        columns.append(influence[name][:, :, None] * weights[:, None, :])
    return np.concatenate(columns, axis=2)


def ordinary_least_squares(cell, run):
    """Grid error left, %, by Eq. 7: tables straight between nodes, rows all alike."""
    pose = [np.broadcast_to(unit, run.q.shape) for unit in np.eye(3)]
    pose += [np.cross(unit, run.q) for unit in np.eye(3)]
    whole = np.concatenate([np.stack(pose, axis=2), table_columns(cell, run.q)], axis=2)
    rows = np.einsum('cij,ijk->cik', run.axes, whole).reshape(-1, whole.shape[2])
    found = np.linalg.lstsq(rows, run.deviation.ravel(), rcond=RCOND)[0][6:]
    q = cell.lattice()
    flat = table_columns(cell, q).reshape(3 * len(q), -1)
    return judge_field(q, cell.error(q).ravel(), flat, found).left_percent


def judged(cell: Mapping[str, Any], rate: float, noise: Mapping[str, float]) -> tuple | None:
    """Calibrate one cell: judgement, and what least squares leave, %; None where it is refused."""
    made = Cell(**cell)
    try:
        result = calibrate_recordings([made.recording(rate, Noise(**noise))])
    except OtfError as error:
        print(f'{cell}: {error}', file=sys.stderr)
        return None
    own = judge(made, result.tables, result.covariance_run)
    return own, ordinary_least_squares(made, result.runs[0])


def conditions() -> dict[str, dict[str, Any]]:
    """What departs from the reference: rate, noise, and arguments of the cell."""
    found: dict[str, dict[str, Any]] = {'reference': {}}
    found |= {f'rate {r} Hz': {'rate': float(r)} for r in (10, 20, 50, 1000, 5000)}
    found |= {f'noise {f:g} of the specified': {'noise': {'factor': f}} for f in (0.1, 0.3, 3, 10)}
    found['noise white'] = {'noise': {'colour': 0.0}}
    for colour in (0.6, 0.93):
        found |= {f'colour {colour:g}, tau {t:g} s': {'noise': {'colour': colour, 'tau': t}}
                  for t in (0.05, 1, 5, 20)}  # fmt: skip
    found['heavy tails t3'] = {'noise': {'tails': 3.0, 'colour': 0.0}}
    found['heavy tails t3, colour 0.6'] = {'noise': {'tails': 3.0}}
    for n in (13, 8, 5, 4):
        found[f'nodes 1/{n} of the range'] = {'cell': {'pitch': tuple(s / n for s in SIZE)}}
    for t, r in ((5, 8), (500, 750)):
        sizes = {'translation': t * 1e-6, 'rotation': r * 1e-6}
        found[f'errors {t} um, {r} urad'] = {'cell': sizes}
    extras = {
        'cyclic 5 um, 40 mm, X': Extra(cyclic=(5e-6, 0, 0)),
        'cyclic 5 um, 40 mm, XYZ': Extra(cyclic=(5e-6, 5e-6, 5e-6)),
        'cyclic 5 um, 10 mm, X': Extra(cyclic=(5e-6, 0, 0), period=0.01),
        'drift 20 um': Extra(drift=(0, 0, 20e-6)),
        'drift 20 um x, y, z': Extra(drift=(20e-6, 20e-6, 20e-6)),
        'servo 0.1 ms X': Extra(lag=(1e-4, 0, 0)),
    }
    return found | {name: {'cell': {'extra': extra}} for name, extra in extras.items()}


def groups(given: argparse.Namespace) -> dict[str, list[tuple]]:
    """Arguments of ``judged`` for the cells of every row."""
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    found = defaultdict(list)
    for form in given.forms:
        for name, one in conditions().items() if given.conditions else ():
            for k, seed in enumerate(seeds):
                cell = {'seed': seed, 'chain': given.chains[k % len(given.chains)], 'form': form,
                        'size': SIZE, 'pitch': tuple(s / 20 for s in SIZE)}  # fmt: skip
                arguments = cell | one.get('cell', {}), one.get('rate', 200.0)
                found[f'{form}, {name}'].append((*arguments, one.get('noise', {})))
        for rate in () if given.conditions else given.rates:
            for colour in given.colours:
                found[f'{form}, {rate:g} Hz, colour {colour:g}'] = [
                    ({'seed': seed, 'chain': chain, 'form': form}, rate, {'colour': colour})
                    for seed in seeds
                    for chain in given.chains
                ]
    return found


def summary(cases: list[tuple]) -> str:
    """How all cells together stand to what is asked for."""
    left = [own.left_percent for own, _ in cases]
    within = [own.within_2u_percent for own, _ in cases]
    over = [own.left_percent / ols for own, ols in cases]
    return (
        f'{len(cases)} recordings: {np.median(left):.2f} % left in the median, {max(left):.2f} % '
        f'at worst; over least squares {np.median(over):.2f}, {max(over):.2f} at worst; within '
        f'2 u {np.mean(within):.1f} % on average, {min(within):.1f} % at worst'
    )


def main(given: argparse.Namespace) -> None:
    """Run all groups and print the table."""
    print(heading(['cells', 'before, um', 'OLS (Eq. 7), % left', 'calibrate, % left',
                   'within 2 u, % (worst)', 'median error/u']))  # fmt: skip
    cases = []
    with ProcessPoolExecutor(given.workers, multiprocessing.get_context('spawn')) as pool:
        jobs = {name: [pool.submit(judged, *one) for one in own]
                for name, own in groups(given).items()}  # fmt: skip
        for name, own in jobs.items():
            found = [one for job in own if (one := job.result())]
            if not found:
                continue
            cases += found
            left, ols = [j.left_percent for j, _ in found], [o for _, o in found]
            within = [j.within_2u_percent for j, _ in found]
            before, ratio = ([getattr(j, what) for j, _ in found]
                             for what in ('before_um', 'median_ratio'))  # fmt: skip
            print(row([name, f'{np.mean(before):.0f}',
                       f'{np.median(ols):.2f} ({max(ols):.2f})',
                       f'{np.median(left):.2f} ({max(left):.2f})',
                       f'{np.mean(within):.1f} ({min(within):.1f})',
                       f'{np.median(ratio):.2f}']), flush=True)  # fmt: skip
    print(f'\n{summary(cases)}')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('--forms', type=texts, default=FORMS, help=', '.join(FORMS))
    parser.add_argument('--rates', type=numbers, default=RATES, help='Hz')
    parser.add_argument('--colours', type=numbers, default=COLOURS, help='shares of the variance')
    parser.add_argument('--chains', type=texts, default=CHAINS)
    parser.add_argument('--quick', action='store_true', help='one seed, coloured, no 1000 Hz')
    parser.add_argument('--conditions', action='store_true', help='one condition a row')
    parser.add_argument('--workers', type=int, default=1, help='cells at once')
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.rates, options.colours = 1, (20.0, 200.0), (0.6,)
    main(options)
