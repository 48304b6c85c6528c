# SPDX-License-Identifier: Apache-2.0
"""Evidence of an effect: ratio of densities, odds that keep their word, least squares."""

import numpy as np
import pytest
from engine_cells import log_bayes_factor

from otf_core.diagnosis.engine.evidence import (
    BLIND,
    average,
    axis_subsets,
    estimate,
    log_evidence,
)
from otf_core.effects import Terms


def drawn(seed, rows=60, terms=3, size=1e-6):
    """Columns whose displacement of ``size`` is about one standard deviation of a row."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((rows, terms)) * rng.uniform(0.2, 5.0, terms)
    return rng, columns, size * rng.uniform(0.3, 3.0, terms)


@pytest.mark.parametrize('variance', [1.0, 2.7])
@pytest.mark.parametrize('terms', [1, 3, 6])
@pytest.mark.parametrize('size', [1e-7, 1e-6, 1e-4])
def test_evidence_is_the_ratio_of_the_densities_with_and_without_the_effect(terms, size, variance):
    rng, columns, sizes = drawn(terms, terms=terms, size=size)
    y = columns @ rng.standard_normal(terms) + rng.standard_normal(len(columns))
    found = log_evidence(columns.T @ columns, columns.T @ y, sizes, variance)
    assert found == pytest.approx(log_bayes_factor(columns, sizes, y, variance), abs=1e-8)


@pytest.mark.parametrize('size', [1e-5, 1e-6])
def test_noise_looks_like_an_effect_no_more_often_than_the_odds_say(size):
    """With noise alone odds of k or more come up once in k draws at most."""
    right = np.random.default_rng(5).standard_normal((1000, 2))  # of columns of unit length
    odds = np.exp([log_evidence(np.eye(2), r, np.full(2, size), 1.0) for r in right])
    for k in (3.0, 10.0, 30.0):
        assert np.mean(odds > k) < 1.0 / k
    if size == 1e-5:  # else most of the mean lies in draws that never come
        assert np.mean(odds) == pytest.approx(1.0, abs=0.05)


def test_parameters_have_a_price():
    """The same trace by one column, and by one of ten of which nine do nothing for it."""
    rng = np.random.default_rng(4)
    columns = np.linalg.qr(rng.standard_normal((100, 10)))[0] * 10.0
    sizes, y = np.full(10, 1e-6), 0.6 * columns[:, 0]
    one = log_evidence(columns[:, :1].T @ columns[:, :1], columns[:, :1].T @ y, sizes[:1], 1.0)
    ten = log_evidence(columns.T @ columns, columns.T @ y, sizes, 1.0)
    assert one > 10.0
    # every idle column costs log(1 + (10 spread / size)^2) / 2; spread 0.5 um: 1.6
    assert 9 * 1.0 < one - ten < 9 * 2.5


def test_average_is_that_of_the_odds():
    assert average([2.0, 2.0, 2.0]) == pytest.approx(2.0)
    assert average([3.0, -np.inf]) == pytest.approx(3.0 - np.log(2))
    assert average([800.0, 0.0]) == pytest.approx(800.0 - np.log(2))


# ---------------------------------------------------------------- coefficients


def test_estimate_is_dense_least_squares():
    rng, columns, sizes = drawn(1, terms=5)
    y = rng.standard_normal(len(columns))
    found = estimate(columns, sizes, y)
    value, square, _, _ = np.linalg.lstsq(columns, y, rcond=None)
    np.testing.assert_allclose(found.value, value, rtol=1e-9)
    assert found.gain == pytest.approx(y @ y - square[0], rel=1e-9)
    inverse = np.linalg.inv(columns.T @ columns)
    np.testing.assert_allclose(found.covariance, inverse, rtol=1e-8, atol=1e-12)


def test_a_term_that_moves_nothing_is_zero_beside_others():
    columns = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 0.0]])
    found = estimate(columns, np.array([1e-6, 0.0]), 3.0 * columns[:, 0])
    assert found.value == pytest.approx([3.0, 0.0])


def test_covariance_is_the_scatter_of_estimates():
    rng, columns, sizes = drawn(2, terms=3)
    found = [estimate(columns, sizes, y).value for y in rng.standard_normal((2000, len(columns)))]
    stated = estimate(columns, sizes, np.zeros(len(columns))).covariance
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    # 2000 draws: relative standard deviation of a variance 3 %
    np.testing.assert_allclose(np.cov(np.array(found).T) / scale, stated / scale, atol=0.12)


@pytest.mark.parametrize(('u', 'seen'), [(0.99 * BLIND, True), (1.01 * BLIND, False)])
def test_what_stays_uncertain_by_more_than_twenty_micrometres_is_not_estimated(u, seen):
    rng, size = np.random.default_rng(3), 4e-7
    column = rng.standard_normal((50, 1))
    # a coefficient of standard uncertainty 1 / |column| displaces by size / |column|
    column *= size / u / np.linalg.norm(column)
    found = estimate(column, np.array([size]), 3e3 * column[:, 0])
    assert found.value[0] == pytest.approx(3e3 if seen else 0.0)
    assert bool(found.gain > 0.0) is bool(found.covariance[0, 0] > 0.0) is seen


def test_only_the_unseen_combination_is_left_out():
    """Two columns that act alike: their sum is estimated, half each, their difference is zero."""
    rng = np.random.default_rng(6)
    first, other = rng.standard_normal((2, 80))
    columns = np.stack([first, first, other], axis=1)
    found = estimate(columns, np.full(3, 1e-6), columns @ [3.0, 1.0, -2.0])
    np.testing.assert_allclose(found.value, [2.0, 2.0, -2.0], rtol=1e-9)
    difference = np.array([1.0, -1.0, 0.0])
    assert difference @ found.covariance @ difference == pytest.approx(0.0, abs=1e-15)


# ---------------------------------------------------------------- subsets of axes


@pytest.mark.parametrize(
    ('axes', 'expected'),
    [
        (('', ''), [[0, 1]]),
        (('X', 'X'), [[0, 1]]),
        (('X', 'Y', 'X'), [[0, 1, 2], [0, 2], [1]]),
        (('Z', '', 'X'), [[0, 1, 2], [2], [0]]),
    ],
)
def test_all_terms_are_tried_and_those_of_every_axis_alone(axes, expected):
    names = tuple(f'c{k}' for k in range(len(axes)))
    terms = Terms(names, ('m',) * len(axes), axes, np.zeros((1, 3, len(axes))))
    assert [subset.tolist() for subset in axis_subsets(terms)] == expected


def test_what_data_do_not_see_is_left_zero_and_told():
    """Two coefficients of which only the sum acts, and one of its own."""
    rng = np.random.default_rng(31)
    one, other = 1e6 * rng.standard_normal((2, 200))
    white = np.column_stack([one, one, other])
    y = white @ [3e-6, 1e-6, 2e-6]
    found = estimate(white, np.ones(3), y)
    np.testing.assert_allclose(found.value, [2e-6, 2e-6, 2e-6], rtol=1e-9)
    assert found.unseen.shape == (3, 1)
    np.testing.assert_allclose(np.abs(found.unseen[:, 0]), [0.5**0.5, 0.5**0.5, 0.0], atol=1e-9)
    np.testing.assert_allclose(white @ found.unseen, 0.0, atol=1e-6)
