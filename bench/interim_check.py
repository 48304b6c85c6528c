# SPDX-License-Identifier: Apache-2.0
"""Interim checks of machines that have not changed, and of machines that have: how many alarm.

Machines of three kinematic chains in turn, calibrated once; then two-minute runs of the interim
path of their history, tracker place and noise drawn anew for each: of the same machine, and of
machines that have drifted since by errors of all motions drawn at random.

Usage: PYTHONPATH=src/otf_core:bench python bench/interim_check.py [--machines N] [--first-seed S]
           [--steady N] [--drifts UM,UM] [--each N]
"""

from __future__ import annotations

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import json
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from coverage import drawn
from markdown import heading, numbers, row
from scipy.stats import beta

from otf_core.calibration.calibrate import calibrate
from otf_core.config import PlannerConfig
from otf_core.history.control_chart import history_of, uncertainty
from otf_core.history.interim_check import interim_check, interim_path
from otf_core.history.store import add_run, read_store
from otf_core.model.plan import plan_for_path
from otf_core.model.tables import ErrorTables, MotionTable
from otf_core.pieces.runs import Recording
from otf_core.planning.path_creation import plan_path
from otf_core.reports.calibration import result_to_dict
from otf_core.sim.cell import random_tables, simulate


def added(tables: ErrorTables, drift: ErrorTables) -> ErrorTables:
    """Errors of a machine after a drift; both have the same nodes."""
    motions = {
        name: MotionTable(table.position, table.value + drift.motions[name].value, table.u)
        for name, table in tables.motions.items()
    }
    square = {
        name: replace(entry, value=entry.value + drift.squareness[name].value)
        for name, entry in tables.squareness.items()
    }
    return replace(tables, motions=motions, squareness=square)


def checks(seed: int, steady: int, drifts: tuple[float, ...], each: int):
    """Yield drift (um), mean u of the tables (um) and the check, run by run."""
    machine, config, truth = drawn(seed, smooth=False)
    plan = plan_path(machine, PlannerConfig(levels=2))
    result = calibrate(simulate(machine, plan, config, truth).samples, plan.path, machine)
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / 'error_tables.json'
        file.write_text(json.dumps(result_to_dict(result)))
        add_run(Path(name) / 'store', file, '2026-01-01')
        store = read_store(Path(name) / 'store')
    history = history_of(store, machine.name)
    short = plan_for_path(interim_path(history), PlannerConfig())
    runs = [0.0] * steady + [d for d in drifts for _ in range(each)]
    for k, size in enumerate(runs):
        rng = np.random.default_rng([9127, seed, k])
        changed = added(truth, random_tables(machine, 1e-6 * size, rng)) if size else truth
        again = replace(config, seed=int(rng.integers(1, 2**31 - 1)))
        recording = Recording(
            simulate(machine, short, again, changed).samples, short.path, machine
        )
        yield size, 1e6 * uncertainty(history.series, -1), interim_check(recording, history.series)


def interval(hits: int, of: int) -> str:
    """Share with its 95 % interval (Clopper and Pearson)."""
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return f'{100 * hits / of:.1f} ({100 * low:.1f} to {100 * high:.1f})'


def main() -> None:
    """Print a row a size of drift."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument('--machines', type=int, default=12)
    options.add_argument('--first-seed', type=int, default=61_001)
    options.add_argument('--steady', type=int, default=10, help='runs of the unchanged machine')
    options.add_argument('--drifts', type=numbers, default=(1.0, 2.0, 3.0, 5.0))
    options.add_argument('--each', type=int, default=2, help='runs of each drift')
    given = options.parse_args()
    found, u = defaultdict(list), []
    for seed in range(given.first_seed, given.first_seed + given.machines):
        for size, mean_u, check in checks(seed, given.steady, given.drifts, given.each):
            found[size].append(check)
            u.append(mean_u)
    print(f'{given.machines} machines from seed {given.first_seed}; mean u of their tables '
          f'{min(u):.2f} to {max(u):.2f} um, {np.mean(u):.2f} um in the mean\n')  # fmt: skip
    titles = ('drift (um)', 'runs', 'alarms, % (95 % interval)', 'found over expected: median',
              'smallest', 'largest')  # fmt: skip
    print(heading(titles))
    for size, judged in found.items():
        ratios = [c.ratio for c in judged]
        alarms = sum(not c.holds for c in judged)
        sizes = [f'{f(ratios):.2f}' for f in (np.median, min, max)]
        print(row((f'{size:g}', len(judged), interval(alarms, len(judged)), *sizes)))


if __name__ == '__main__':
    main()
