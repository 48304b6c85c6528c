# SPDX-License-Identifier: Apache-2.0
"""Uncertainty: covariance against the scatter over many runs, predictions against their own u."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import (
    error_of,
    fit_pieces,
    pieces_of,
    small_plan,
    some_machine,
    tracker_noise,
    transform_pose,
    zero_tables,
)  # fmt: skip

from otf_core.model.evaluation import lattice
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.model.tables import MotionTable, ScalarError
from otf_core.prediction.uncertainty import prediction_rows, prediction_uncertainty
from otf_core.solving.residuals import check_residuals

SEEDS = 30


@pytest.fixture(scope='module')
def runs():
    """Fits of thirty runs with white noise on a machine without errors, all from one place."""
    machine = some_machine()
    pose = transform_pose(machine, 2)
    clean = pieces_of(machine, small_plan(machine).path, zero_tables(machine), pose, size=0.025)
    fits = []
    for seed in range(SEEDS):
        rng = np.random.default_rng([17, seed])
        noise = tracker_noise(clean.xyz, machine.tracker, rng) / np.sqrt(clean.count)[:, None]
        fits.append(fit_pieces(machine, replace(clean, xyz=clean.xyz + noise), pose, iterations=1))
    return machine, fits


def parts(fit):
    """Values and covariance in the order of predictions."""
    order = [fit.unknowns.blocks[n] for n in (*SQUARENESS, *MOTIONS)]
    index = np.concatenate([np.arange(b.start, b.stop) for b in order])
    return fit.solution.value[index], fit.solution.covariance[np.ix_(index, index)]


def test_node_errors_scatter_as_their_covariance_says(runs):
    _, fits = runs
    squares = []
    for fit in fits:
        value, covariance = parts(fit)
        unit = np.sqrt(np.diag(covariance))
        seen = unit > 0
        correlation = covariance[np.ix_(seen, seen)] / np.outer(unit[seen], unit[seen])
        level, direction = np.linalg.eigh(correlation)
        keep = level > 1e-9 * level[-1]  # the gauge makes some values depend on others
        z = direction[:, keep].T @ (value[seen] / unit[seen])
        squares.append(np.sum(z**2 / level[keep]) / keep.sum())
    # 30 runs of some 70 quantities: standard deviation of the mean sqrt(2 / 2100) = 3 %; the
    # floor of 50 nm that is added to every piece (0.4 um noise) takes 2 % away; 4 deviations
    assert np.mean(squares) == pytest.approx(0.98, abs=0.13)


def test_predictions_scatter_as_their_uncertainty_says(runs):
    machine, fits = runs
    q = lattice(machine, 4)
    nodes = {n: fits[0].unknowns.knots[n[2]] for n in MOTIONS}
    u = prediction_uncertainty(machine, nodes, parts(fits[0])[1], q)
    predicted = np.array([error_of(fit.tables, q) for fit in fits])
    known = u > 1e-9  # zero where the gauge fixes all
    scatter = np.sqrt(np.mean(predicted**2, axis=0))
    ratio = scatter[known] / u[known]
    assert known.mean() > 0.9
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.2)  # neighbours are correlated
    assert ratio.min() > 0.4
    assert ratio.max() < 1.65  # 13 % each, 5 of them
    # independent nodes would claim much more: the covariance matters
    alone = prediction_uncertainty(machine, nodes, np.diag(np.diag(parts(fits[0])[1])), q)
    assert np.median(alone[known] / u[known]) > 1.2


def test_prediction_rows_are_derivatives_of_the_error_model():
    machine = some_machine('w-Y-b-X-Z-t')
    nodes = {
        n: np.linspace(machine.axes[n[2]].min, machine.axes[n[2]].max, 3 + (n[1] == 'A'))
        for n in MOTIONS
    }
    q = np.random.default_rng(0).uniform(machine.lower - 0.02, machine.upper + 0.02, (6, 3))
    rows = prediction_rows(machine, nodes, q)
    zero = zero_tables(machine)
    column = 0
    for name in (*SQUARENESS, *MOTIONS):
        for k in range(len(nodes[name]) if name in MOTIONS else 1):
            if name in MOTIONS:
                value = np.zeros(len(nodes[name]))
                value[k] = 1.0
                changed = {**zero.motions, name: MotionTable(nodes[name], value, 0 * value)}
                tables = replace(zero, motions=changed)
            else:
                tables = replace(zero, squareness={**zero.squareness, name: ScalarError(1.0)})
            expected = error_of(tables, q)
            np.testing.assert_allclose(rows[:, :, column], expected, atol=1e-13, err_msg=name)
            column += 1
    assert column == rows.shape[2]


def test_uncertainty_of_many_points_is_that_of_each():
    machine = some_machine()
    nodes = {n: np.array([machine.axes[n[2]].min, machine.axes[n[2]].max]) for n in MOTIONS}
    half = np.random.default_rng(0).normal(size=(39, 39))
    q = np.random.default_rng(1).uniform(machine.lower, machine.upper, (1203, 3))
    together = prediction_uncertainty(machine, nodes, half @ half.T, q)
    for k in (0, 499, 500, 1000, 1202):
        alone = prediction_uncertainty(machine, nodes, half @ half.T, q[k : k + 1])[0]
        np.testing.assert_allclose(together[k], alone, rtol=1e-9)


def test_white_residuals_pass_and_excess_or_colour_inflate():
    rng = np.random.default_rng(0)
    leg = np.repeat(np.arange(40), 50)
    white = rng.standard_normal((2, 2000))
    # 4000 values: 2.2 % for the variance; 4 of them. No correlation above its threshold
    plain = check_residuals(white, leg, 0)
    assert plain.variance_ratio == pytest.approx(1.0, abs=0.09)
    assert plain.correlation_factor == 1.0
    assert check_residuals(3 * white, leg, 0).variance_ratio == pytest.approx(9.0, rel=0.09)
    assert check_residuals(0.1 * white, leg, 0).inflation == 1.0  # never better than assumed
    # mean over 5 neighbours: 1 + 2 * (0.8 + 0.6 + 0.4 + 0.2) = 5
    smooth = np.stack([np.convolve(row, np.ones(5) / np.sqrt(5), 'same') for row in white])
    assert check_residuals(smooth, leg, 0).correlation_factor == pytest.approx(5.0, rel=0.15)
