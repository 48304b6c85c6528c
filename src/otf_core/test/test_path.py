# SPDX-License-Identifier: Apache-2.0
"""Nominal path: lengths, directions, corners; what is no path is refused."""

import numpy as np
import pytest

from otf_core.errors import InputError
from otf_core.model.path import Legs, NominalPath, sides_of_travel

# along X, a dwell, on along X, a repeated end, then up Y
L_SHAPE = [[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0], [0.3, 0.4, 0]]


def path(points):
    return NominalPath(np.array(points, float))


def test_lengths_and_directions_of_legs_with_a_dwell():
    legs = path(L_SHAPE)
    np.testing.assert_allclose(legs.leg_lengths, [0.1, 0, 0.2, 0.4, 0], atol=1e-16)
    assert legs.length == pytest.approx(0.7)
    expected = [[1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]]
    np.testing.assert_allclose(legs.directions, expected, atol=1e-15)


def test_corners_are_where_the_direction_changes_and_the_two_ends():
    corners, index = path(L_SHAPE).corners()
    assert corners.tolist() == [[0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0]]
    assert [L_SHAPE[i] for i in index] == corners.tolist()


@pytest.mark.parametrize(
    ('points', 'reason'),
    [
        (np.zeros((0, 3)), '0 points'),
        (np.zeros((1, 3)), '1 points'),
        (np.ones((5, 3)), 'without any motion'),
        ([[0, 0, 0], [np.nan, 0, 0]], 'point 1 is not finite'),
        ([[0, 0, 0], [0, 0, 1], [0, 0, np.inf]], 'point 2 is not finite'),
    ],
)
def test_points_without_motion_are_no_path(points, reason):
    with pytest.raises(InputError, match=reason):
        path(points)


def test_axis_that_stands_stays_on_the_side_of_its_last_travel():
    unit = np.array([[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 1e-9], [0, 0, -1.0]])
    wanted = [[0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, -1, -1]]
    assert np.array_equal(sides_of_travel(unit), wanted)


def test_places_on_legs():
    legs = Legs(np.array([[0, 0, 0], [0.3, 0.4, 0], [0.3, 0.4, 0.2]]))
    assert legs.reach.tolist() == pytest.approx([0.0, 0.5, 0.7])
    points, leg = np.array([[0.6, 0.8, 0.1], [0.0, 0.0, 0.1]]), np.array([0, 1])
    along = legs.along(points, leg)
    assert along.tolist() == pytest.approx([1.0, 0.1])
    np.testing.assert_allclose(legs.at(along, leg), [[0.6, 0.8, 0], [0.3, 0.4, 0.1]], atol=1e-15)


def test_point_beyond_all_machines_is_refused_before_lengths_overflow():
    with pytest.raises(InputError, match='point 1 is more than'):
        NominalPath(np.array([[0.0, 0.0, 0.0], [0.0, 1e200, 0.0]]))
