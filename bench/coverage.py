# SPDX-License-Identifier: Apache-2.0
"""Do stated uncertainties hold? Coverage over many machines, and Monte Carlo on one.

Small cells of three kinematic chains in turn, tracker places and noise drawn anew for each:
coloured noise, half to two thirds of its variance correlated over 0.15 s to 0.45 s. Every node,
squareness error and grid component is compared with the truth; the interval is value +/- U with
the coverage factor that is stated for 95 %. Node values are compared in the gauge of the tables
(the truth is fitted with the same gauge at the nodes), grid errors with the best rigid motion
removed of both sides.

``--smooth``: cubic splines through the true node values, which tables can only follow in part.
``--same-machine``: one machine, path and tracker place, N draws of the noise only (JCGM 101); the
ratio of the standard deviation of the results to the mean standard uncertainty stated.

Usage: PYTHONPATH=src/otf_core python bench/coverage.py [--machines N] [--seed S] [--smooth]
           [--same-machine] [--workers N]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from spread import add_options, spread

from otf_core.calibration.calibrate import calibrate
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.model.chain import displacement
from otf_core.model.evaluation import free_rows, lattice, rigid_columns, without_rigid_motion
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import ErrorTables, MotionTable
from otf_core.planning.path_creation import plan_path
from otf_core.prediction.uncertainty import prediction_rows
from otf_core.sim.cell import random_tables, simulate
from otf_core.sim.tracker import measure, specified_noise
from otf_core.solving.unknowns import layout, linear

Array = NDArray[np.float64]

CHAINS = ('w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Y-b-Z-t')
AXIS_RANGES = {'X': (0.0, 0.3), 'Y': (0.0, 0.25), 'Z': (-0.2, 0.0)}
PITCH = 0.05
RATE = 200.0
ERROR_SIZE = 2e-5
GRID = 5
DENSE = 20
NAMES = (*SQUARENESS, *MOTIONS)


@dataclass(frozen=True)
class Case:
    """One calibration of a simulated machine whose errors are known."""

    result: CalibrationResult
    truth: ErrorTables


def drawn(seed: int, smooth: bool) -> tuple[Machine, SimulationConfig, ErrorTables]:
    """Draw a machine, the colour of its tracker's noise, and its errors."""
    rng = np.random.default_rng([7411, seed])
    machine = Machine(
        f'cell {seed}',
        Chain.parse(CHAINS[seed % 3]),
        {a: Axis(low, high, PITCH) for a, (low, high) in AXIS_RANGES.items()},
        np.array([0.02, -0.03, -0.15]),
        TrackerSpec(0.5e-6, float(rng.uniform(1e-6, 3e-6))),
    )
    tables = random_tables(machine, ERROR_SIZE, rng)
    config = SimulationConfig(
        seed=seed,
        rate=RATE,
        correlated_share=float(rng.uniform(0.5, 0.67)),
        correlation_time=float(rng.uniform(0.15, 0.45)),
    )
    return machine, config, splined(tables) if smooth else tables


def some_case(seed: int, smooth: bool) -> Case:
    """Draw a machine, simulate a run, calibrate."""
    machine, config, truth = drawn(seed, smooth)
    plan = plan_path(machine, PlannerConfig(levels=2))
    run = simulate(machine, plan, config, truth)
    return Case(calibrate(run.samples, plan.path, machine), truth)


def splined(tables: ErrorTables) -> ErrorTables:
    """Cubic splines through the nodes, sampled densely."""
    motions = {}
    for name, table in tables.motions.items():
        count = DENSE * (len(table.position) - 1) + 1
        position = np.linspace(table.position[0], table.position[-1], count)
        value = CubicSpline(table.position, table.value)(position)
        motions[name] = MotionTable(position, value, np.zeros_like(value))
    return replace(tables, motions=motions)


def truth_in_gauge(case: Case) -> dict[str, Array]:
    """True node values and squareness in the gauge of the result, at its nodes."""
    tables, machine = case.result.tables, case.result.tables.machine
    nodes = {a: tables.motions[f'EX{a}'].position for a in machine.axis_names}
    points = np.stack(np.meshgrid(*nodes.values(), indexing='ij'), axis=-1)
    q = points.reshape(-1, 3)
    unknowns = layout({a: linear(nodes[a]) for a in machine.axes})
    rows = np.zeros((3 * len(q), unknowns.full))
    model = prediction_rows(machine, {m: nodes[m.axis] for m in MOTIONS}, q).reshape(
        3 * len(q), -1
    )
    rows[:, :6] = rigid_columns(q).reshape(-1, 6)
    start = 0
    for name in NAMES:
        block = unknowns.blocks[name]
        width = block.stop - block.start
        rows[:, block] = model[:, start : start + width]
        start += width
    seen = [b for n, b in unknowns.free_blocks.items() if n not in case.result.not_identifiable]
    use = np.concatenate([np.arange(b.start, b.stop) for b in seen])
    field = displacement(case.truth, q).reshape(-1)
    free = np.zeros(unknowns.free)
    free[use] = np.linalg.lstsq(rows @ unknowns.gauge.toarray()[:, use], field, rcond=None)[0]
    full = unknowns.gauge @ free
    return {n: full[unknowns.blocks[n]] for n in NAMES}


