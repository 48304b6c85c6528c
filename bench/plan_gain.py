# SPDX-License-Identifier: Apache-2.0
"""Optimised path against example paths in equal driving time: forecast, then simulated cells.

Same machine, tracker place, noise, highest feed and dwells; time with accelerations and dwells.
Grid uncertainty: mean over the grid of the standard uncertainty of the error vector, best rigid
motion taken out. Achieved: root mean square over cells of calibrated less true errors, likewise.

Usage: PYTHONPATH=src/otf_core python bench/plan_gain.py [CELLS [FIRST_SEED]]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from otf_core.calibration.calibrate import calibrate
from otf_core.config import ForecastConfig, PlannerConfig, SimulationConfig
from otf_core.model.evaluation import lattice, without_rigid_motion
from otf_core.model.kinematics import displacement
from otf_core.model.machine import Axis, Chain, Machine, TrackerSpec
from otf_core.model.path import NominalPath
from otf_core.model.plan import Plan, plan_for_path
from otf_core.planning.forecast import Setup, drive_times, forecast, grid_uncertainty
from otf_core.planning.path_creation import plan_path
from otf_core.planning.path_optimiser import PathOptimiser
from otf_core.sim.cell import simulate

RANGES = {'X': (0.0, 0.6), 'Y': (0.0, 0.5), 'Z': (-0.4, 0.0)}
BUDGET = 560.0
FEED = 0.25
# corners of the unit cube: both diagonals of all six faces, then the space diagonals
BOX = (
    '000 110 100 010 000 011 010 001 000 101 001 100 000 001 111 101 011 001 000 100 111 110 101 '
    '100 000 010 111 011 110 010 000 111 110 001 000 100 011 010 101 000'
)
SPACE = '000 111 110 001 000 100 011 010 101 000'


def machine() -> Machine:
    axes = {a: Axis(low, high, 0.03) for a, (low, high) in RANGES.items()}
    spec = TrackerSpec(0.5e-6, 2e-6)
    return Machine('bench', Chain.parse('w-Y-b-X-Z-t'), axes, np.array([0, 0, -0.15]), spec)


def repeated(lap: NDArray[np.float64], budget: float, acceleration: float) -> Plan:
    """Drive a closed lap as often as the time allows, the last lap in part."""
    corners = np.concatenate([lap] + [lap[1:]] * 60)
    plan = plan_for_path(NominalPath(corners), PlannerConfig(feed=FEED))
    times = drive_times(plan, acceleration)
    legs = int(np.searchsorted(times.start + times.moving + plan.dwell[-1], budget))
    return plan_for_path(NominalPath(corners[: legs + 1]), PlannerConfig(feed=FEED))


def planes(low: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Both diagonals and the edges of three planes per orientation, then the space diagonals."""
    square = np.array([[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]])
    lap = []
    for normal in range(3):
        for level in (0.0, 0.5, 1.0):
            corners = np.full((len(square), 3), level)
            corners[:, [a for a in range(3) if a != normal]] = square
            lap.extend(corners)
    lap.extend([[int(k) for k in c] for c in SPACE.split()])
    points = np.array(lap, dtype=float)
    moved = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])
    return np.asarray(low + points[moved] * size)


def plans(setup: Setup) -> dict[str, Plan]:
    low, size = setup.machine.lower, setup.machine.upper - setup.machine.lower
    box = low + np.array([[int(k) for k in c] for c in BOX.split()]) * size
    lap = plan_path(setup.machine, PlannerConfig(passes=1)).path.points
    acceleration = setup.config.acceleration
    best = PathOptimiser(setup, PlannerConfig(feed=FEED)).for_time(BUDGET)
    print(f'optimised: {best.passes} passes, {100 * best.efficiency:.1f} % of the ideal share')
    return {
        'box diagonals (as paper Figure 1)': repeated(box, BUDGET, acceleration),
        'diagonals in three planes each': repeated(planes(low, size), BUDGET, acceleration),
        'path creator, laps at full feed': repeated(lap, BUDGET, acceleration),
        'path creator, as by default': plan_path(setup.machine, PlannerConfig()),
        'optimised': best.plan,
    }


def rms(field: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.sum(field**2, axis=1))))


def achieved(plan: Plan, bench: Machine, seeds: range) -> tuple[NDArray[np.float64], float]:
    """Grid error per cell and the mean stated uncertainty, m."""
    grid, errors, stated = lattice(bench), [], []
    for seed in seeds:
        run = simulate(bench, plan, SimulationConfig(seed=seed))
        result = calibrate(run.samples, plan.path, bench)
        field = displacement(result.tables, grid) - displacement(run.truth, grid)
        errors.append(rms(without_rigid_motion(field, grid)))
        nodes = {a: result.tables.motions[f'EX{a}'].position for a in bench.axis_names}
        stated.append(rms(grid_uncertainty(bench, nodes, result.covariance, grid)[1]))
    return np.array(errors), float(np.mean(stated))


def main(cells: int = 8, first: int = 720_001) -> None:
    bench, seeds = machine(), range(first, first + cells)
    setup = Setup.of(bench, config=ForecastConfig())
    made = plans(setup)
    # cells put the tracker where their seed says: forecast there too
    places = [simulate(bench, replace_short(made['optimised']), SimulationConfig(seed=s)).place
              for s in seeds]  # fmt: skip
    print(f'{cells} cells from seed {first}; um, root mean square over the grid')
    print(f'{"path":36} {"time s":>7} {"forecast":>9} {"at cells":>9} {"stated":>7} '
          f'{"achieved":>9} {"+/-":>6}')  # fmt: skip
    rows = {}
    for name, plan in made.items():
        here = forecast(plan, setup)
        there = np.sqrt(np.mean([rms(forecast(plan, setup.at(p)).grid_u_free) ** 2
                                 for p in places]))  # fmt: skip
        errors, stated = achieved(plan, bench, seeds)
        mean = float(np.sqrt(np.mean(errors**2)))
        scatter = float(np.std(errors**2) / np.sqrt(cells) / (2 * mean))
        rows[name] = (rms(here.grid_u_free), there, mean, rms(here.grid_u))
        print(f'{name:36} {here.duration:7.1f} {1e6 * rows[name][0]:9.3f} {1e6 * there:9.3f} '
              f'{1e6 * stated:7.3f} {1e6 * mean:9.3f} {1e6 * scatter:6.3f}')  # fmt: skip
    for name, row in rows.items():
        if name != 'optimised':
            ratio = [a / b for a, b in zip(row, rows['optimised'], strict=True)]
            print(f'{name} / optimised: forecast {ratio[0]:.2f}, at the cells {ratio[1]:.2f},')
            print(f'    achieved {ratio[2]:.2f}, in the gauge of the tables {ratio[3]:.2f}')


def replace_short(plan: Plan) -> Plan:
    """First legs of a plan: enough to see where a seed puts the tracker."""
    path = NominalPath(plan.path.points[:3])
    return replace(plan, path=path, feed=plan.feed[:2], dwell=plan.dwell[:3])


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
