# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np

from otf_core.tracking.track import reversals, simplify


def driven(corners, step=1e-3):
    """Points along a polyline, one per step, and the index of every corner."""
    parts, index, total = [], [0], 0
    for a, b in pairwise(corners):
        count = round(float(np.linalg.norm(b - a)) / step)
        parts.append(a + np.arange(count)[:, None] / count * (b - a))
        total += count
        index.append(total)
    return np.concatenate([*parts, corners[-1:]]), index


A, B, C = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, -0.2], [0.3, 0.4, -0.2]])


def test_line_driven_to_and_fro_keeps_its_ends():
    # an odd number of passes lies on the chord from start to end all along
    points, corners = driven(np.array([A, B, A, B]))
    found = simplify(points, 0.002)
    assert len(found) == 4
    np.testing.assert_allclose(found, corners, atol=2)


def test_right_turn_is_no_reversal_and_still_a_corner():
    points, corners = driven(np.array([A, B, C]))
    assert len(reversals(points[: corners[1]])) == 0
    np.testing.assert_allclose(simplify(points, 0.002), corners, atol=2)


def test_straight_track_has_no_reversal_in_noise():
    points, _ = driven(np.array([A, B]))
    noise = np.random.default_rng(5).normal(0, 1e-5, points.shape)
    assert len(reversals(points + noise)) == 0
