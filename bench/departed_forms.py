# SPDX-License-Identifier: Apache-2.0
"""Causes in other forms than the catalogue's, causes of no catalogue, and quiet runs, diagnosed.

Cells of an independent nature (``departed_cells``): 0.6 x 0.5 x 0.4 m, two passes at two feeds.
Named right: a cause that was put in is named or not told from the one named; of a cause of no
catalogue, that the verdict is unknown. Gap: what is left of it on legs that were not fitted on.
Seconds are those of the processor.

Usage: PYTHONPATH=src/otf_core:src/otf_core/test:bench python bench/departed_forms.py
           [--causes A,B,A+B,quiet] [--seeds N] [--first-seed S] [--size UM] [--rate HZ]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import sys
import time

from departed_cells import CAUSES, DEPARTED, TEXTBOOK, UNKNOWN, DepartedCell

from otf_core.diagnosis.diagnose import diagnose
from otf_core.sim.twin import twin_recording

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
SETS = {'departed': DEPARTED, 'unknown': UNKNOWN, 'textbook': TEXTBOOK}
QUIET = 'quiet'


def judged(names, found):
    """Whether the answer names what was put in; of none and unknown, whether it says so."""
    if not names:
        return found.verdict == 'none'
    if set(names) & set(UNKNOWN):
        return found.verdict == 'unknown'
    named = [{c.effect, *c.indistinguishable_from} for c in found.causes]
    return all(any(CAUSES[n][1] & said for said in named) for n in names)


def run(names, seed, size, rate):
    """Diagnose one cell and print a line."""
    cell = DepartedCell(seed, CHAINS[seed % 3], path='short', feed=0.25)
    recording = cell.spoiled_recording(dict.fromkeys(names, size), rate)
    start = time.process_time()
    found = diagnose([recording], twin_recording)
    used = time.process_time() - start
    right, gap = judged(names, found), found.gap
    said = ', '.join(
        f'{c.effect}{"~" if getattr(c, "form", "") == "free" else ""}({"".join(c.axes)})'
        f'{"/" + "/".join(c.indistinguishable_from) if c.indistinguishable_from else ""}'
        for c in found.causes
    )
    unnamed = getattr(found, 'unnamed', None)
    if unnamed is not None:
        said += (
            f' [{"*".join(unnamed.depends_on)} as {unnamed.acts_as}: '
            f'{unnamed.before_um:.2f} -> {unnamed.after_um:.2f}]'
        )
    title = '+'.join(names) or QUIET
    print(
        f'{"ok " if right else "BAD"} {title:24} {seed:4} {found.verdict:16} '
        f'{gap.before_um:6.2f} -> {gap.after_um:6.2f} um {used:5.1f} s  {said}',
        flush=True,
    )
    return right, gap.after_um < gap.before_um / 3


def main(words):
    """Run the cells that are asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--causes', default='departed')
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--first-seed', type=int, default=9000)
    parser.add_argument('--size', type=float, default=4.0)
    parser.add_argument('--rate', type=float, default=100.0)
    asked = parser.parse_args(words)
    causes = [n for part in asked.causes.split(',') for n in SETS.get(part, [part])]
    done = []
    for k, title in enumerate(causes):
        names = [] if title == QUIET else title.split('+')
        for seed in range(asked.seeds):
            done.append(run(names, asked.first_seed + 10 * seed + k, asked.size, asked.rate))
    rights = sum(right for right, _ in done)
    thirds = sum(third for _, third in done)
    print(f'right {rights} of {len(done)}, gap left below a third in {thirds}')


if __name__ == '__main__':
    main(sys.argv[1:])
