# SPDX-License-Identifier: Apache-2.0
"""B-splines of one axis: what they reproduce, and what they are at and beyond the ends."""

import numpy as np
import pytest

from otf_core.solving.unknowns import Basis, cubic, linear

KNOTS = np.array([-0.2, -0.13, 0.0, 0.05, 0.21, 0.4])
BASES = {'cubic': Basis(KNOTS, 3), 'linear': linear(KNOTS), 'even': cubic(KNOTS, 7)}
Q = np.linspace(-0.2, 0.4, 301)


@pytest.fixture(params=BASES)
def basis(request):
    return BASES[request.param]


def test_functions_add_up_to_one_everywhere_and_are_never_negative(basis):
    values = basis.matrix(np.concatenate([Q, [-1.0, 2.0], KNOTS]))
    assert values.shape[1] == basis.size
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-14)
    assert values.min() >= 0.0
    assert np.count_nonzero(values, axis=1).max() <= basis.nonzero


@pytest.mark.parametrize('name', ['cubic', 'even'])
def test_cubics_are_reproduced_from_their_values_at_the_centres(name):
    basis = BASES[name]

    def function(q):
        return 1.0 - 2.0 * q + 5.0 * q**2 - 30.0 * q**3

    coefficients = basis.from_values @ function(basis.centres)
    np.testing.assert_allclose(basis.matrix(Q) @ coefficients, function(Q), atol=1e-13)


def test_values_at_the_ends_are_the_first_and_last_coefficients_and_stay_beyond(basis):
    values = np.random.default_rng(1).standard_normal(basis.size)
    found = basis.matrix(np.array([-5.0, -0.2, 0.4, 7.0])) @ values
    np.testing.assert_allclose(found, values[[0, 0, -1, -1]], atol=1e-14)


def test_hats_are_straight_lines_between_values_at_the_knots():
    values = np.random.default_rng(2).standard_normal(len(KNOTS))
    q = np.linspace(-0.4, 0.6, 501)
    np.testing.assert_allclose(
        linear(KNOTS).matrix(q) @ values, np.interp(q, KNOTS, values), atol=1e-14
    )
    np.testing.assert_array_equal(linear(KNOTS).centres, KNOTS)


def test_cubics_have_two_continuous_derivatives():
    basis = BASES['cubic']
    values = np.random.default_rng(3).standard_normal(basis.size)
    step = 1e-5
    for knot in KNOTS[1:-1]:
        q = knot + step * np.arange(-4, 5)
        bend = np.diff(basis.matrix(q) @ values, 2) / step**2
        # what the third derivative, up to 2e5, makes of one step; hats would jump by some 1e6
        assert np.abs(np.diff(bend)).max() < 2.0


@pytest.mark.parametrize('basis', [linear(np.array([0.1])), cubic(np.array([0.1]), 20)])
def test_an_axis_that_stands_has_one_constant(basis):
    assert (basis.size, basis.nonzero) == (1, 1)
    np.testing.assert_array_equal(basis.matrix(np.array([0.1, 3.0])), [[1.0], [1.0]])
    np.testing.assert_array_equal(basis.centres, [0.1])
    np.testing.assert_array_equal(basis.from_values, [[1.0]])
    np.testing.assert_array_equal(basis.finer(8), [0.1])
