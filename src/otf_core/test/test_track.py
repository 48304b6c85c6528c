# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np
import pytest

from otf_core.blocks import BLOCK
from otf_core.model.observation import Samples
from otf_core.tracking.measured_track import HOP, STRIDE_TIME, measured_track, reversals, simplify


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


@pytest.mark.parametrize('steps', [(0.9,), (0.21, 0.04, 0.9), (0.4, 0.0, 0.4, 0.0)])
def test_next_hop_is_the_first_point_a_hop_away_however_fast_the_machine_drives(steps):
    # in hops per sample: fast, so slow that many samples pass, and standing still between
    way = np.repeat(steps, BLOCK // len(steps) + 50).cumsum()
    places = np.linspace(0.0, way[-1] * HOP, 4)[:, None] * np.array([1.0, 0.0, 0.0])
    places[1::2, 1] = 0.5  # a corner every third of the time
    points = np.stack([np.interp(way * HOP, places[:, 0], places[:, k]) for k in range(3)], axis=1)
    points += np.random.default_rng(4).normal(0, 1e-6, points.shape)
    stamps = np.arange(len(points)) * round(1e9 * STRIDE_TIME)
    track = measured_track(Samples(stamps, points), 0.002)
    hop = np.linalg.norm(np.diff(track.points, axis=0), axis=1)
    assert (hop >= HOP * (1 - 1e-12)).all()
    seen = np.concatenate([points[:1], np.median([points[:-2], points[1:-1], points[2:]], axis=0)])
    for at, last in pairwise(track.hops.tolist()):
        between = np.linalg.norm(seen[at + 1 : last] - seen[at], axis=1)
        assert (between < HOP).all()
