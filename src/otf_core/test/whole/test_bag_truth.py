# SPDX-License-Identifier: Apache-2.0
"""What ``calibrate`` finds in the recorded bags against truth.json, with the error to expect.

The error to expect comes from outside: dense least squares that knows the true noise, on the same
path pieces (certified/by_lines.py). Every bound fails if the errors become half as large again.
"""

import json
import re
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from certified.by_lines import solve_by_lines
from certified.exact_chain import AXES, MOTIONS, SQUARENESS
from certified.measured_rows import Pieces
from certified.truth import (
    exact,
    first_order,
    in_gauge,
    lattice,
    mean_length,
    without_rigid_motion,
)
from scipy import stats

from otf_core.bags.bag import read_bag
from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import CalibrationConfig
from otf_core.model.machine import load_machine
from otf_core.pieces.runs import Recording, prepare_runs
from otf_core.prediction.calibration_document import tables_to_dict

BAGS = Path(__file__).parents[4] / 'bags'
SLOW = {
    'all-axes-carry-the-target': 0.5,
    'y-carries-the-table': 0.5,
    'x-and-y-carry-the-table': 0.2,
}
"""Share of the variance of the noise that is correlated over 0.3 s, see bags/record.py."""
DEGRADED = 1.5
NEAR = 1.1
"""Error over that of the dense least squares."""
ALIKE = 0.1
"""Relative difference of the mean error that both covariances let expect."""
DRAWS = 400
RARE = 1e-3
"""Probability with which noise alone leaves the bounds of chi-square, either side."""


def expected_length(rows, covariance):
    """Mean length of error vectors with rows (n, 3, k) of values of a covariance, m."""
    draw = np.random.default_rng(0).multivariate_normal
    values = draw(np.zeros(len(covariance)), covariance, DRAWS, method='eigh')
    return np.mean([mean_length(rows @ v) for v in values])


@pytest.fixture(scope='module', params=SLOW)
def case(request):
    """One bag: true tables, what the core finds, what dense least squares finds."""
    folder, config = BAGS / request.param, CalibrationConfig()
    content, machine = read_bag(folder / 'bag'), load_machine(folder / 'machine.yaml')
    recording = Recording(content.samples, content.path, machine)
    runs, nodes = prepare_runs([recording], config)
    result = calibrate_recordings([recording], config)
    truth = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
    run = {'machine': truth['machine'], 'not_identifiable': list(result.not_identifiable)}
    pieces = Pieces(*(getattr(runs[0].pieces, field.name) for field in fields(Pieces)))
    pose, slow = runs[0].pose, SLOW[request.param]
    noise = {'white': 1 - slow, 'slow': slow, 'correlation_time': 0.3}
    noise |= {'misfit_piece': 5e-8, 'misfit_line': 0.0}
    nodes = [nodes[axis] for axis in AXES]
    dense = solve_by_lines(run, pieces, (pose.rotation, pose.translation), nodes, noise)
    grid = lattice(machine.lower, machine.upper, 7)
    return SimpleNamespace(
        name=request.param, result=result, truth=truth, dense=dense, grid=grid, nodes=nodes
    )


def found_error(case):
    """Mean error left on the grid by the tables of the core, m."""
    left = first_order(tables_to_dict(case.result.tables), case.grid) - exact(
        case.truth, case.grid
    )
    return mean_length(without_rigid_motion(left, case.grid))


def dense_error(case):
    """The same for dense least squares."""
    model, value, _ = case.dense
    left = model.error_rows(case.grid)[:, :, 6:] @ value[6:] - exact(case.truth, case.grid)
    return mean_length(without_rigid_motion(left, case.grid))


def published(case):
    """Squareness and nodes of all motions seen: values, and covariance at the nodes themselves."""
    tables = case.result.tables
    seen = [m for m in MOTIONS if tables.motions[m].identifiable]
    values = [tables.squareness[s].value for s in SQUARENESS]
    sizes = [3, *(len(tables.motions[m].value) for m in MOTIONS)]
    kept = np.repeat([True, *(m in seen for m in MOTIONS)], sizes)
    values = np.concatenate([values, *(tables.motions[m].value for m in seen)])
    covariance = case.result.covariance_run - np.diag(case.result.budget.straight)
    return values, covariance[np.ix_(kept, kept)]


def within(error, bound):
    """Tell that a bound holds, and that it would not if the solver were half as far off again."""
    return error <= bound < DEGRADED * error


def test_tables_are_as_near_the_truth_as_dense_least_squares_that_knows_the_noise(case):
    assert within(found_error(case), NEAR * dense_error(case))


def test_error_left_is_the_stated_one(case):
    text = (BAGS / 'README.md').read_text(encoding='utf-8')
    row = re.search(rf'^\| `{case.name}` \| ([\d.]+) µm \| ([\d.]+) µm \|', text, re.MULTILINE)
    stated = [float(v) for v in row.groups()]
    assert [round(1e6 * v, 2) for v in (found_error(case), dense_error(case))] == stated


def test_stated_uncertainty_is_that_of_the_true_noise(case):
    model, _, covariance = case.dense
    rows = without_rigid_motion(model.coefficient_rows(case.grid), case.grid)
    dense = expected_length(rows @ model.gauge[6:, 6:], covariance[6:, 6:])
    assert case.result.fraction == 1  # the same nodes
    assert expected_length(rows, published(case)[1]) == pytest.approx(dense, rel=ALIKE)


def test_errors_of_all_tables_are_what_their_covariance_says(case):
    model, (found, covariance) = case.dense[0], published(case)
    points = lattice([n[0] for n in case.nodes], [n[-1] for n in case.nodes], 12)
    wanted = (model.gauge @ in_gauge(model, case.truth, points))[6:]
    free = np.diag(covariance) > 0  # the others are zero in the gauge
    error = (found - wanted)[free]
    square = error @ np.linalg.solve(covariance[np.ix_(free, free)], error)
    low, high = stats.chi2.ppf([RARE, 1 - RARE], free.sum())
    assert low < square < high < DEGRADED**2 * square
