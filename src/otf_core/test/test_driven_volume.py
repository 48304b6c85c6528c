# SPDX-License-Identifier: Apache-2.0
"""The driven volume: ranges of the axes, hulls that are flat or not, what a file says of it."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine, zero_tables

from otf_core.model.evaluation import lattice
from otf_core.model.tables import MotionTable
from otf_core.prediction.driven_volume import DrivenVolume, driven_volume, table_ranges


def test_range_of_an_axis_is_what_its_seen_tables_share():
    base = zero_tables(some_machine())
    short = MotionTable(np.array([0.05, 0.2]), np.zeros(2), np.zeros(2))
    unseen = replace(short, position=np.array([0.1, 0.12]), identifiable=False)
    tables = replace(base, motions={**base.motions, 'EYX': short, 'EAX': unseen})
    low, high = table_ranges(tables)
    np.testing.assert_array_equal(low, [0.05, 0.0, -0.2])
    np.testing.assert_array_equal(high, [0.2, 0.25, 0.0])


def test_hull_of_points_keeps_its_corners_and_knows_what_is_inside():
    rng = np.random.default_rng(1)
    corners = lattice(some_machine(), 2)
    centre = corners.mean(axis=0)
    cloud = np.concatenate([corners, centre + 0.9 * rng.uniform(-0.5, 0.5, (500, 3)) * 0.2])
    volume = driven_volume(cloud, 0.0)
    assert len(volume.corners) == 8
    assert volume.holds(np.array([[0.01, 0.01, -0.01], [0.31, 0.1, -0.1]])).tolist() == [
        True,
        False,
    ]
    cut = driven_volume(corners[:-1], 0.01)  # without the corner at the upper ends
    probes = np.array([[0.29, 0.24, -0.01], [0.1, 0.1, -0.1], [0.0, 0.25, 0.0], [0.0, 0.0, 0.0]])
    assert cut.holds(probes).tolist() == [False, True, True, True]


@pytest.mark.parametrize('size', [0, 1, 2])
def test_flat_volumes_hold_what_lies_in_them(size):
    rng = np.random.default_rng(size)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0][:size]
    points = np.array([0.1, 0.2, 0.3]) + rng.uniform(-0.2, 0.2, (40, size)) @ axes
    volume = driven_volume(points, 0.005)
    assert np.all(volume.holds(points))
    normal = np.linalg.qr(np.vstack([axes, rng.standard_normal((3 - size, 3))]).T)[0].T[size]
    assert not np.any(volume.holds(points + 0.01 * normal))
    assert np.all(volume.holds(points + 0.004 * normal))
    if size:
        assert not np.any(volume.holds(points + 0.5 * axes[0]))


def test_planes_in_the_file_say_the_same_as_its_corners():
    rng = np.random.default_rng(2)
    volume = driven_volume(rng.normal(size=(60, 3)), 0.01)
    data = volume.to_dict()
    planes = np.array(data.pop('planes'))
    assert len(planes) > 10
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    touched = np.abs(volume.corners @ planes[:, :3].T + planes[:, 3]) < 1e-12
    assert np.all(touched.sum(axis=0) >= 3) and np.all(touched.sum(axis=1) >= 3)
    probes = 1.2 * rng.normal(size=(5000, 3))
    of_corners = DrivenVolume.from_dict(data).holds(probes)
    np.testing.assert_array_equal(volume.holds(probes), of_corners)
    assert 0.2 < of_corners.mean() < 0.9
