# SPDX-License-Identifier: Apache-2.0
"""Uncertainty that holds? Share within 2 u, cell by cell of a table of conditions.

Machines of an independent nature (``src/otf_core/test/nature.py``), 0.6 x 0.5 x 0.4 m, default
path both ways, 60 um and 90 urad, noise 0.5 um and 1.5 urad, 60 % of its variance correlated over
0.3 s, 200 Hz, nodes at 1/20 of the range; every row changes one of these. Forms: 'waves' and
'matern' are smooth, 'polygon' is linear between the nodes of the tables. Seeds go round the three
chains.

Judged on 216 points that are neither nodes nor on the path, rigid motion removed of both sides.
Asked for: 90 to 99 % within 2 u and a median of |error|/u of 0.5 to 0.9; rows that depart from it
are marked with *.

Usage: PYTHONPATH=src/otf_core python bench/uncertainty_cells.py [--seeds N] [--first-seed S]
           [--forms A,B] [--only WORD,WORD] [--chains C,D] [--path NAME]
           [--workers N]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'src/otf_core/test'))

import numpy as np
from markdown import heading, row, texts
from nature import Cell, Extra, Judgement, judge
from nature_tracker import Noise
from spread import add_options, spread

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.errors import OtfError

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
FORMS = ('waves', 'matern', 'polygon')
SIZE = (0.6, 0.5, 0.4)
TITLES = ('form, condition', 'within 2 u, %', 'worst', 'median error/u', 'left, % (worst)', '')
WITHIN, RATIO = (90.0, 99.0), (0.5, 0.9)


@dataclass(frozen=True)
class Condition:
    """One row: what departs from the reference.

    ``nodes``: intervals of the tables along every axis. ``rotation`` and ``translation``: sizes.
    """

    name: str
    rate: float = 200.0
    noise: dict = field(default_factory=dict)
    nodes: int = 20
    translation: float = 60e-6
    rotation: float = 90e-6
    extra: Extra = field(default_factory=Extra)


def conditions():
    """All rows of the table."""
    found = [Condition('reference')]
    found += [Condition(f'rate {r:g} Hz', rate=r) for r in (10, 20, 50, 1000, 5000)]
    found += [
        Condition(f'noise {f:g} of the specified', noise={'factor': f}) for f in (0.1, 0.3, 3, 10)
    ]
    found.append(Condition('noise white', noise={'colour': 0.0}))
    for colour in (0.6, 0.93):
        found += [
            Condition(f'colour {colour:g}, tau {t:g} s', noise={'colour': colour, 'tau': t})
            for t in (0.05, 1, 5, 20)
        ]
    found.append(Condition('heavy tails t3', noise={'tails': 3.0, 'colour': 0.0}))
    found.append(Condition('heavy tails t3, colour 0.6', noise={'tails': 3.0}))
    found += [Condition(f'nodes 1/{n} of the range', nodes=n) for n in (13, 8, 5, 4)]
    found += [
        Condition(f'errors {t:g} um, {r:g} urad', translation=t * 1e-6, rotation=r * 1e-6)
        for t, r in ((5, 8), (500, 750))
    ]
    found += [
        Condition('cyclic 5 um, 40 mm, X', extra=Extra(cyclic=(5e-6, 0, 0))),
        Condition('cyclic 5 um, 40 mm, XYZ', extra=Extra(cyclic=(5e-6, 5e-6, 5e-6))),
        Condition('cyclic 5 um, 10 mm, X', extra=Extra(cyclic=(5e-6, 0, 0), period=0.01)),
        Condition('drift 20 um', extra=Extra(drift=(0, 0, 20e-6))),
        Condition('drift 20 um x, y, z', extra=Extra(drift=(20e-6, 20e-6, 20e-6))),
        Condition('servo 0.1 ms X', extra=Extra(lag=(1e-4, 0, 0))),
    ]
    return found


def judged(row, form, chain, seed, path):
    """Calibrate one cell and judge it, as plain data; None where it is refused."""
    condition = conditions()[row]
    cell = Cell(
        seed,
        chain,
        SIZE,
        pitch=tuple(s / condition.nodes for s in SIZE),
        form=form,
        translation=condition.translation,
        rotation=condition.rotation,
        path=path,
        extra=condition.extra,
    )
    try:
        result = calibrate_recordings([cell.recording(condition.rate, Noise(**condition.noise))])
    except OtfError as error:
        print(f'{condition.name}, {form}, {chain}, seed {seed}: {error}', file=sys.stderr)
        return None
    judged = judge(cell, result.tables, result.covariance_run)
    return {k: float(v) for k, v in asdict(judged).items()}


def cells_of(judged: list[Judgement | None]):
    """Columns of a row: within 2 u mean and worst, median ratio, left median and worst, mark."""
    known = [j for j in judged if j is not None]
    if not known:
        return ['-', '-', '-', '-', 'refused']
    within = [j.within_2u_percent for j in known]
    ratio = float(np.median([j.median_ratio for j in known]))
    left = [j.left_percent for j in known]
    off = not WITHIN[0] <= np.mean(within) <= WITHIN[1] or not RATIO[0] <= ratio <= RATIO[1]
    refused = len(judged) - len(known)
    return [
        f'{np.mean(within):.1f}',
        f'{min(within):.1f}',
        f'{ratio:.2f}',
        f'{np.median(left):.2f} ({max(left):.2f})',
        ('*' if off else '') + (f' {refused} refused' if refused else ''),
    ]


def main(given):
    """Print the table row by row."""
    print(
        f'{given.seeds} seeds from {given.first_seed}, chains {", ".join(given.chains)} in turn.\n'
    )
    print(heading(TITLES))
    begin, total, off = time.perf_counter(), 0, 0
    rows = [
        (form, k, condition)
        for form in given.forms
        for k, condition in enumerate(conditions())
        if not given.only or any(word in condition.name for word in given.only)
    ]
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    cells = {
        f'{form}-{k}-{seed}': {
            'row': k, 'form': form, 'chain': given.chains[seed % len(given.chains)],
            'seed': seed, 'path': given.path,
        }
        for form, k, _ in rows for seed in seeds
    }  # fmt: skip
    found = spread(judged, cells, given.workers)
    for form, k, condition in rows:
        own = (found.get(f'{form}-{k}-{seed}') for seed in seeds)
        columns = cells_of([None if v is None else Judgement(**v) for v in own])
        total, off = total + 1, off + ('*' in columns[-1])
        print(row([f'{form}, {condition.name}', *columns]), flush=True)
    seconds = time.perf_counter() - begin
    print(f'\n{total - off} of {total} rows within what is asked for; {seconds:.0f} s')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('--forms', type=texts, default=FORMS)
    parser.add_argument('--chains', type=texts, default=CHAINS)
    parser.add_argument('--only', type=texts, default=(), help='rows whose name holds a word')
    parser.add_argument('--path', choices=('default', 'short', 'tour'), default='default')
    add_options(parser)
    main(parser.parse_args())