def value_and_u(tables: ErrorTables, name: str) -> tuple[Array, Array]:
    """Values and standard uncertainties of one motion or squareness error."""
    if name in SQUARENESS:
        entry = tables.squareness[name]
        return np.array([entry.value]), np.array([entry.u_run])
    return tables.motions[name].value, tables.motions[name].u_run


def grid_rows(result: CalibrationResult, grid: Array) -> tuple[Array, Array]:
    """Derivatives of the components on a grid, free of rigid motion, and their u."""
    nodes = {m: result.tables.motions[m].position for m in MOTIONS}
    rows = prediction_rows(result.tables.machine, nodes, grid)
    flat = free_rows(rows.reshape(-1, rows.shape[2]), grid)
    return flat, np.sqrt(np.einsum('ij,ij->i', flat @ result.covariance_run, flat))


def deviations(case: Case) -> dict[str, tuple[Array, Array, Array]]:
    """Deviation from the truth, u and U of every motion, squareness error and of the grid."""
    result, truth = case.result, truth_in_gauge(case)
    found, factors = {}, {line.name: line.k for line in result.budget_lines}
    for name in NAMES:
        if name in result.not_identifiable:
            continue
        value, u = value_and_u(result.tables, name)
        free, k = u > 1e-12, factors[name]
        found[name] = (value - truth[name])[free], u[free], k * u[free]
    grid = lattice(result.tables.machine, GRID)
    field = displacement(result.tables, grid) - displacement(case.truth, grid)
    flat, u = grid_rows(result, grid)
    k = result.budget.expansion(result.budget.variances(flat))[0]
    found['grid'] = without_rigid_motion(field, grid).reshape(-1), u, k * u
    return found


def judged(seed: int, smooth: bool) -> dict[str, tuple[float, list[float]]]:
    """Share within U, and deviations over u, of every motion, squareness error and the grid."""
    return {
        name: (float(np.mean(np.abs(d) <= wide)), (np.abs(d) / u).tolist())
        for name, (d, u, wide) in deviations(some_case(seed, smooth)).items()
    }


def many_machines(machines: int, seed: int, smooth: bool, given: argparse.Namespace) -> None:
    """Print the coverage per motion over many machines."""
    start = time.perf_counter()
    kind = 'smooth' if smooth else 'linear'
    cells = {f'{kind}-{k}': {'seed': k, 'smooth': smooth} for k in range(seed, seed + machines)}
    found = spread(judged, cells, given.workers)
    print(f'{len(found)} machines from seed {seed}, {kind} between nodes, '
          f'{time.perf_counter() - start:.0f} s')  # fmt: skip
    print('            within U   +/-   |error|/u: median   rms   within 2u')
    for name in (*NAMES, 'grid'):
        own = [cell[name] for cell in found.values() if name in cell]
        if not own:
            continue
        share, values = np.array([s for s, _ in own]), np.concatenate([v for _, v in own])
        scatter = share.std() / np.sqrt(len(share))
        print(f'{name:10}{100 * share.mean():9.1f} %{100 * scatter:6.1f}{np.median(values):16.2f}'
              f'{np.sqrt(np.mean(values**2)):9.2f}{100 * np.mean(values < 2):9.1f} %')  # fmt: skip


def same_machine(draws: int, seed: int) -> None:
    """Print scatter of the results over draws of the noise, over the u stated (JCGM 101)."""
    machine, config, truth = drawn(seed, smooth=False)
    plan = plan_path(machine, PlannerConfig(levels=2))
    quiet = replace(machine, tracker=TrackerSpec(1e-15, 1e-15))
    clean = simulate(quiet, plan, config, truth).samples
    noise = specified_noise(machine, config)
    values, stated = defaultdict(list), defaultdict(list)
    start = time.perf_counter()
    for draw in range(draws):
        xyz = measure(clean.xyz, noise, config.rate, np.random.default_rng([seed, draw]))
        result = calibrate(replace(clean, xyz=xyz), plan.path, machine)
        tables, grid = result.tables, lattice(machine, GRID)
        field, u = displacement(tables, grid), grid_rows(result, grid)[1]
        values['grid'].append(without_rigid_motion(field, grid).reshape(-1))
        stated['grid'].append(u)
        for name in NAMES:
            if name not in result.not_identifiable:
                value, u = value_and_u(tables, name)
                values[name].append(value)
                stated[name].append(u)
    print(f'chain {machine.chain}, {draws} draws of the noise, seed {seed}, '
          f'{time.perf_counter() - start:.0f} s')  # fmt: skip
    print('            scatter / u')
    for name in (*NAMES, 'grid'):
        if name in values:
            scatter = np.var(values[name], axis=0, ddof=1)
            u = np.mean(np.square(stated[name]), axis=0)
            known = u > 1e-20
            print(f'{name:10}{np.sqrt(np.mean(scatter[known]) / np.mean(u[known])):12.3f}')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--machines', type=int, default=240, help='or draws of the noise')
    parser.add_argument('--seed', type=int, default=50_001)
    parser.add_argument('--smooth', action='store_true')
    parser.add_argument('--same-machine', action='store_true')
    add_options(parser)
    given = parser.parse_args()
    if given.same_machine:
        same_machine(given.machines, given.seed)
    else:
        many_machines(given.machines, given.seed, given.smooth, given)
