# SPDX-License-Identifier: Apache-2.0
"""Smooth machines: ``calibrate`` beside ordinary least squares and beside what could be known.

Cells of an independent nature (``src/otf_core/test/nature.py``: exact 4x4 kinematics, own drive
and tracker, error motions that know nothing of tables): 0.6 x 0.5 x 0.4 m, nodes every 30 mm, the
default path both ways at two feeds, 60 um and 90 urad, noise 0.5 um and 1.5 urad of which a share
of the variance is correlated over 0.3 s. All estimators get the same pieces of the same
recordings; see ``linear_estimators``: ordinary least squares (the paper's Eq. 7), white weights,
generalised least squares with the true colour, calibrate, and two limits that know the noise:
'roughness known', a Gaussian process with the true length and size of every motion, and the
'oracle', which knows the covariance over the ensemble of the form.

Grid error on 216 points that are neither nodes nor on the path, rigid motion removed of both
sides: left is the mean length after over before. Within 2 u: share of the components; |error|/u:
their median. Seconds: of calibrate all of it, of the others the solution alone.

Usage: PYTHONPATH=src/otf_core python bench/smooth_machines.py [--seeds N] [--first-seed S]
           [--forms A,B] [--rates 20,200,1000] [--colours 0,0.6] [--chains C,D] [--limits N]
           [--quick]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import sys
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from linear_estimators import KINDS, LIMITS, estimate, judge_estimate
from markdown import heading, numbers, row, texts
from nature import Cell, Judgement, judge
from nature_forms import FORMS
from nature_tracker import Noise

from otf_core.calibration.calibrate import calibrate_recordings

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
RATES = (20.0, 200.0, 1000.0)
COLOURS = (0.0, 0.6)
OURS = 'calibrate'
METHODS = (*KINDS[:3], OURS, *LIMITS)
TITLES = {
    'ols': 'OLS (Eq. 7)',
    'white': 'white weights',
    'gls': 'GLS, true colour',
    OURS: 'calibrate',
    'rough': 'roughness known',
    'oracle': 'oracle',
}
TITLES_IN_ORDER = tuple(TITLES[m] for m in METHODS)
WORSE_THAN_OLS, WORSE_THAN_LIMIT, WORSE_WITH_RATE = 1.05, 1.2, 1.15


@dataclass(frozen=True)
class Case:
    """One recording: what every method left of its errors, and the seconds it took."""

    group: tuple
    machine: tuple
    judged: dict[str, Judgement]
    seconds: dict[str, float]

    def left(self, method):
        """Grid error left, %; nan where the method did not run."""
        return self.judged[method].left_percent if method in self.judged else np.nan


def run_case(form, rate, colour, chain, seed, with_limits):
    """Simulate one recording and give it to every method."""
    cell, noise = Cell(seed, chain, form=form), Noise(colour=colour)
    recording = cell.recording(rate, noise)
    start = time.perf_counter()
    result = calibrate_recordings([recording])
    seconds = {OURS: time.perf_counter() - start}
    judged = {OURS: judge(cell, result.tables, result.covariance_run)}
    for kind in KINDS if with_limits else KINDS[:3]:
        start = time.perf_counter()
        found = estimate(cell, result.runs[0], noise, kind)
        seconds[kind] = time.perf_counter() - start
        judged[kind] = judge_estimate(cell, found)
    return Case((form, rate, colour), (form, colour, chain, seed), judged, seconds)


def spread(values, worst=max, digits=2):
    """Median and worst of what is there."""
    known = [v for v in values if np.isfinite(v)]
    if not known:
        return '-'
    return f'{np.median(known):.{digits}f} ({worst(known):.{digits}f})'


def name(group):
    """First column of the tables."""
    form, rate, colour = group
    return f'{form}, {rate:g} Hz, {"white" if not colour else f"colour {colour:g}"}'


def left_row(group, cases):
    """Grid error left by every method, and ratios to the limits."""
    before = np.mean([c.judged[OURS].before_um for c in cases])
    cells = [spread([c.left(m) for c in cases]) for m in METHODS]
    ratios = [spread([c.left(OURS) / c.left(m) for c in cases]) for m in ('ols', *LIMITS)]
    return row([name(group), f'{before:.0f}', *cells, *ratios])


def honest_row(group, cases):
    """Within 2 u, median of error over u, seconds."""
    cells = []
    for method in METHODS:
        known = [c.judged[method] for c in cases if method in c.judged]
        if not known:
            cells.append('-')
            continue
        within = [j.within_2u_percent for j in known]
        ratio = np.median([j.median_ratio for j in known])
        cells.append(f'{np.mean(within):.0f} ({min(within):.0f}), {ratio:.2f}')
    seconds = [np.mean([c.seconds[m] for c in cases if m in c.seconds] or [0]) for m in METHODS]
    return row([name(group), *cells, ' / '.join(f'{s:.1f}' for s in seconds)])


def rate_ratios(cases):
    """Left at the highest rate over left at the lowest, machine by machine."""
    by_machine = defaultdict(dict)
    for c in cases:
        by_machine[c.machine][c.group[1]] = c.left(OURS)
    return [r[max(r)] / r[min(r)] for r in by_machine.values() if len(r) > 1]


def summary(cases):
    """How all cells together stand to what is asked for."""
    left = [c.left(OURS) for c in cases]
    within = [c.judged[OURS].within_2u_percent for c in cases]
    ols = np.array([c.left(OURS) / c.left('ols') for c in cases])
    rates = np.array(rate_ratios(cases))
    lines = [
        f'{len(cases)} recordings: {np.median(left):.2f} % left in the median, '
        f'{max(left):.2f} % at worst',
        f'within 2 u: {np.mean(within):.1f} % on average, {min(within):.1f} % at worst',
        f'over ordinary least squares: {np.median(ols):.2f} in the median, {ols.max():.2f} at '
        f'worst, more than {WORSE_THAN_OLS} in {np.sum(ols > WORSE_THAN_OLS)}',
    ]
    if rates.size:
        lines.append(
            f'highest over lowest rate: {np.median(rates):.2f} in the median, {rates.max():.2f} '
            f'at worst, more than {WORSE_WITH_RATE} in {np.sum(rates > WORSE_WITH_RATE)}'
        )
    for limit in LIMITS:
        over = np.array([c.left(OURS) / c.left(limit) for c in cases if limit in c.judged])
        if over.size:
            lines.append(
                f'over {TITLES[limit]} ({over.size} recordings): {np.median(over):.2f} in the '
                f'median, {over.max():.2f} at worst, more than {WORSE_THAN_LIMIT} in '
                f'{np.sum(over > WORSE_THAN_LIMIT)}'
            )
    return '\n'.join(f'- {line}' for line in lines)


def main(given):
    """Run all groups and print the tables."""
    groups, cases = defaultdict(list), []
    for form in given.forms:
        for rate in given.rates:
            for colour in given.colours:
                for seed in range(given.first_seed, given.first_seed + given.seeds):
                    for chain in given.chains:
                        limits = seed < given.first_seed + given.limits
                        case = run_case(form, rate, colour, chain, seed, limits)
                        groups[case.group].append(case)
                        cases.append(case)
                        print(case.group, chain, seed, f'{case.left(OURS):.2f} %',
                              file=sys.stderr, flush=True)  # fmt: skip
    last = given.first_seed + given.seeds - 1
    print(f'Seeds {given.first_seed} to {last}, chains {", ".join(given.chains)}.\n')
    print('Grid error left, %: median (worst); calibrate over OLS and over the limits likewise.\n')
    print(
        heading(
            ['cells', 'before, um', *TITLES_IN_ORDER, 'over OLS', 'over roughness', 'over oracle']
        )
    )
    print('\n'.join(left_row(g, c) for g, c in groups.items()))
    print('\nComponents within 2 u, %: mean (worst); then the median of |error|/u.\n')
    print(heading(['cells', *TITLES_IN_ORDER, f's: {" / ".join(METHODS)}']))
    print('\n'.join(honest_row(g, c) for g, c in groups.items()))
    print(f'\n{summary(cases)}')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('--forms', type=texts, default=FORMS, help=', '.join(FORMS))
    parser.add_argument('--rates', type=numbers, default=RATES, help='Hz')
    parser.add_argument('--colours', type=numbers, default=COLOURS, help='shares of the variance')
    parser.add_argument('--chains', type=texts, default=CHAINS)
    parser.add_argument('--limits', type=int, default=2, help='seeds that get the limits as well')
    parser.add_argument('--quick', action='store_true', help='one seed, coloured, no 1000 Hz')
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.limits = 1, 1
        options.rates, options.colours = (20.0, 200.0), (0.6,)
    main(options)
